"""Which of the project's documents a file is, where one is given in the place of another."""

from collections.abc import Iterable

from mavproxy_fault.documents.errors import ConfigError

# Keys of which only this kind has one, and what reads it; the first that fits counts.
KINDS = {
    "a campaign": ({"subjects", "onsets"}, "campaign"),
    "a search": ({"budget", "criterion", "estimator"}, "search"),
    "a scenario": ({"vehicle", "mission", "sensors", "duration_s"}, "run"),
    "a schedule": ({"faults"}, "run --schedule"),
}


def kind_of(keys: Iterable[str]) -> str | None:
    """What a document with these keys is; None where no kind is known."""
    given = set(keys)
    return next((kind for kind, (own, _) in KINDS.items() if own & given), None)


def refuse_other_kinds(keys: Iterable[str], known: Iterable[str], where: str, wanted: str) -> None:
    """Refuse a document of another kind than is wanted, by a key that is not `known` there.

    Raises
    ------
    ConfigError
        If the keys are those of another kind.
    """
    kind = kind_of(keys)
    if kind not in (wanted, None) and not set(keys) <= set(known):
        command = f"`mavproxy-fault {KINDS[kind][1]}`"
        raise ConfigError(f"{where}: is {kind}, which {command} reads; {wanted} is needed here")
