"""The search space of a test file."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from analysis.search.space.fault_picks import pick_entries
from analysis.search.space.fault_range import Range
from analysis.search.space.test_file import TestFile
from mavproxy_fault.numerics.arrays import Array

SECTIONS = ("initial", "controls", "mission", "wind", "sensors")


@dataclass(frozen=True)
class Space:
    """Names, lower and upper ends (d,) of the searched values; names and values of fixed ones.

    Names are paths in the test file, such as `initial.roll_deg` or `faults[0].value`. A fault with
    several targets has the dimension `faults[0].target`.
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    fixed: dict[str, float]

    @property
    def dimension(self) -> int:
        """Number of searched values."""
        return len(self.names)

    def values_at(self, point: Array) -> dict[str, float]:
        """All values by name of a point (d,) in the unit cube."""
        # Clipped: some methods step outside the unit cube.
        searched = self.low + np.clip(point, 0.0, 1.0) * (self.high - self.low)
        return self.fixed | dict(zip(self.names, searched.tolist(), strict=True))


def space_of(entries: Mapping[str, Range]) -> Space:
    """The space of fixed numbers and ranges by name."""
    names, low, high = [], [], []
    fixed: dict[str, float] = {}
    for name, value in entries.items():
        # An interval of zero length is a fixed number: searchers need a volume.
        if isinstance(value, tuple) and value[0] < value[1]:
            names.append(name)
            low.append(value[0])
            high.append(value[1])
        else:
            fixed[name] = float(value[0] if isinstance(value, tuple) else value)
    return Space(tuple(names), np.array(low), np.array(high), fixed)


def section_values(values: Mapping[str, float], section: str) -> dict[str, float]:
    """The values of a section of the test file, by key."""
    head = section + "."
    return {k.removeprefix(head): float(v) for k, v in values.items() if k.startswith(head)}


def flight_entries(test: TestFile, trim: Mapping[str, float]) -> dict[str, Range]:
    """Start, controls, wind and sensors; open values are those of the trim."""
    entries = {}
    for section in SECTIONS:
        part = getattr(test, section)
        for key, value in msgspec.structs.asdict(part).items() if part is not None else ():
            name = f"{section}.{key}"
            # None means "as trimmed": only these keys have a value there.
            entries[name] = trim[name] if value is None else value
    return entries


def fault_entries(test: TestFile) -> dict[str, Range]:
    """Magnitude, onset and duration of each fault, and the number that selects its target."""
    if test.at_once is not None:
        return pick_entries(test)
    entries: dict[str, Range] = {}
    for i, fault in enumerate(test.faults):
        entries |= {f"faults[{i}].{key}": value for key, value in fault.ranges().items()}
        count = len(fault.targets)
        # The target is searched as a number: equal parts of an interval are the targets.
        entries[f"faults[{i}].target"] = (0.0, float(count)) if count > 1 else 0.0
        if len(fault.on) > 1:
            entries[f"faults[{i}].on"] = (0.0, float(len(fault.on)))
    return entries


def target_of(test: TestFile, fault: int, value: float) -> str:
    """The target of a searched number."""
    targets = test.faults[fault].targets
    # The upper end of the interval belongs to the last target.
    return targets[min(int(value), len(targets) - 1)]
