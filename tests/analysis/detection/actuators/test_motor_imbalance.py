"""A motor with a larger command than the others, where commands come ten times a second."""

import numpy as np
import pytest

from analysis.detection.actuators.actuator_detector import ActuatorDetector
from analysis.detection.actuators.effects import unknown_effects
from analysis.results import SensorDecision
from analysis.samples.block import block_of
from analysis.samples.sample import CommandSample, GpsFix, ImuSample, Sample

GROUND, HOVER = 1.0, 1.6  # ms
TAKES_OFF_S, CHANGES_S, BACK_S, ENDS_S = 3.0, 33.0, 48.0, 60.0
# 20 % of the power of a motor whose thrust grows with the square of its command
RAISED = (HOVER - GROUND) * (1.0 / np.sqrt(0.8) - 1.0)


def alarms(
    *changes_ms: float, noise_ms: float = 0.004, motors: int = 4, every_us: int = 100_000
) -> list[SensorDecision]:
    """Outputs of a hover in gusts, which change by so much for a while."""
    rng = np.random.default_rng(2)
    changes = np.zeros(motors)
    changes[: len(changes_ms)] = changes_ms
    samples: list[Sample] = []
    for t_us in range(0, int(ENDS_S * 1e6), every_us):
        flies = t_us >= TAKES_OFF_S * 1e6
        outputs = np.zeros(12)
        outputs[:motors] = HOVER if flies else GROUND
        if flies:
            outputs[:motors] += rng.normal(0.0, 0.03) + rng.normal(0.0, noise_ms, motors)
        if CHANGES_S * 1e6 <= t_us < BACK_S * 1e6:
            outputs[:motors] += changes
        alt_m = 510.0 if flies else 500.0
        samples.append(GpsFix(t_us, 47.0, 8.0, alt_m, None, 3, 12, 1.0, 1.0, "GPS_RAW_INT"))
        samples.append(ImuSample(t_us, 0.01 * rng.normal(size=3), np.array([0.0, 0.0, -9.8])))
        samples.append(CommandSample(t_us, outputs, "OUTPUTS"))
    detector = ActuatorDetector(unknown_effects())
    return [result for _, result in detector.step(block_of(samples), detector.new_state())[0]]


@pytest.mark.parametrize("number", range(4))
def test_a_motor_that_lost_a_fifth_of_its_power_is_named_while_it_lasts(number: int) -> None:
    found = alarms(*[0.0] * number, RAISED)
    found_isolated = [result for result in found if result.alarm]
    assert {result.suspect for result in found_isolated} == {f"motor {number + 1}"}
    assert all(result.isolated for result in found_isolated)
    assert CHANGES_S + 1.5 < found_isolated[0].t_s < CHANGES_S + 4.0
    assert BACK_S < found_isolated[-1].t_s < BACK_S + 3.0
    assert "below its command" in found_isolated[0].reason


@pytest.mark.parametrize(
    "changes_ms",
    [
        (),
        (0.1, 0.1, -0.1, -0.1),
        (0.1, -0.1, 0.1, -0.1),
        (0.1,) * 4,
        (0.12, 0.0, 0.0, -0.12),
        (-0.1,),
    ],
    ids=["gusts", "pitch", "yaw", "climb", "a load askew", "a motor that does more"],
)
def test_changes_that_no_weak_motor_causes_isolate_none(changes_ms: tuple[float, ...]) -> None:
    found = alarms(*changes_ms)
    assert len([result for result in found if result.t_s < CHANGES_S]) > 12  # one a second
    assert not any(result.alarm for result in found)


@pytest.mark.parametrize(
    "of", [{"noise_ms": 0.1}, {"motors": 6}, {"every_us": 20_000}], ids=["shaken", "hexa", "fast"]
)
def test_nothing_is_tested_where_the_imbalance_is_not_observable(of: dict[str, float]) -> None:
    assert alarms(RAISED, **of) == []
