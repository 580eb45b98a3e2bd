"""Spoofed signals are consistent: the receiver computes the spoofed position from them."""

import numpy as np
import pytest

from mavproxy_fault.numerics.earth import curvature_radii
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.gnss_sensor import GnssSensor, GnssState
from simvehicle.gnss.spoofing import spoofed_places
from simvehicle.sensors.readings import GpsReading, PseudorangeReading
from tests.simvehicle.gnss.gnss_parts import gnss_sensor


def epoch(sensor: GnssSensor, state: GnssState, truth_at, t_s: float):
    """The position and the ranges of one epoch."""
    truth = truth_at(round(t_s * 1e6))
    readings, state = sensor.sample(truth, state, np.random.default_rng(1))
    (fix,) = [one for one in readings if isinstance(one, GpsReading)]
    (ranges,) = [one for one in readings if isinstance(one, PseudorangeReading)]
    return fix, ranges, state


def north_m(fix: GpsReading, clean: GpsReading) -> float:
    meridian_m, _ = curvature_radii(np.radians(clean.lat_deg))
    return float(np.radians(fix.lat_deg - clean.lat_deg) * meridian_m)


@pytest.fixture
def flown(perfect: GnssConfig, home: tuple[float, float], truth_at):
    sensor = gnss_sensor(perfect, *home)
    state = sensor.new_state(np.random.default_rng(0))
    _, _, state = epoch(sensor, state, truth_at, 0.0)
    return sensor, state, truth_at


def test_spoofed_motion_moves_position_and_velocity_consistently(flown) -> None:
    sensor, state, truth_at = flown
    clean, _, _ = epoch(sensor, state, truth_at, 0.2)
    state = sensor.with_plant(state, "spoof_north_m[all]", 1.0)
    fix, _, state = epoch(sensor, state, truth_at, 0.2)
    state = sensor.with_plant(state, "spoof_north_m[all]", 2.0)
    later, _, state = epoch(sensor, state, truth_at, 0.4)
    assert north_m(fix, clean) == pytest.approx(1.0, abs=0.01)
    assert north_m(later, clean) == pytest.approx(2.0, abs=0.01)
    for moving in (fix, later):
        assert moving.v_ned_mps[0] - clean.v_ned_mps[0] == pytest.approx(5.0, abs=0.01)
    state = sensor.with_plant(state, "spoof_north_m[all]", None)
    healthy, _, _ = epoch(sensor, state, truth_at, 0.6)
    assert north_m(healthy, clean) == pytest.approx(0.0, abs=0.01)


def test_one_system_can_be_spoofed_alone(flown) -> None:
    sensor, state, truth_at = flown
    _, clean, _ = epoch(sensor, state, truth_at, 0.2)
    state = sensor.with_plant(state, "spoof_east_m[G]", 50.0)
    _, spoofed, _ = epoch(sensor, state, truth_at, 0.2)
    change = np.abs(spoofed.pseudorange_m - clean.pseudorange_m)
    gps = np.array([name[0] == "G" for name in clean.satellites])
    assert change[~gps].max() == 0.0
    assert change[gps].max() > 10.0


def test_a_spoofed_time_delays_every_range_and_keeps_the_position(flown) -> None:
    sensor, state, truth_at = flown
    clean_fix, clean, _ = epoch(sensor, state, truth_at, 0.2)
    state = sensor.with_plant(state, "spoof_clock_m[all]", 6.0)
    fix, spoofed, _ = epoch(sensor, state, truth_at, 0.2)
    assert spoofed.pseudorange_m - clean.pseudorange_m == pytest.approx(6.0, abs=1e-6)
    assert spoofed.doppler_mps - clean.doppler_mps == pytest.approx(30.0, abs=1e-6)
    assert north_m(fix, clean_fix) == pytest.approx(0.0, abs=1e-3)


def test_a_position_jump_has_no_doppler() -> None:
    spoof = np.zeros((4, 3))
    spoof[0, 1:] = 200.0
    (spoofed,) = spoofed_places(spoof, np.zeros((4, 3)), 0.2)
    assert spoofed.offset_mps.tolist() == [0.0] * 4
    assert spoofed.mask.tolist() == [False, True, True]


def test_a_doppler_fault_leaves_the_ranges_unchanged(flown) -> None:
    sensor, state, truth_at = flown
    _, clean, _ = epoch(sensor, state, truth_at, 0.2)
    state = sensor.with_plant(state, f"range_rate_mps[{clean.satellites[0]}]", 5.0)
    _, faulty, _ = epoch(sensor, state, truth_at, 0.2)
    change_mps = faulty.doppler_mps - clean.doppler_mps
    assert change_mps[0] == pytest.approx(5.0, abs=1e-6)
    assert np.abs(change_mps[1:]).max() == 0.0
    assert np.array_equal(faulty.pseudorange_m, clean.pseudorange_m)
