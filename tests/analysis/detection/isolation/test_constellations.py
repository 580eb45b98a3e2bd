"""Whole systems as hypotheses: by algebra, and spoofed in a real recording."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import Detector
from analysis.detection.filter.ephemerides import select_ephemerides
from analysis.detection.filter.inertial import ERROR_SIZE, ISB
from analysis.detection.filter.measurement import observe_epoch
from analysis.detection.isolation.hypotheses import SYSTEM_CLOCK, group_by_system, select_hypothesis
from analysis.orbits.broadcast import LINE_OF_SIGHT, predict_ranges
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import Epoch
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

ANTENNA_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])  # of the data's README
NORTH_M = ned_axes(*geodetic_position(ANTENNA_M)[:2])[0]
BEGIN_S, FOR_S = 60.0, 60.0
GPS, GALILEO = 8, 7  # satellites of the algebra's epochs


def judged(change, seed, galileo=GALILEO, known_m=1.0):
    """The verdict on innovations of two systems, predicted to `known_m` sigmas, after a change."""
    rng = np.random.default_rng(seed)
    count = GPS + galileo
    azimuth, sine = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.2, 1.0, count)
    cosine = np.sqrt(1.0 - sine**2)
    sight = -np.column_stack([cosine * np.sin(azimuth), cosine * np.cos(azimuth), sine])
    geometry = np.zeros((count, ERROR_SIZE))
    geometry[:, :3], geometry[GPS:, ISB] = sight, 1.0
    design = np.column_stack([sight, np.ones(count), geometry[:, ISB]])
    covariance = known_m**2 * design @ design.T + np.eye(count)
    v = np.linalg.cholesky(covariance) @ rng.standard_normal(count) + change(sight)
    systems = group_by_system(geometry)
    clock = design[:, 3:4].copy()
    return select_hypothesis(
        np.linalg.inv(covariance), v, sight, clock, 1e-4, 3, "explicit", systems
    )


def of_galileo(values):
    return np.concatenate([np.zeros(GPS), values[GPS:]])


def test_a_system_whose_position_jumped_is_excluded_as_a_whole():
    whole = tuple(range(GPS, GPS + GALILEO))
    right = 0
    for seed in range(100):
        found = judged(lambda sight: of_galileo(sight @ [40.0, -20.0, 10.0]), seed)
        right += (found.hypothesis, found.subset) == ("satellites", whole) and found.whole_system
    # In a few of the random skies most of them lie across the shift.
    assert right >= 97


def test_a_system_with_a_clock_fault_keeps_its_satellites():
    found = [judged(lambda sight: of_galileo(np.full(len(sight), 15.0)), s) for s in range(100)]
    assert sum(verdict.hypothesis == SYSTEM_CLOCK for verdict in found) >= 97


def test_single_satellites_are_not_taken_for_their_system():
    def faulty(sight):
        change = np.zeros(len(sight))
        change[GPS + 2] = 10.0
        return change

    right = sum(judged(faulty, seed).subset == (GPS + 2,) for seed in range(300))
    assert right >= 297


@pytest.mark.parametrize("few", [3, 4])
def test_few_satellites_of_a_system_are_not_isolated_where_the_other_may_have_moved(few):
    """Predicted to 300 m, as at a reference station's interval of 30 s."""

    def of_gps(sight):
        return np.concatenate([sight[:GPS] @ [30.0, 0.0, 0.0], np.zeros(few)])

    def of_few(sight):
        return np.concatenate([np.zeros(GPS), sight[GPS:] @ [30.0, 0.0, 0.0]])

    found = [judged(moved, s, few, 300.0) for moved in (of_gps, of_few) for s in range(100)]
    whole = [set(range(GPS)), set(range(GPS, GPS + few))]
    assert not [verdict for verdict in found if set(verdict.subset) in whole]
    # In the others of the random skies one or two satellites explain it nearly as well.
    assert sum((v.hypothesis, v.whole_system) == ("multiple-unknown", True) for v in found) >= 75


