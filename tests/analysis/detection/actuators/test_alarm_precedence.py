"""Which verdicts on actuators count while a source that they are tested with is faulty."""

import numpy as np

from analysis.detection.actuators.alarm_precedence import AlarmPrecedence
from analysis.results import FOREVER_US, Decision, Result, SensorDecision, pattern_alarm
from analysis.samples.block import NEVER_US

S = 1_000_000


def actuator(t_s: float, name: str) -> SensorDecision:
    return pattern_alarm(round(t_s * S), "actuators", f"{name}: 0.70 below its command")


def in_doubt(t_s: float) -> Decision:
    return Decision(
        t_us=round(t_s * S),
        statistic=None,
        threshold=None,
        dof=0,
        p_value=None,
        alarm=True,
        hypothesis="GPS-or-imu",
    )


def counted(results: list[Result], *sources: str) -> list[bool]:
    """Whether the alarms of actuators count."""
    precedence = AlarmPrecedence(dict.fromkeys(sources, NEVER_US))
    rows = list(enumerate(results))
    kept = precedence.apply(rows, FOREVER_US, np.zeros(len(rows), bool))
    return [r.alarm for _, r in kept if isinstance(r, SensorDecision) and r.sensor == "actuators"]


def test_no_actuator_of_a_wing_is_isolated_while_its_airspeed_is_faulty_nor_soon_after():
    results: list[Result] = [pattern_alarm(10 * S, "airspeed", "")]
    results += [actuator(12.0, "throttle"), actuator(29.9, "elevator"), actuator(30.1, "throttle")]
    assert counted(results, "imu", "airspeed") == [False, False, True]
    assert counted(results, "imu") == [True, True, True]


def test_while_receiver_or_imu_are_in_doubt_only_actuators_isolated_before_stay_so():
    before: list[Result] = [actuator(9.9, "motor 1")]
    later = [actuator(10.4, "motor 1"), actuator(10.9, "motor 1"), actuator(14.0, "motor 3")]
    assert counted([*before, in_doubt(10.0), *later], "imu", "GPS-or-imu") == [True] * 3 + [False]
    assert counted([in_doubt(10.0), *later], "imu", "GPS-or-imu") == [False] * 3


def test_in_a_tumble_and_after_a_crash_only_actuators_isolated_before_stay_so():
    lasting = [actuator(9.9, "motor 1"), actuator(10.4, "motor 1"), actuator(10.9, "motor 1")]
    rows = list(enumerate([*lasting, actuator(14.0, "motor 3")]))
    for crash_us, tumbling in ((FOREVER_US, [False, True, True, True]), (10 * S, [False] * 4)):
        kept = AlarmPrecedence({}).apply(rows, crash_us, np.array(tumbling))
        assert [result.alarm for _, result in kept] == [True, True, True, False]
        (_, anew), *_ = AlarmPrecedence({}).apply(rows[3:], crash_us, np.array(tumbling))
        assert not anew.alarm
