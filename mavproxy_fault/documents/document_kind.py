"""Recognises the kind of a configuration file, to report one given in place of another."""

from collections.abc import Sequence
from typing import Any

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document

# Keys that identify each kind, and the command that reads it; the first match counts.
KINDS = {
    "a campaign": ({"subjects", "onsets"}, "campaign"),
    "a search": ({"budget", "criterion", "estimator"}, "search"),
    "a scenario": ({"vehicle", "mission", "sensors", "duration_s"}, "run"),
    "a schedule": ({"faults"}, "run --schedule"),
}


def check_kind(document: Document, known: Sequence[str], wanted: str) -> dict[str, Any]:
    """Return the mapping of a document of the kind `wanted`, whose keys are `known`.

    Raises
    ------
    ConfigError
        If it has no keys, or the keys of another kind.
    """
    keys = document.data
    if not isinstance(keys, dict):
        raise ConfigError(f"{document.where}: is not {wanted}; give keys: {', '.join(known[:4])}")
    kind = next((kind for kind, (own, _) in KINDS.items() if own & keys.keys()), wanted)
    if kind != wanted and not keys.keys() <= set(known):
        command = f"`mavproxy-fault {KINDS[kind][1]}`"
        raise ConfigError(f"{document.where}: is {kind}; give {wanted}, or run {command}")
    return keys