def test_one_of_few_satellites_of_a_system_is_still_isolated():
    def faulty(sight):
        change = np.zeros(len(sight))
        change[GPS + 2] = 50.0
        return change

    found = [judged(faulty, seed, 4, 300.0) for seed in range(100)]
    assert sum(verdict.subset == (GPS + 2,) for verdict in found) >= 97


def test_a_single_system_is_no_hypothesis():
    assert group_by_system(np.zeros((6, ERROR_SIZE))).rows == ()


@pytest.fixture(scope="module")
def static(shared_data):
    folder = shared_data / "gnss_static"
    return read_rinex_samples(folder / "SEPT078M.21O", folder / "SEPT078M.21P")


def spoofed(samples, system, shift_m, clock_m=lambda _: 0.0):
    """Decisions in a fault that moves one system north by shift_m(s) and its clock by clock_m(s),
    ranges alone; each with the seconds since its begin."""
    detector = Detector()
    state = detector.new_state()
    for sample in samples:  # the orbits first, as the fault needs directions
        if not isinstance(sample, Epoch):
            _, state = detector.step(sample, state)
    begin_us = next(s.t_us for s in samples if isinstance(s, Epoch)) + round(BEGIN_S * 1e6)
    decisions = []
    for sample in samples:
        since_s = (sample.t_us - begin_us) * 1e-6
        if not isinstance(sample, Epoch) or since_s >= FOR_S:
            continue
        if since_s >= 0.0:
            sample = moved(
                sample, state.core.broadcast.ephemerides, system, shift_m(since_s), clock_m(since_s)
            )
        results, state = detector.step(sample, state)
        decisions += [(since_s, r) for r in results if isinstance(r, Decision) and since_s >= 0.0]
    return decisions


def moved(epoch, ephemerides, system, shift_m, clock_m):
    """An epoch as received 'shift_m' further north by one system."""
    observed = observe_epoch(epoch, select_ephemerides(epoch, ephemerides, "GE"))
    seen = predict_ranges(
        observed.satellite_states, ANTENNA_M, np.zeros(3), observed.measurements.tow_s, np.zeros(8)
    )
    along = dict(
        zip(observed.satellites, seen[:, LINE_OF_SIGHT : LINE_OF_SIGHT + 3] @ NORTH_M, strict=True)
    )
    change = [
        clock_m - along[name] * shift_m if name[0] == system and name in along else 0.0
        for name in epoch.satellites
    ]
    return replace(epoch, pseudorange_m=epoch.pseudorange_m + np.array(change))


def error_m(decision):
    return float(np.linalg.norm(np.subtract(decision.position_ecef_m, ANTENNA_M)))


def test_a_fault_of_a_systems_clock_changes_no_height_and_excludes_no_satellite(static):
    found = spoofed(static, "E", lambda _: 0.0, lambda since_s: 0.9 * since_s)
    assert len(found) == FOR_S
    assert min(s for s, decision in found if decision.alarm) < 6.0
    assert all(decision.excluded == () for _, decision in found)
    assert max(error_m(decision) for _, decision in found) < 3.0


@pytest.mark.parametrize("system", ["G", "E"])
def test_a_system_that_jumps_is_excluded_at_once_and_the_position_stays(static, system):
    found = spoofed(static, system, lambda _: 30.0)
    for _, decision in found:
        assert {name[0] for name in decision.excluded} == {system}
        assert {name[0] for name in decision.satellites} - {system}
        assert error_m(decision) < 3.5
    assert found[0][1].alarm


@pytest.mark.parametrize("system", ["G", "E"])
def test_a_slow_carry_off_of_one_system_is_declared_and_its_position_covered(static, system):
    found = spoofed(static, system, lambda since_s: 1.0 * since_s)
    alarmed_s = min(s for s, decision in found if decision.alarm)
    assert alarmed_s < 10.0
    undecided = [d for s, d in found if s >= alarmed_s and d.hypothesis == "multiple-unknown"]
    assert "it is ambiguous which" in undecided[0].reason
    for since_s, decision in found:
        assert error_m(decision) < min(8.0, decision.hpl_m), since_s
        assert not decision.excluded
        if since_s >= alarmed_s:
            assert decision.hpl_m > since_s
            assert decision.level_assumes == "at most one satellite or system is wrong"
