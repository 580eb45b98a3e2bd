"""The complete sensor: truth in, readings out."""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.rtcm.ephemeris_messages import decode_ephemeris
from mavproxy_fault.rtcm.msm7 import decode_msm7, encode_epoch
from simvehicle.gnss.gnss_config import ClockConfig, GnssConfig, ReceiverConfig
from simvehicle.gnss.gnss_sensor import GnssSensor, GnssState
from simvehicle.gnss.satellite_orbits import tabulate_orbits
from simvehicle.sensors.readings import EphemerisReading, GpsReading, PseudorangeReading
from simvehicle.vehicles.body import Truth
from tests.simvehicle.gnss.gnss_parts import gnss_sensor, satellite_states

TruthAt = Callable[..., Truth]
Home = tuple[float, float]
STEP_US = 200_000


def fly(
    sensor: GnssSensor,
    truth_at: TruthAt,
    epochs: int,
    plant: dict[int, list[tuple[str, float | None]]] | None = None,
    seed: int = 1,
    **truth: Any,
) -> list[tuple[list[Any], GnssState]]:
    """Readings and state of each epoch; `plant` sets parameters before an epoch."""
    rng = np.random.default_rng(seed)
    state = sensor.new_state(rng)
    out = []
    for k in range(epochs):
        for name, value in (plant or {}).get(k, []):
            state = sensor.with_plant(state, name, value)
        readings, state = sensor.sample(truth_at(t_us=k * STEP_US, **truth), state, rng)
        out.append((readings, state))
    return out


def one(readings: list[Any], kind: type) -> Any:
    (reading,) = [r for r in readings if isinstance(r, kind)]
    return reading


