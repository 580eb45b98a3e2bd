"""The other sensors against the filter, and the detector without raw ranges."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.recordings.read_recordings import read_log
from analysis.results import Decision, SensorDecision
from analysis.samples.block import block_of
from analysis.samples.sample import (
    AirspeedSample,
    BaroSample,
    Epoch,
    GpsFix,
    ImuSample,
    MagSample,
    RangeSample,
    Sample,
    TruthSample,
    VisionSample,
)
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat

FROM_S, UNTIL_S = 30.0, 40.0
FIELD_NED = np.array([0.21, 0.02, 0.43])  # gauss, middle Europe
WIND_NED = np.array([3.0, -2.0, 0.0])
SENSORS = ("baro", "airspeed", "mag", "range", "vision", "gps-position", "gps-velocity")


def readings(truth: TruthSample, rng: np.random.Generator, fault: str) -> list[Sample]:
    """What healthy sensors measure at the truth, one of them faulty between FROM_S and UNTIL_S."""
    bad = {name: 0.0 for name in SENSORS}
    if FROM_S <= truth.t_us * 1e-6 < UNTIL_S and fault:
        bad[fault] = 1.0
    t_us, rot = truth.t_us - 4000, matrix_from_quat(truth.q_nb)
    alt = truth.alt_m + 3.0 + rng.normal(0, 0.3) + 30.0 * bad["baro"]
    pressure = 101_325.0 * (1.0 - 6.5e-3 * alt / 288.15) ** 5.25588
    density = 1.225 * (1.0 - 6.5e-3 * truth.alt_m / 288.15) ** 4.25588
    speed = np.linalg.norm(truth.v_ned_mps - WIND_NED) + rng.normal(0, 0.3) - 8 * bad["airspeed"]
    field = rot.T @ FIELD_NED + rng.normal(0, 0.005, 3) + np.array([0.3, 0, 0]) * bad["mag"]
    lat, lon = math.radians(truth.lat_deg), math.radians(truth.lon_deg)
    home = ecef_from_geodetic(math.radians(47.4), math.radians(8.55), 500.0)
    sl, cl, so, co = math.sin(0.8273), math.cos(0.8273), math.sin(0.14923), math.cos(0.14923)
    axes = np.array([[-sl * co, -sl * so, cl], [-so, co, 0.0], [-cl * co, -cl * so, -sl]])
    r_ned = axes @ (np.asarray(ecef_from_geodetic(lat, lon, truth.alt_m)) - home)
    return [
        BaroSample(t_us, pressure, alt),
        AirspeedSample(t_us, 0.5 * density * speed**2),
        MagSample(t_us, field),
        RangeSample(t_us, (truth.alt_m - 400.0) / max(rot[2, 2], 0.3) + 10.0 * bad["range"]),
        VisionSample(t_us, r_ned + np.array([15.0, 0, 0]) * bad["vision"], None, truth.q_nb),
        GpsFix(
            truth.t_us,
            truth.lat_deg + 5e-4 * bad["gps-position"],
            truth.lon_deg,
            truth.alt_m,
            truth.v_ned_mps + 5.0 * bad["gps-velocity"],
            3,
            10,
            1.0,
            1.5,
            "HIL_GPS",
        ),
    ]


def with_sensors(flight: list[Sample], fault: str) -> list[Sample]:
    rng = np.random.default_rng(4)
    truths = {s.t_us: s for s in flight if isinstance(s, TruthSample)}
    out: list[Sample] = []
    for sample in flight:
        if isinstance(sample, Epoch):
            out += readings(truths[sample.t_us], rng, fault)
        out.append(sample)
    return out


def judged(samples: list[Sample]) -> list[SensorDecision]:
    references = NavigationDetector(DetectorConfig())
    results, _ = references.step(block_of(samples), references.new_state())
    return [r for r in results if isinstance(r, SensorDecision)]


def test_healthy_sensors_raise_no_alarm(flight):
    found = judged(with_sensors(flight, ""))
    assert {r.sensor for r in found} >= set(SENSORS)
    assert not [r for r in found if r.alarm]
    tested = [r for r in found if r.sensor == "baro" and r.statistic is not None]
    assert len(tested) > 250


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_faulty_sensor_alone_is_isolated(flight, sensor: str):
    found = judged(with_sensors(flight, sensor))
    isolated = {r.sensor for r in found if r.isolated}
    first = next(r for r in found if r.alarm)
    assert isolated == {sensor}
    assert first.t_s == pytest.approx(FROM_S, abs=0.41)


def test_a_barometer_that_returns_from_a_slow_drift_is_not_isolated(flight):
    """The filter has followed the drift of 0.4 m/s, so the return looks like a fault."""
    samples = with_sensors(flight, "")
    for i, sample in enumerate(samples):
        since_s = sample.t_us * 1e-6 - 15.0
        if isinstance(sample, BaroSample) and 0.0 < since_s < UNTIL_S - 15.0:
            # 12 Pa is a metre.
            samples[i] = replace(sample, pressure_pa=sample.pressure_pa - 12.0 * 0.4 * since_s)
    later = [r for r in judged(samples) if r.sensor == "baro" and r.t_s > UNTIL_S]
    assert len(later) > 20
    assert not any(r.isolated for r in later)


def test_a_jumping_receiver_is_separable_from_the_imu_without_raw_ranges(shared_data: Path):
    path = next((shared_data / "px4_hil").glob("*_hil.tlog"))
    samples = [sample for block in read_log(path) for sample in block.samples()]
    found = [
        r for r in run_detector(Detector(DetectorConfig()), samples) if isinstance(r, Decision)
    ]
    alarms = [d for d in found if d.alarm]
    assert alarms[0].t_s == pytest.approx(41.0, abs=0.2)
    assert {d.hypothesis for d in alarms} == {"gps"}
    out = [d.t_s for d in found if "GPS" in d.excluded]
    assert out[-1] == pytest.approx(56.0 + DetectorConfig().readmit_s, abs=0.5)


def test_a_faulty_imu_is_separable_from_the_receiver_without_raw_ranges(flights):
    samples = [s for s in flights(45.0, 2, with_fix=True) if not isinstance(s, Epoch)]
    faulty = [
        replace(s, accel_b_mps2=s.accel_b_mps2 + np.array([0.0, 8.0, 0.0]))
        if isinstance(s, ImuSample) and s.t_us >= 30_000_000
        else s
        for s in samples
    ]
    found = [r for r in run_detector(Detector(DetectorConfig()), faulty) if isinstance(r, Decision)]
    first = next(d for d in found if d.alarm)
    assert first.hypothesis == "imu"
    assert 30.0 <= first.t_s < 31.0


def spoofed(sample: Sample, speed_mps: float) -> Sample:
    """A fix whose position runs away to the north from 30 s, and its velocity with it."""
    if not isinstance(sample, GpsFix) or sample.t_us < 30_000_000:
        return sample
    assert sample.v_ned_mps is not None
    away_deg = speed_mps * (sample.t_us - 30_000_000) * 1e-6 / 111_200.0
    v_ned_mps = sample.v_ned_mps + np.array([speed_mps, 0.0, 0.0])
    return replace(sample, lat_deg=sample.lat_deg + away_deg, v_ned_mps=v_ned_mps)


def test_spoofing_of_position_and_velocity_together_does_not_isolate_the_imu(flights):
    samples = [s for s in flights(45.0, 2, with_fix=True) if not isinstance(s, Epoch)]
    spoof = [spoofed(s, 5.0) for s in samples]
    found = [r for r in run_detector(Detector(DetectorConfig()), spoof) if isinstance(r, Decision)]
    alarms = [d for d in found if d.alarm]
    assert alarms[0].t_s == pytest.approx(30.0, abs=0.21)
    assert alarms[0].excluded == ("GPS", "gps-velocity")
    assert {d.hypothesis for d in alarms} == {"gps"}


def test_an_undecided_receiver_or_imu_is_reported_so_and_its_position_is_unbounded(flights):
    samples = [s for s in flights(45.0, 2, with_fix=True) if not isinstance(s, Epoch)]
    faulty = [
        replace(s, gyro_b_rps=s.gyro_b_rps + np.array([0.1, 0.0, 0.0]))
        if isinstance(s, ImuSample) and s.t_us >= 30_000_000
        else s
        for s in samples
    ]
    found = [r for r in run_detector(Detector(DetectorConfig()), faulty) if isinstance(r, Decision)]
    first = next(d for d in found if d.alarm)
    assert first.hypothesis == "GPS-or-imu"
    assert first.position_sigma_m is None
    assert first.excluded == ()


def test_a_field_of_the_right_size_in_a_wrong_direction_isolates_no_sensor(flight):
    across = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    samples = [
        replace(s, field_b_gauss=across @ s.field_b_gauss)
        if isinstance(s, MagSample) and FROM_S <= s.t_us * 1e-6 < UNTIL_S
        else s
        for s in with_sensors(flight, "")
    ]
    found = [r for r in judged(samples) if r.sensor == "mag"]
    assert any(r.alarm for r in found)
    assert not any(r.isolated for r in found)


def test_a_fix_that_is_none_is_untestable():
    fix = GpsFix(1, 47.0, 8.0, 400.0, None, 2, 3, 1.0, 1.0, "HIL_GPS")
    cases = [
        (fix, "fix type 2"),
        (replace(fix, fix_type=3, lat_deg=math.nan), "not finite"),
        (replace(fix, fix_type=3, lat_deg=0.0, lon_deg=0.0), "0, 0"),
    ]
    for bad, reason in cases:
        (result,) = run_detector(Detector(DetectorConfig()), [bad])
        assert result.hypothesis == "untestable"
        assert reason in result.reason


def test_a_result_is_not_older_than_its_sample(flight):
    # An epoch that is decided 60 ms after its stamp, when newer readings are there already.
    begun_us = round((FROM_S + 0.03) * 1e6)
    samples = [
        replace(s, t_us=s.t_us + 64_000) if isinstance(s, MagSample) else s
        for s in with_sensors(flight, "")
    ]
    wrong = [
        replace(s, field_b_gauss=s.field_b_gauss + np.array([0.3, 0.0, 0.0]))
        if isinstance(s, MagSample) and s.t_us >= begun_us
        else s
        for s in samples
    ]
    alarms = [r for r in judged(wrong) if r.sensor == "mag" and r.alarm]
    assert alarms
    assert min(r.t_us for r in alarms) >= begun_us


def falling(speed_mps: float, still_from: int) -> list[Sample]:
    """Fixes at 5 Hz of something that falls and lies still from one of them on."""
    fixes: list[Sample] = []
    for number in range(60):
        down_mps = speed_mps if number < still_from else 0.0
        down_m = speed_mps * 0.2 * min(number, still_from)
        velocity = np.array([0.0, 0.0, down_mps])
        fixes.append(
            GpsFix(200_000 * number, 47.4, 8.5, 900 - down_m, velocity, 3, 12, 1.0, 1.5, "HIL_GPS")
        )
    return fixes


def test_an_impact_with_the_ground_is_not_the_receivers_fault():
    decisions = run_detector(Detector(DetectorConfig()), falling(20.0, 30))
    assert {r.hypothesis for r in decisions if isinstance(r, Decision)} == {"none"}


def test_a_frozen_velocity_of_a_moving_position_is_the_receivers_fault():
    fixes = falling(20.0, 60)
    lying = [replace(s, v_ned_mps=np.zeros(3)) for s in fixes[30:] if isinstance(s, GpsFix)]
    decisions = run_detector(Detector(DetectorConfig()), [*fixes[:30], *lying])
    found_isolated = [r for r in decisions if isinstance(r, Decision) and r.hypothesis == "gps"]
    assert found_isolated[0].t_us <= 200_000 * 31
