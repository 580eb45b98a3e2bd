"""All satellites carried off together, with raw ranges and an IMU: what is isolated and used."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.detection.isolation.all_satellites import FOLLOWED_REASON
from analysis.recordings.read_recordings import read_rinex, read_rinex_samples
from analysis.results import Decision, SensorDecision
from analysis.samples.sample import ImuSample, Sample, TruthSample
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.schedule.entries import parse_schedule

FROM_S, FLOWN_S = 25.0, 45.0
Flights = Callable[..., list[Sample]]


def run_on(samples: list[Sample]) -> tuple[list[Decision], list[float], list[SensorDecision]]:
    """Decisions, the errors of their positions in m, and the IMU's own results."""
    results = run_detector(Detector(DetectorConfig()), samples)
    truth = {
        s.t_us: ecef_from_geodetic(*np.radians([s.lat_deg, s.lon_deg]), s.alt_m)
        for s in samples
        if isinstance(s, TruthSample)
    }
    # At the one epoch where the filter is given up there is no position.
    decisions = [r for r in results if isinstance(r, Decision) and r.position_ecef_m]
    errors = [float(np.linalg.norm(d.position_ecef_m - truth[d.t_us])) for d in decisions]
    return decisions, errors, [r for r in results if isinstance(r, SensorDecision)]


def faulty(samples: list[Sample], gyro_rps: float, accel_mps2: float) -> list[Sample]:
    """The IMU off along x from the start of the fault on."""
    x = np.array([1.0, 0.0, 0.0])
    return [
        replace(
            s,
            gyro_b_rps=s.gyro_b_rps + gyro_rps * x,
            accel_b_mps2=s.accel_b_mps2 + accel_mps2 * x,
        )
        if isinstance(s, ImuSample) and s.t_us >= FROM_S * 1e6
        else s
        for s in samples
    ]


@pytest.mark.parametrize(
    ("leap_m", "speed_mps"),
    [(0.0, 0.5), (0.0, 1.0), (0.0, 2.0), (0.0, 5.0), (20.0, 0.0), (200.0, 0.0)],
)
def test_for_a_carry_off_of_all_satellites_the_imu_is_not_isolated(
    leap_m: float, speed_mps: float, flights: Flights
) -> None:
    def away(t_s: float) -> tuple[float, float]:
        since_s = t_s - FROM_S
        return (leap_m + speed_mps * since_s, speed_mps) if since_s >= 0.0 else (0.0, 0.0)

    decisions, errors, imu = run_on(flights(FLOWN_S, 2, away=away))
    assert "imu" not in {d.hypothesis for d in decisions}
    assert not [r for r in imu if r.alarm]
    first = next(d for d in decisions if d.alarm)
    assert FROM_S * 1e6 <= first.t_us < (FROM_S + 3.0) * 1e6
    for decision, error_m in zip(decisions, errors, strict=True):
        if decision.position_sigma_m:
            assert error_m < 2.0 * float(np.linalg.norm(decision.position_sigma_m))
    pairs = zip(decisions, errors, strict=True)
    bounded = [error_m for decision, error_m in pairs if decision.position_sigma_m]
    # A slow drag is taken back once it is known well enough.
    assert max(bounded) < (1.5 if 0.0 < speed_mps <= 1.0 else 3.0)
    # Left alone for too long the filter follows them, and says so.
    assert decisions[-1].position_sigma_m is None
    assert decisions[-1].reason
    assert errors[-1] > 0.8 * (leap_m + 20.0 * speed_mps)


@pytest.mark.parametrize("speed_mps", [1.0, 5.0])
def test_satellites_that_were_led_away_for_a_while_are_used_again(
    speed_mps: float, flights: Flights
) -> None:
    def away(t_s: float) -> tuple[float, float]:
        since_s = t_s - FROM_S
        return (speed_mps * since_s, speed_mps) if 0.0 <= since_s < 6.0 else (0.0, 0.0)

    decisions, errors, _ = run_on(flights(FLOWN_S, 3, away=away))
    assert {d.hypothesis for d in decisions} == {"none", "gps"}
    assert decisions[-1].position_sigma_m is not None
    assert max(errors) < 5.0
    assert errors[-1] < 1.5


