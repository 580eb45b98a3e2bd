"""Which of the project's documents a file is that was given as a schedule."""

from collections.abc import Iterable

# A key that only this kind has, and the command that it is for; the first that fits counts.
KINDS = (
    ({"subjects", "onsets"}, "a campaign", "campaign"),
    ({"budget", "criterion", "estimator"}, "a search", "search"),
    ({"vehicle", "mission", "sensors", "duration_s"}, "a scenario", "run"),
)


def kind_of(keys: Iterable[str]) -> str | None:
    """What a document with these keys is, and what reads it; None where no kind is known."""
    for own, name, command in KINDS:
        if own & set(keys):
            return f"{name}, which `mavproxy-fault {command}` reads"
    return None
