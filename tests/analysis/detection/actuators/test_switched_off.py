"""Motors whose output is switched off in flight."""

from collections.abc import Mapping

import numpy as np
import pytest

from analysis.detection.actuators.actuator_detector import ActuatorDetector
from analysis.detection.actuators.effects import unknown_effects
from analysis.results import SensorDecision
from analysis.samples.block import COMMAND, Block, block_of
from analysis.samples.sample import CommandSample, GpsFix, Sample

GROUND, HOVER, LEAST = 1.0, 1.5, 1.15  # ms
TAKES_OFF_S, CHANGES_S, ENDS_S = 5.0, 15.0, 18.0


def flight(after: Mapping[int, float], source: str = "OUTPUTS") -> Block:
    """Six motors at 10 Hz, those of `after` with another output (ms) from `CHANGES_S` on."""
    samples: list[Sample] = []
    for t_us in range(0, int(ENDS_S * 1e6), 100_000):
        flies = t_us >= TAKES_OFF_S * 1e6
        outputs = np.zeros(12)
        outputs[:6] = HOVER if flies else GROUND
        outputs[7] = 1.5  # a gimbal, as on the ground
        if t_us >= CHANGES_S * 1e6:
            for number, value in after.items():
                outputs[number] = value
        alt_m = 510.0 if flies else 500.0
        samples.append(GpsFix(t_us, 47.0, 8.0, alt_m, None, 3, 12, 1.0, 1.0, "GPS_RAW_INT"))
        samples.append(CommandSample(t_us, outputs, source))
    return block_of(samples)


def alarms(block: Block) -> list[SensorDecision]:
    detector = ActuatorDetector(unknown_effects())
    return [result for _, result in detector.step(block, detector.new_state())[0]]


def test_a_motor_that_is_switched_off_is_named_and_stays_named() -> None:
    found = alarms(flight({2: GROUND}))
    assert {result.suspect for result in found} == {"motor 3"}
    assert all(result.isolated for result in found)
    assert found[0].t_us == (CHANGES_S + 0.5) * 1e6
    assert found[0].reason == "motor 3: its output is switched off in flight"
    assert np.diff([result.t_us for result in found]).max() == 500_000


def test_two_motors_that_are_switched_off_are_both_named() -> None:
    assert {result.suspect for result in alarms(flight({0: GROUND, 3: GROUND}))} == {
        "motor 1",
        "motor 4",
    }


@pytest.mark.parametrize(
    "after",
    [{i: GROUND for i in range(6)}, {2: LEAST}, {7: 0.9}, {}],
    ids=["all motors", "as low as a controller goes", "no motor", "nothing"],
)
def test_no_motor_is_isolated_for(after: Mapping[int, float]) -> None:
    assert alarms(flight(after)) == []


def test_parked_motors_are_not_switched_off_and_one_that_starts_again_may_be() -> None:
    """As a vehicle does that is carried by its wings, and keeps two motors for itself."""
    block = flight({2: GROUND, 3: GROUND, 4: GROUND, 5: GROUND})
    assert alarms(block) == []
    late = (block.kind == COMMAND) & (block.t_us >= (CHANGES_S + 1.0) * 1e6)
    block.values[late, 2:4] = HOVER  # two of them again, two stay parked
    assert alarms(block) == []
    later = (block.kind == COMMAND) & (block.t_us >= (CHANGES_S + 2.0) * 1e6)
    block.values[later, 4:6] = HOVER
    block.values[later, 0] = GROUND
    assert {result.suspect for result in alarms(block)} == {"motor 1"}


def test_controls_do_not_show_that_a_motor_is_off() -> None:
    """Their least value is what a controller may want."""
    assert alarms(flight({2: GROUND}, "HIL_ACTUATOR_CONTROLS")) == []


def test_the_cut_into_blocks_changes_nothing() -> None:
    whole = flight({2: GROUND})
    detector = ActuatorDetector(unknown_effects())
    state, one_by_one = detector.new_state(), []
    for row in range(len(whole.kind)):
        found, state = detector.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert one_by_one == alarms(whole)
