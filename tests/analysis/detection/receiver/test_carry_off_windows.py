"""A receiver that is carried off too slowly for any single fix to show it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.results import Decision
from analysis.samples.sample import Epoch, GpsFix, ImuSample, MagSample, Sample

FROM_US, UNTIL_US, FLOWN_S = 30_000_000, 46_000_000, 60.0
METRES_PER_DEGREE = 111_200.0
Flights = Callable[..., list[Sample]]


@pytest.fixture(scope="module")
def without_ranges(flights: Flights) -> list[Sample]:
    return [s for s in flights(FLOWN_S, 2, with_fix=True) if not isinstance(s, Epoch)]


def spoofed(
    samples: list[Sample], speed_mps: float, until_us: int = UNTIL_US, growth_mps2: float = 0.0
) -> list[Sample]:
    """Fixes dragged to the north, position and velocity alike, until the spoofer ends."""
    out: list[Sample] = []
    for sample in samples:
        if isinstance(sample, GpsFix) and FROM_US <= sample.t_us < until_us:
            assert sample.v_ned_mps is not None
            since_s = (sample.t_us - FROM_US) * 1e-6
            away_m = speed_mps * since_s + growth_mps2 * since_s**2 / 2
            lat_deg = sample.lat_deg + away_m / METRES_PER_DEGREE
            v_ned_mps = sample.v_ned_mps + np.array([speed_mps + growth_mps2 * since_s, 0.0, 0.0])
            sample = replace(sample, lat_deg=lat_deg, v_ned_mps=v_ned_mps)
        out.append(sample)
    return out


def pushed(samples: list[Sample], accel_b_mps2: float, until_us: int) -> list[Sample]:
    """An accelerometer that says too much along x from 30 s on."""
    push = np.array([accel_b_mps2, 0.0, 0.0])
    return [
        replace(s, accel_b_mps2=s.accel_b_mps2 + push)
        if isinstance(s, ImuSample) and FROM_US < s.t_us <= until_us
        else s
        for s in samples
    ]


def decided(samples: list[Sample]) -> list[Decision]:
    return [r for r in run_detector(Detector(DetectorConfig()), samples) if isinstance(r, Decision)]


def apart_m(one: Decision, same: Decision) -> float:
    assert one.position_ecef_m is not None
    assert same.position_ecef_m is not None
    return float(np.linalg.norm(np.subtract(one.position_ecef_m, same.position_ecef_m)))


@pytest.fixture(scope="module")
def clean(without_ranges: list[Sample]) -> list[Decision]:
    """What is decided of the flight without spoofing."""
    return decided(without_ranges)


@pytest.mark.parametrize("speed_mps", [1.0, 1.3, 5.0])
def test_a_carry_off_is_detected_within_three_seconds_and_removed(
    speed_mps: float, without_ranges: list[Sample], clean: list[Decision]
) -> None:
    found = decided(spoofed(without_ranges, speed_mps))
    first = next(i for i, decision in enumerate(found) if decision.alarm)
    assert FROM_US <= found[first].t_us < FROM_US + 3_000_000
    assert {decision.hypothesis for decision in found if decision.alarm} == {"gps"}
    assert found[first].excluded == ("GPS", "gps-velocity")
    # What the filter had followed is no longer in its position.
    assert apart_m(found[first], clean[first]) < 0.5


@pytest.mark.parametrize("speed_mps", [1.0, 5.0])
def test_the_receiver_is_readmitted_after_the_spoofing_and_not_because_the_filter_drifts(
    speed_mps: float, without_ranges: list[Sample], clean: list[Decision]
) -> None:
    found = decided(spoofed(without_ranges, speed_mps))
    first = next(decision.t_us for decision in found if decision.alarm)
    readmitted_us = UNTIL_US + round(DetectorConfig().readmit_s * 1e6)
    for decision in found:
        if first <= decision.t_us < readmitted_us:
            assert decision.excluded == ("GPS", "gps-velocity")
    assert found[-1].hypothesis == "none"
    assert found[-1].excluded == ()
    assert found[-1].position_sigma_m is not None
    assert apart_m(found[-1], clean[-1]) < 1.0


def test_a_position_from_the_imu_alone_soon_has_no_bound(
    without_ranges: list[Sample], clean: list[Decision]
) -> None:
    found = decided(spoofed(without_ranges, 5.0))
    carried = [(d, c) for d, c in zip(found, clean, strict=True) if "GPS" in d.excluded]
    assert all(apart_m(d, c) < 2.0 for d, c in carried if d.position_sigma_m is not None)
    unbounded = [d for d, _ in carried if d.position_sigma_m is None]
    assert len(unbounded) > len(carried) // 2
    assert all("the position is the IMU's alone" in d.reason for d in unbounded)


@pytest.mark.parametrize("accel_b_mps2", [0.5, 1.0, 2.0])
def test_a_faulty_accelerometer_raises_an_alarm_and_the_receiver_is_not_isolated(
    accel_b_mps2: float, without_ranges: list[Sample]
) -> None:
    found = decided(pushed(without_ranges, accel_b_mps2, round(FLOWN_S * 1e6)))
    assert "gps" not in {decision.hypothesis for decision in found}
    alarms = [decision for decision in found if decision.alarm]
    assert FROM_US <= alarms[0].t_us < FROM_US + 3_000_000
    assert alarms[0].hypothesis in ("imu", "GPS-or-imu")


@pytest.mark.parametrize("growth_mps2", [0.5, 1.0, 2.0])
def test_a_slowly_growing_drag_ends_the_bound_before_it_matters(
    growth_mps2: float, without_ranges: list[Sample], clean: list[Decision]
) -> None:
    found = decided(spoofed(without_ranges, 0.0, growth_mps2=growth_mps2))
    dragged = [(d, c) for d, c in zip(found, clean, strict=True) if FROM_US <= d.t_us < UNTIL_US]
    assert "imu" not in {decision.hypothesis for decision, _ in dragged}
    first = next(decision for decision, _ in dragged if decision.alarm)
    assert first.t_us < FROM_US + 5_000_000
    assert max(apart_m(d, c) for d, c in dragged if d.position_sigma_m is not None) < 8.0
    assert max(apart_m(d, c) for d, c in dragged) > 40.0 * growth_mps2  # it is followed, unbounded


def test_an_impact_that_the_imu_overstates_is_no_spoofing(without_ranges: list[Sample]) -> None:
    # A tenth of a second: 1.2 m/s, as a step of the receiver's velocity would be.
    found = decided(pushed(without_ranges, 12.0, FROM_US + 100_000))
    assert {decision.hypothesis for decision in found} == {"none"}


def sinking(v_down_mps: Callable[[float], float]) -> list[Sample]:
    """A vehicle whose IMU feels steady flight, and whose receiver sinks with a velocity in m/s by
    the time in s."""
    rng, down_m, out = np.random.default_rng(3), 0.0, []
    for step in range(6_000):
        t_us, t_s = step * 10_000, step * 0.01
        down_m += v_down_mps(t_s) * 0.01
        accel_b_mps2 = np.array([0.0, 0.0, -9.81]) + rng.normal(0.0, 0.02, 3)
        out.append(ImuSample(t_us, rng.normal(0.0, 1e-3, 3), accel_b_mps2))
        if step % 20 == 0:
            v_ned_mps = np.array([0.0, 0.0, v_down_mps(t_s)]) + rng.normal(0.0, 0.05, 3)
            fix = (47.0, 8.0, 500.0 - down_m, v_ned_mps, 3, 10, 1.0, 1.5, "HIL_GPS")
            out += [MagSample(t_us, np.array([0.21, 0.02, 0.43])), GpsFix(t_us, *fix)]
    return out


def test_a_touch_down_that_the_imu_misses_is_no_spoofing() -> None:
    landed = decided(sinking(lambda t_s: 0.7 if t_s < 40.0 else 0.0))
    assert {decision.hypothesis for decision in landed} == {"none"}
    faster = decided(sinking(lambda t_s: 0.7 if t_s < 40.0 else 1.4))
    assert "gps" in {decision.hypothesis for decision in faster}


@pytest.mark.parametrize("speed_mps", [1.7, 2.0, 3.0])
def test_a_faster_carry_off_isolates_the_receiver_or_is_undecided_and_unbounded(
    speed_mps: float, without_ranges: list[Sample]
) -> None:
    found = decided(spoofed(without_ranges, speed_mps))
    first = next(decision for decision in found if decision.alarm)
    assert FROM_US <= first.t_us < FROM_US + 3_000_000
    assert "imu" not in {decision.hypothesis for decision in found}
    undecided = [d for d in found if d.hypothesis == "GPS-or-imu"]
    assert all(decision.position_sigma_m is None for decision in undecided)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_clean_flight_has_no_carry_off(seed: int, flights: Flights) -> None:
    samples = [s for s in flights(FLOWN_S, seed, with_fix=True) if not isinstance(s, Epoch)]
    assert {decision.hypothesis for decision in decided(samples)} == {"none"}
