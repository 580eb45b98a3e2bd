"""Sets of faults from a catalogue: a point picks which act, on what, how large, when, how long.

Every pick has the same dimensions, shares from 0 to 1, whatever fault it selects, so that searchers
see one space. `expand_picks` gives the picked faults as a test with fixed values.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from analysis.search.space.fault_range import FaultRange, Range
from analysis.search.space.test_file import TestFile

SHARES = ("fault", "target", "on", "value", "at_s", "for_s")
WIDE = 10.0  # chosen: magnitudes that span more are spaced logarithmically


def pick_entries(test: TestFile) -> dict[str, Range]:
    """The dimensions of a test with a catalogue."""
    assert test.at_once is not None
    return {f"picks[{k}].{key}": (0.0, 1.0) for k in range(test.at_once[1]) for key in SHARES}


def expand_picks(
    test: TestFile, values: Mapping[str, float]
) -> tuple[TestFile, Mapping[str, float]]:
    """The test with the picked faults alone, and its values by name; itself without a catalogue."""
    if test.at_once is None:
        return test, values
    least, most = test.at_once
    faults: list[FaultRange] = []
    found = {name: value for name, value in values.items() if not name.startswith("picks[")}
    for k in range(most):
        share = {key: values[f"picks[{k}].{key}"] for key in SHARES}
        # A pick beyond the least number may select no fault at all, as one more of the catalogue.
        choices = [*test.faults, *([None] if k >= least else [])]
        fault = _select(choices, share["fault"])
        if fault is None:
            continue
        name = f"faults[{len(faults)}]"
        found |= {
            f"{name}.{key}": interpolate(ends, share[key]) for key, ends in fault.ranges().items()
        }
        found[f"{name}.target"] = 0.0
        faults.append(
            msgspec.structs.replace(
                fault, target=_select(fault.targets, share["target"]), any_of=[],
                on=[_select(fault.on, share["on"])],
            )
        )  # fmt: skip
    return msgspec.structs.replace(test, faults=faults, at_once=None), found


def interpolate(ends: Range, share: float) -> float:
    """A value at a share of a range, logarithmic over decades."""
    if not isinstance(ends, tuple):
        return ends
    low, high = ends
    if low * high > 0.0 and max(low / high, high / low) > WIDE:
        return float(low * (high / low) ** share)
    return low + share * (high - low)


def _select(choices: list[Any], share: float) -> Any:
    return choices[min(int(share * len(choices)), len(choices) - 1)]
