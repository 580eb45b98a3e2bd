"""Recognises the kind of a configuration file, to report one given in place of another."""

from collections.abc import Iterable

from mavproxy_fault.documents.errors import ConfigError

# Keys that identify each kind, and the command that reads it; the first match counts.
KINDS = {
    "a campaign": ({"subjects", "onsets"}, "campaign"),
    "a search": ({"budget", "criterion", "estimator"}, "search"),
    "a scenario": ({"vehicle", "mission", "sensors", "duration_s"}, "run"),
    "a schedule": ({"faults"}, "run --schedule"),
}


def kind_of(keys: Iterable[str]) -> str | None:
    """Return the kind of a document with these keys; None if unknown."""
    present = set(keys)
    return next((kind for kind, (own, _) in KINDS.items() if own & present), None)


def refuse_other_kinds(keys: Iterable[str], known: Iterable[str], where: str, wanted: str) -> None:
    """Refuse a document of another kind than `wanted`, whose keys are `known`.

    Raises
    ------
    ConfigError
        If the keys are those of another kind.
    """
    kind = kind_of(keys)
    if kind not in (wanted, None) and not set(keys) <= set(known):
        command = f"`mavproxy-fault {KINDS[kind][1]}`"
        raise ConfigError(f"{where}: is {kind}; give {wanted}, or run {command}")
