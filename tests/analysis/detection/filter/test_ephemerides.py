"""Which ephemerides an epoch is judged by, and for how long."""

from dataclasses import MISSING, fields, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analysis.detection.filter.ephemerides import (
    RESELECT_S,
    EphemerisSelection,
    StoredOrbit,
    select_ephemerides,
)
from analysis.orbits.broadcast import PACKED
from analysis.samples.sample import Epoch
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

WEEK = 2149
NOTHING = {
    field.name: 0
    for field in fields(Ephemeris)
    if field.default is MISSING and field.name != "week"
}
ORBIT = Ephemeris(**(NOTHING | {"satellite": "G05"}), week=WEEK)
AT_S = st.integers(0, 20).map(lambda steps: 100_000.0 + 1800.0 * steps)
KNOWN = st.lists(st.tuples(st.sampled_from(["G05", "E11"]), AT_S, st.sampled_from([0, 0, 0, 1])))


def stored(known: list[tuple[str, float, int]]) -> dict[str, tuple[StoredOrbit, ...]]:
    """Ephemerides by satellite in the order of their times, each with numbers of its own."""
    found: dict[str, tuple[StoredOrbit, ...]] = {}
    for number, (name, toe_s, health) in enumerate(sorted(known, key=lambda one: one[1])):
        orbit = replace(ORBIT, satellite=name, toe_s=toe_s, health=health)
        found[name] = (*found.get(name, ()), (orbit, np.full(PACKED, float(number))))
    return found


def epoch_at(tow_s: float) -> Epoch:
    ranges = np.full(2, 2.2e7)
    return Epoch(round(tow_s * 1e6), WEEK, tow_s, ("G05", "E11"), ranges, ranges, ranges)


def same(one: EphemerisSelection, other: EphemerisSelection) -> bool:
    return one.names == other.names and np.array_equal(one.packed, other.packed)


@given(known=KNOWN, tow_s=AT_S, later_s=st.floats(0.0, RESELECT_S), on_a_boundary=st.booleans())
def test_a_valid_selection_equals_a_new_one(
    known: list[tuple[str, float, int]], tow_s: float, later_s: float, on_a_boundary: bool
) -> None:
    orbits = stored(known)
    tow_s += 0.0 if on_a_boundary else 851.0
    chosen, later = select_ephemerides(epoch_at(tow_s), orbits), epoch_at(tow_s + later_s)
    if chosen.is_valid_for(later):
        assert same(chosen, select_ephemerides(later, orbits))


def test_an_ephemeris_is_used_to_the_end_of_its_fit_interval() -> None:
    orbits = stored([("G05", 100_000.0, 0)])
    chosen = select_ephemerides(epoch_at(107_000.0), orbits)
    assert chosen.names == ("G05",)
    assert chosen.is_valid_for(epoch_at(107_200.0))
    assert not chosen.is_valid_for(epoch_at(107_200.1))
    at_the_end = select_ephemerides(epoch_at(107_200.0), orbits)
    assert at_the_end.names == ("G05",)
    assert not at_the_end.is_valid_for(epoch_at(107_200.1))
