"""Faults of a test file: kind, target, magnitude, onset and duration, each fixed or searched."""

from typing import Any

from msgspec import field

from analysis.flying.onset import onset_keys
from analysis.search.space.sample_faults import DROPPED, FIELDS, SAMPLE_FAULTS, VALUELESS
from mavproxy_fault.documents.document_check import Section

Range = float | tuple[float, float]
"""A fixed number, or the interval to search."""


class RangeSection(Section, frozen=True):
    """Base of the sections of a test file: ranges must be ordered."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            # Tuples of other lengths are not ranges.
            if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
                raise ValueError(f"{name} = {list(value)} has its ends reversed; write [low, high]")


class FaultRange(RangeSection, frozen=True):
    """One fault as in a schedule; units are the field's.

    With `any_of` the target is searched too, with several onsets `on` (flight events or conditions,
    "" for seconds) the onset; `at_s` then counts from it. `also` holds further keys of the fault.
    """

    fault: str
    target: str | None = None
    any_of: list[str] = field(default_factory=list)
    value: Range | None = None
    at_s: Range = 0.0
    for_s: Range | None = None
    on: list[str] = field(default_factory=lambda: [""])
    also: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        # One or the other: both would be ambiguous.
        if (self.target is None) == (not self.any_of):
            raise ValueError("give exactly one of target and any_of")
        for onset in filter(None, self.on):
            onset_keys(onset)

    @property
    def targets(self) -> list[str]:
        """The possible targets."""
        return [self.target] if self.target is not None else self.any_of

    def ranges(self) -> dict[str, Range]:
        """The numbers and ranges in the file, by key."""
        values = {"value": self.value, "at_s": self.at_s, "for_s": self.for_s}
        return {key: value for key, value in values.items() if value is not None}

    def check_compiled(self) -> None:
        """Raise ValueError if compiled flights, which have no proxy, do not have this fault."""
        if self.fault not in SAMPLE_FAULTS:
            raise ValueError(
                f"faults.fault {self.fault!r} is not compiled; known: {', '.join(SAMPLE_FAULTS)}"
                " (all of the proxy's with `scenario`)"
            )
        if self.also:
            raise ValueError(f"faults.also is not compiled for {self.fault!r}; leave it out")
        if self.value is None and self.fault not in VALUELESS:
            raise ValueError(f"faults.value is missing for {self.fault!r}; a number or [low, high]")
        fields = DROPPED if self.fault == "drop" else FIELDS
        for target in self.targets:
            if target not in fields:
                raise ValueError(f"target {target!r} is unknown; known: {', '.join(fields)}")


def healthy_value(fault: str) -> float:
    """The value of a kind of fault that changes nothing."""
    # A scale of one is no fault; of everything else zero is.
    return 1.0 if fault == "scale" else 0.0