def test_without_errors_pseudoranges_are_geometry_and_satellite_clocks(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    readings, _ = fly(gnss_sensor(perfect, *home), truth_at, 1)[0]
    raw = one(readings, PseudorangeReading)
    sent = {
        r.satellite: decode_ephemeris(r.rtcm) for r in readings if isinstance(r, EphemerisReading)
    }
    place = ecef_from_geodetic(*home, 535.0)
    assert set(raw.satellites) == set(sent)
    for k, name in enumerate(raw.satellites):
        orbits = tabulate_orbits([sent[name]], raw.week)
        flight_s = 0.07
        for _ in range(8):
            r, _, clock, _ = satellite_states(orbits, np.array([raw.tow_s - flight_s]))
            turn = 7.2921151467e-5 * flight_s
            s, c = math.sin(turn), math.cos(turn)
            seen = np.array([c * r[0, 0] + s * r[0, 1], c * r[0, 1] - s * r[0, 0], r[0, 2]])
            flight_s = float(np.linalg.norm(seen - place)) / SPEED_OF_LIGHT_MPS
        expected = SPEED_OF_LIGHT_MPS * (flight_s - clock[0])
        assert raw.pseudorange_m[k] == pytest.approx(expected, abs=1e-5)


def test_without_errors_the_solution_is_the_truth(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    v = (15.0, -20.0, 2.5)
    for readings, _ in fly(gnss_sensor(perfect, *home), truth_at, 3, v_ned_mps=v):
        fix = one(readings, GpsReading)
        assert fix.lat_deg == pytest.approx(math.degrees(home[0]), abs=1e-9)
        assert fix.lon_deg == pytest.approx(math.degrees(home[1]), abs=1e-9)
        assert fix.alt_m == pytest.approx(535.0 - 47.0, abs=1e-4)
        assert fix.v_ned_mps == pytest.approx(v, abs=2e-4)
        assert fix.fix_type == 3


def test_a_clock_error_changes_neither_position_nor_geometry(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    clock = ClockConfig(offset_s=2e-4, drift=5e-7, h0_s=0.0, h2_hz=0.0, galileo_offset_m=7.0)
    sensor = gnss_sensor(msgspec.structs.replace(perfect, clock=clock), *home)
    for readings, state in fly(sensor, truth_at, 3, v_ned_mps=(30.0, 0.0, 0.0)):
        fix = one(readings, GpsReading)
        late_m = 30.0 * state.clock.offset_s  # sampled on its own clock
        moved = (fix.lat_deg - math.degrees(home[0])) * 111_200.0
        assert moved == pytest.approx(-late_m, abs=1e-3)
        assert fix.alt_m == pytest.approx(488.0, abs=1e-3)
        assert state.fix is not None
        assert state.fix.clock_m[0] == pytest.approx(
            state.clock.offset_s * SPEED_OF_LIGHT_MPS, abs=1e-3
        )


@pytest.mark.parametrize(
    ("change", "least_m", "most_m"),
    [
        ({"ionosphere": True}, 1.4, 30.0),
        ({"troposphere": True}, 2.0, 15.0),
        ({"orbit_m": 1.0}, 0.05, 4.0),
        ({"multipath": 1.0}, 0.01, 3.0),
        ({"thermal": 1.0}, 0.005, 4.0),
    ],
)
def test_each_error_alone_acts_on_the_pseudoranges(
    perfect: GnssConfig,
    truth_at: TruthAt,
    home: Home,
    change: dict[str, Any],
    least_m: float,
    most_m: float,
) -> None:
    clean = one(fly(gnss_sensor(perfect, *home), truth_at, 1)[0][0], PseudorangeReading)
    config = msgspec.structs.replace(perfect, **change)
    wrong = one(fly(gnss_sensor(config, *home), truth_at, 1)[0][0], PseudorangeReading)
    error = np.abs(wrong.pseudorange_m - clean.pseudorange_m)
    assert wrong.satellites == clean.satellites
    assert least_m < np.median(error) < most_m
    assert error.max() < most_m


def test_the_default_sky_gives_nine_satellites_and_more_at_five_hertz(
    truth_at: TruthAt, home: Home
) -> None:
    sensor = gnss_sensor(GnssConfig(), *home)
    assert sensor.rate_hz == 5.0
    for readings, _ in fly(sensor, truth_at, 20):
        raw = one(readings, PseudorangeReading)
        assert len(raw.satellites) >= 9
        assert ((raw.pseudorange_m > 1.9e7) & (raw.pseudorange_m < 3.1e7)).all()
        assert (np.abs(raw.doppler_mps) < 1100.0).all()
        assert ((raw.cn0_dbhz > 30.0) & (raw.cn0_dbhz < 52.0)).all()


def test_position_errors_match_the_receivers_sigma(truth_at: TruthAt, home: Home) -> None:
    ratios = []
    for seed in range(40):
        sensor = gnss_sensor(GnssConfig(), *home)
        fix = one(fly(sensor, truth_at, 1, seed=seed)[0][0], GpsReading)
        north = (fix.lat_deg - math.degrees(home[0])) * 111_200.0
        ratios.append((north**2 + (fix.alt_m - 488.0) ** 2) / (fix.eph_m**2 + fix.epv_m**2))
    assert 0.1 < np.mean(ratios) < 1.5


def test_the_reading_survives_its_rtcm_message(truth_at: TruthAt, home: Home) -> None:
    raw = one(fly(gnss_sensor(GnssConfig(), *home), truth_at, 2)[1][0], PseudorangeReading)
    decoded = [
        decode_msm7(m)
        for m in encode_epoch(
            raw.tow_s, raw.satellites, raw.pseudorange_m, raw.doppler_mps, raw.cn0_dbhz
        )
    ]
    ranges = {n: p for d in decoded for n, p in zip(d.satellites, d.pseudorange_m, strict=True)}
    assert raw.tow_s == decoded[0].tow_s == 475200.2
    for name, value in zip(raw.satellites, raw.pseudorange_m, strict=True):
        assert ranges[name] == pytest.approx(value, abs=3e-4)


def test_ephemerides_are_sent_at_once_and_every_half_minute(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    counts = [
        [r.satellite for r in readings if isinstance(r, EphemerisReading)]
        for readings, _ in fly(gnss_sensor(perfect, *home), truth_at, 300)
    ]
    in_view = len(counts[0])
    assert in_view >= 9
    assert all(not c for c in counts[1:150])
    assert all(len(c) == 1 for c in counts[150 : 150 + in_view])
    assert {c[0] for c in counts[150 : 150 + in_view]} == set(counts[0])


def test_a_fault_on_a_satellite_reaches_range_and_position_and_ends(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {
        2: [("pseudorange_m[G17]", 50.0)],
        4: [("pseudorange_m[G17]", None)],
    }
    epochs = fly(gnss_sensor(perfect, *home), truth_at, 6, plant)
    clean = fly(gnss_sensor(perfect, *home), truth_at, 6)
    for k, ((readings, _), (healthy, _)) in enumerate(zip(epochs, clean, strict=True)):
        raw, good = one(readings, PseudorangeReading), one(healthy, PseudorangeReading)
        at = raw.satellites.index("G17")
        expected = np.zeros(len(raw.satellites))
        expected[at] = 50.0 if k in (2, 3) else 0.0
        assert raw.pseudorange_m - good.pseudorange_m == pytest.approx(expected, abs=1e-6)
        moved = abs(one(readings, GpsReading).alt_m - 488.0)
        assert moved > 5.0 if k in (2, 3) else moved < 1e-3


def test_a_lost_satellite_is_gone_and_comes_back_after_its_reacquisition(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {
        1: [("satellite_lost[E13]", 1.0)],
        5: [("satellite_lost[E13]", None)],
    }
    epochs = fly(gnss_sensor(perfect, *home), truth_at, 20, plant)
    there = ["E13" in one(r, PseudorangeReading).satellites for r, _ in epochs]
    assert there == [True] + [False] * 14 + [True] * 5  # back at 1.0 s, reacquired at 3.0 s


def test_a_weak_signal_is_lost_below_the_threshold(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {1: [("cn0_drop_db[all]", 12.0)]}
    epochs = fly(gnss_sensor(perfect, *home), truth_at, 3, plant)
    before, after = (one(epochs[k][0], PseudorangeReading) for k in (0, 2))
    assert 0 < len(after.satellites) < len(before.satellites)
    assert after.cn0_dbhz.min() >= 25.0
    assert before.cn0_dbhz[before.satellites.index("G17")] - after.cn0_dbhz[
        after.satellites.index("G17")
    ] == pytest.approx(12.0, abs=0.01)


def test_all_satellites_lost_is_no_fix_with_a_reason(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {2: [("satellite_lost[all]", 1.0)]}
    readings, state = fly(gnss_sensor(perfect, *home), truth_at, 3, plant)[2]
    fix = one(readings, GpsReading)
    assert (fix.fix_type, fix.satellites, fix.eph_m) == (0, 0, math.inf)
    assert fix.lat_deg == pytest.approx(math.degrees(home[0]), abs=1e-6)  # the last known position
    assert state.fix is not None
    assert (state.fix.fix_type, state.fix.satellites) == (0, 0)
    assert one(readings, PseudorangeReading).satellites == ()


def test_a_cold_start_has_no_fix_at_first_and_a_good_one_within_a_minute(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    config = msgspec.structs.replace(perfect, receiver=ReceiverConfig(start="cold"))
    epochs = fly(gnss_sensor(config, *home), truth_at, 300)
    types = [one(r, GpsReading).fix_type for r, _ in epochs]
    first = types.index(3)
    assert types[0] == 0
    assert 18.0 < first * 0.2 < 45.0
    assert set(types[first:]) == {3}
    eph = [one(r, GpsReading).eph_m for r, _ in epochs]
    assert eph[first] > 1.5 * eph[-1]  # few satellites at first
    assert one(epochs[0][0], GpsReading).lat_deg == 0.0
    assert not any(isinstance(r, EphemerisReading) for r in epochs[0][0])


def test_a_cold_start_goes_through_all_fix_types_with_a_falling_error(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    config = msgspec.structs.replace(perfect, receiver=ReceiverConfig(start="cold"))
    epochs = fly(gnss_sensor(config, *home), truth_at, 300)
    fixes = [one(r, GpsReading) for r, _ in epochs]
    types = [fix.fix_type for fix in fixes]
    assert types == sorted(types)
    assert set(types) == {0, 1, 2, 3}
    flat, full = fixes[types.index(2)], fixes[types.index(3)]
    assert flat.eph_m > 3.0 * full.eph_m > 3.0 * fixes[-1].eph_m
    assert abs(flat.alt_m - truth_at().alt_msl_m) > 100.0  # it assumes a wrong height
    assert full.alt_m == pytest.approx(truth_at().alt_msl_m, abs=1e-3)


def test_after_a_total_loss_of_lock_the_fix_comes_back_without_a_new_start(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {
        5: [("cn0_drop_db[all]", 40.0)],
        10: [("cn0_drop_db[all]", None)],
    }
    epochs = fly(gnss_sensor(perfect, *home), truth_at, 25, plant)
    types = [one(readings, GpsReading).fix_type for readings, _ in epochs]
    back = 10 + round(perfect.receiver.reacquire_s / 0.2)
    assert types == [3] * 5 + [0] * (back - 5) + [3] * (25 - back)


def test_a_receiver_switched_off_is_silent_and_starts_cold(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    plant: dict[int, list[tuple[str, float | None]]] = {
        2: [("receiver_off", 1.0)],
        4: [("receiver_off", None)],
    }
    epochs = fly(gnss_sensor(perfect, *home), truth_at, 6, plant)
    assert [len(readings) for readings, _ in epochs[2:4]] == [0, 0]
    assert one(epochs[4][0], GpsReading).fix_type == 0
    assert one(epochs[1][0], GpsReading).fix_type == 3


def test_beyond_the_file_satellites_vanish_and_the_reason_is_given(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    sensor = gnss_sensor(perfect, *home)
    rng = np.random.default_rng(1)
    state = sensor.new_state(rng)
    for hours, least, most in ((0.0, 15, 24), (3.5, 6, 24), (4.9, 0, 0)):
        for k in range(16):  # long enough to acquire risen satellites
            t_us = int(hours * 3.6e9) + k * STEP_US
            readings, state = sensor.sample(truth_at(t_us=t_us), state, rng)
        count = len(one(readings, PseudorangeReading).satellites)
        assert least <= count <= most, hours
    assert one(readings, GpsReading).fix_type == 0


def test_a_new_ephemeris_is_sent_when_the_old_one_ends(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    sensor = gnss_sensor(msgspec.structs.replace(perfect, systems=("GPS",)), *home)
    rng = np.random.default_rng(1)
    state = sensor.new_state(rng)
    _, state = sensor.sample(truth_at(t_us=7_199_000_000), state, rng)
    readings, state = sensor.sample(truth_at(t_us=7_201_000_000), state, rng)
    news = [decode_ephemeris(r.rtcm) for r in readings if isinstance(r, EphemerisReading)]
    assert news
    assert {e.toe_s for e in news} <= {482384.0, 482400.0}


def test_the_same_seed_gives_the_same_readings(truth_at: TruthAt, home: Home) -> None:
    sensor = gnss_sensor(GnssConfig(receiver=ReceiverConfig(start="cold")), *home)
    runs = [fly(sensor, truth_at, 200, seed=9) for _ in range(2)]
    for (a, _), (b, _) in zip(*runs, strict=True):
        assert [repr(x) for x in a] == [repr(x) for x in b]


def test_sampling_does_not_change_the_state_passed_in(truth_at: TruthAt, home: Home) -> None:
    sensor = gnss_sensor(GnssConfig(), *home)
    rng = np.random.default_rng(2)
    state = sensor.new_state(rng)
    before = repr(state)
    sensor.sample(truth_at(), state, rng)
    sensor.with_plant(state, "pseudorange_m[all]", 5.0)
    assert repr(state) == before


def test_an_unknown_plant_parameter_or_satellite_is_refused(
    perfect: GnssConfig, home: Home
) -> None:
    sensor = gnss_sensor(perfect, *home)
    state = sensor.new_state(np.random.default_rng(1))
    for name in ("pseudorange_m[G99]", "pseudorange[G17]", "pseudorange_m", "off"):
        with pytest.raises(ConfigError, match="is unknown; use receiver_off, or pseudorange_m"):
            sensor.with_plant(state, name, 1.0)


def test_negative_parameters_are_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match=r">= 0.*multipath"):
        msgspec.convert({"multipath": -1.0}, GnssConfig)
    with pytest.raises(msgspec.ValidationError, match=r">= 0.*reacquire_s"):
        msgspec.convert({"receiver": {"reacquire_s": -2}}, GnssConfig)
    with pytest.raises(msgspec.ValidationError, match="unknown field"):
        msgspec.convert({"clock": {"wrong": 1}}, GnssConfig)


def test_home_height_and_speed_reach_the_readings(
    perfect: GnssConfig, truth_at: TruthAt, home: Home
) -> None:
    high = msgspec.structs.replace(truth_at(height_m=4000.0), v_ned_mps=np.array([0.0, 0.0, -9.0]))
    sensor = gnss_sensor(perfect, *home)
    rng = np.random.default_rng(1)
    readings, _ = sensor.sample(high, sensor.new_state(rng), rng)
    fix = one(readings, GpsReading)
    assert fix.alt_m == pytest.approx(3953.0, abs=1e-3)
    assert fix.v_ned_mps == pytest.approx([0.0, 0.0, -9.0], abs=2e-4)
