"""A compass whose field is not that of the Earth at this place."""

import numpy as np
import pytest

from analysis.detection.compass.earth_field_detector import EarthFieldDetector
from analysis.results import SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import GpsFix, ImuSample, MagSample, Sample, Vector
from mavproxy_fault.numerics.magnetic_field import UNKNOWN_DATE, magnetic_field_gauss

PLACE_DEG = (47.4, 8.5)
EARTH_GAUSS = np.array(magnetic_field_gauss(*PLACE_DEG, 0.0, UNKNOWN_DATE))
AT_REST_MPS2 = np.array([0.0, 0.0, -9.81])


def flight(
    field_gauss: Vector, force_mps2: Vector = AT_REST_MPS2, place_deg: tuple = PLACE_DEG
) -> Block:
    """Twelve seconds of compass and IMU at 10 Hz, with a first fix after one."""
    rng = np.random.default_rng(2)
    samples: list[Sample] = []
    for k in range(120):
        t_us = k * 100_000
        samples.append(ImuSample(t_us, np.zeros(3), force_mps2 + rng.normal(0.0, 0.05, 3)))
        samples.append(MagSample(t_us, field_gauss + rng.normal(0.0, 0.002, 3)))
        if k >= 10 and k % 5 == 0:
            v_ned = np.zeros(3)
            samples.append(GpsFix(t_us, *place_deg, 500.0, v_ned, 3, 12, 1.0, 1.0, "GPS_RAW_INT"))
    return block_of(samples)


def alarms(*blocks: Block, detector: EarthFieldDetector | None = None) -> list[SensorDecision]:
    detector = detector or EarthFieldDetector()
    state, found = detector.new_state(), []
    for block in blocks:
        results, state = detector.step(block, state)
        found += [result for _, result in results]
    return found


@pytest.mark.parametrize(
    ("field_gauss", "force_mps2"),
    [
        (EARTH_GAUSS, AT_REST_MPS2),
        (1.35 * EARTH_GAUSS, AT_REST_MPS2),  # as far off as of a real vehicle that flew well
        (EARTH_GAUSS, np.array([4.0, 0.0, -9.81])),  # it gains speed: gravity is not felt alone
        (np.full(3, np.nan), AT_REST_MPS2),
    ],
)
def test_a_healthy_compass_raises_no_alarm(field_gauss: Vector, force_mps2: Vector) -> None:
    assert alarms(flight(field_gauss, force_mps2)) == []


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_field_of_another_size_is_the_compass_fault_from_its_start_on(factor: float) -> None:
    found = alarms(flight(factor * EARTH_GAUSS))
    assert {(result.sensor, result.isolated) for result in found} == {("mag", True)}
    assert found[0].t_us <= 7_000_000
    off = (factor - 1.0) * np.linalg.norm(EARTH_GAUSS)
    assert found[0].reason.startswith(f"the field's size is {off:+.2f} gauss off")


def test_a_compass_mounted_on_its_side_raises_an_alarm_and_may_be_the_accelerometer() -> None:
    north, east, down = EARTH_GAUSS
    found = alarms(flight(np.array([down, east, -north])))
    assert {(r.sensor, r.suspect, r.isolated, r.alarm) for r in found} == {
        ("mag", "imu-or-mag", False, True)
    }


def test_without_a_place_nothing_is_known() -> None:
    assert alarms(flight(2.0 * EARTH_GAUSS, place_deg=(120.0, 8.5))) == []


def test_a_place_far_away_has_another_field() -> None:
    tropics = (-10.0, -55.0)
    there = np.array(magnetic_field_gauss(*tropics, 0.0, UNKNOWN_DATE))
    assert np.linalg.norm(EARTH_GAUSS) - np.linalg.norm(there) > 0.2
    assert alarms(flight(there, place_deg=tropics)) == []
    assert alarms(flight(EARTH_GAUSS, place_deg=tropics)) != []


def test_the_field_of_a_simulated_world_is_accepted() -> None:
    own = (0.6, 0.0, 0.5)
    assert alarms(flight(np.array(own)), detector=EarthFieldDetector(own)) == []
    assert alarms(flight(EARTH_GAUSS), detector=EarthFieldDetector(own)) != []


def test_blocks_of_any_length_say_the_same() -> None:
    whole = flight(1.5 * EARTH_GAUSS)
    count = len(whole.kind)
    parts = [whole.between(i, min(i + 7, count)) for i in range(0, count, 7)]
    assert alarms(*parts) == alarms(whole) != []