@pytest.mark.parametrize("speed_mps", [0.4, 0.5])
def test_at_the_end_of_a_followed_drag_the_imu_is_not_isolated(
    speed_mps: float, flights: Flights
) -> None:
    def away(t_s: float) -> tuple[float, float]:
        since_s = t_s - FROM_S
        return (speed_mps * since_s, speed_mps) if 0.0 <= since_s < 18.0 else (0.0, 0.0)

    # Long enough to be given up; it ends in less than the leap that no IMU makes.
    decisions, _, _ = run_on(flights(FLOWN_S + 5.0, 2, away=away))
    assert "imu" not in {d.hypothesis for d in decisions}
    assert decisions[-1].position_sigma_m is None


@pytest.mark.parametrize(("gyro_rps", "accel_mps2"), [(0.1, 0.0), (0.0, 1.0), (0.0, 8.0)])
def test_a_wrong_imu_is_still_the_imu(gyro_rps: float, accel_mps2: float, flights: Flights) -> None:
    decisions, errors, imu = run_on(faulty(flights(FLOWN_S, 4), gyro_rps, accel_mps2))
    assert {d.hypothesis for d in decisions if d.alarm} == {"imu"}
    assert [r for r in imu if r.alarm]
    assert all(d.position_sigma_m is not None for d in decisions)
    assert max(errors[-50:]) < 3.0


@pytest.mark.parametrize("speed_mps", [1.0, 2.0, 5.0])
def test_a_drag_in_a_real_walk_and_its_end_are_never_the_imu_alone(
    speed_mps: float, shared_data: Path
) -> None:
    folder = shared_data / "gnss_imu_walk"
    obs, nav, imu = (folder / n for n in ("walk_ex.obs", "walk_ex.nav", "imu_1730_sf.csv"))
    segment = {"at_s": 0, "for_s": 30, "start": 0, "rate": speed_mps}
    entry = {"id": "drag", "fault": "plant", "target": "PLANT.spoof_north_m[all]", "at_s": 60}
    entry |= {"for_s": 30, "profile": {"segments": [segment]}}
    lines, _ = faulted_lines(obs, parse_schedule({"faults": [entry]}), [nav])
    detector = Detector(DetectorConfig())
    results, _ = detector.step(read_rinex(obs, [nav], imu, lines), detector.new_state())
    decisions = [r for r in results if isinstance(r, Decision)]
    assert "imu" not in {d.hypothesis for d in decisions}
    alarm_us = next(d.t_us for d in decisions if d.alarm and "gps" in d.hypothesis.lower())
    after_s = (alarm_us - decisions[0].t_us) * 1e-6 - 60.0
    # 1 m/s is not separable from multipath: it is detected when it ends.
    assert after_s == pytest.approx(0.0 if speed_mps > 1.0 else 30.0, abs=0.1)


def test_an_imu_that_is_isolated_later_restores_the_bounds_of_the_position(
    shared_data: Path,
) -> None:
    folder = shared_data / "gnss_imu_walk"
    files = folder / "walk_ex.obs", folder / "walk_ex.nav", folder / "imu_1730_sf.csv"
    samples = read_rinex_samples(*files)
    begin_us = next(s.t_us for s in samples if isinstance(s, ImuSample))
    x = np.array([0.3, 0.0, 0.0])
    wrong = [
        replace(s, gyro_b_rps=s.gyro_b_rps + x)
        if isinstance(s, ImuSample) and 55.0 <= (s.t_us - begin_us) * 1e-6 < 70.0
        else s
        for s in samples
    ]
    decisions = [
        r for r in run_detector(Detector(DetectorConfig()), wrong) if isinstance(r, Decision)
    ]
    blamed = [d for d in decisions if d.alarm and d.hypothesis in ("imu", "GPS-or-imu")]
    assert {d.hypothesis for d in blamed} == {"imu", "GPS-or-imu"}
    unbounded = [d for d in decisions if d.reason == FOLLOWED_REASON]
    assert unbounded[0].t_us == blamed[0].t_us
    assert unbounded[-1].t_us < blamed[-1].t_us
    assert decisions[-1].position_sigma_m is not None
