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
    chosen = select_ephemerides(epoch_at(107_179.0), orbits)
    assert chosen.names == ("G05",)
    assert chosen.unused == {"E11": "no ephemeris"}
    assert not chosen.is_valid_for(epoch_at(107_220.0))  # the part of the week after its end
    too_old = select_ephemerides(epoch_at(107_220.0), orbits)
    assert too_old.names == ()
    assert too_old.unused["G05"] == "its ephemeris is 2.0 h old"


@given(age_s=st.integers(-15_000, 15_000).map(lambda minutes: 60.0 * (minutes // 60)))
def test_galileo_is_valid_from_its_time_on_and_gps_around_it(age_s: float) -> None:
    at_s = 300_000.0
    orbits = stored([("G05", at_s - age_s, 0), ("E11", at_s - age_s, 0)])
    names = select_ephemerides(epoch_at(at_s), orbits).names
    assert ("G05" in names) == (-7200.0 <= age_s <= 7200.0)
    assert ("E11" in names) == (-3600.0 <= age_s <= 14_400.0)


def test_a_galileo_ephemeris_from_before_is_preferred_to_one_of_later() -> None:
    orbits = stored([("E11", 98_400.0, 0), ("E11", 101_160.0, 0)])  # 1,600 s old, 1,160 s early
    chosen = select_ephemerides(epoch_at(100_000.0), orbits)
    assert [ephemeris.toe_s for ephemeris in chosen.used] == [98_400.0]


def test_an_unhealthy_and_a_wrong_ephemeris_are_not_used_and_it_says_why() -> None:
    orbits = stored([("G05", 100_000.0, 1), ("E11", 98_400.0, 0), ("E11", 99_000.0, 0)])
    chosen = select_ephemerides(epoch_at(100_020.0), orbits)
    assert chosen.unused == {"G05": "its ephemeris says that it is unhealthy"}
    other = select_ephemerides(epoch_at(100_020.0), orbits, wrong=chosen.used)
    assert [ephemeris.toe_s for ephemeris in other.used] == [98_400.0]
