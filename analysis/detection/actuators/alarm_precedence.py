"""Sensors and actuators hold each other up: whose word counts when both seem to be at fault.

The actuators are judged by the IMU, so nobody of them is blamed while the IMU is, nor for a while
after. After a crash that an actuator led to, what the sensors say proves nothing against them: a
blow of many g is beyond what an IMU measures, and so is a tumble faster than its gyro's range.
"""

from collections.abc import Iterable

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.results import Decision, Result, SensorDecision

ACTUATORS = "actuators"  # the sensor's name in results
IMU_US = 20_000_000  # after an alarm of the IMU: as long as its hold, and until it is learnt anew
NEVER_US = -(1 << 62)
CRASHED, IMU_AT_FAULT = "after a crash", "the IMU is at fault"
TUMBLING = "turned faster than the gyro can tell"


def apply_precedence(
    found: Iterable[tuple[int, Result]], crash_us: int, lost: NDArray[np.bool_], imu_us: int
) -> tuple[list[tuple[int, Result]], int]:
    """Results as they count, by row in order, and when the IMU was blamed last.

    Parameters
    ----------
    found : iterable of row and result
        In order of their rows.
    crash_us : int
        When the vehicle crashed.
    lost : array
        Whether the attitude is lost at each row, shape (n,).
    imu_us : int
        When the IMU was blamed last, before these.
    """
    kept: list[tuple[int, Result]] = []
    for row, result in found:
        one = result
        if result.t_us >= crash_us:
            one = _without_sensor_verdict(result, CRASHED)
        elif lost[row]:
            one = _without_sensor_verdict(result, TUMBLING)
        if _isolates_imu(one):
            imu_us = one.t_us
        elif isinstance(one, SensorDecision) and one.sensor == ACTUATORS and one.alarm:
            one = _untested(one, IMU_AT_FAULT) if one.t_us - imu_us < IMU_US else one
        kept.append((row, one))
    return kept, imu_us


def _isolates_imu(result: Result) -> bool:
    if isinstance(result, SensorDecision):
        return result.sensor == "imu" and result.isolated
    return isinstance(result, Decision) and result.alarm and result.hypothesis == "imu"


def _without_sensor_verdict(result: Result, reason: str) -> Result:
    if isinstance(result, Decision):
        return msgspec.structs.replace(
            result, alarm=False, hypothesis="untestable", excluded=(), reason=reason
        )
    if isinstance(result, SensorDecision) and result.sensor != ACTUATORS:
        return _untested(result, reason)
    return result


def _untested(result: SensorDecision, reason: str) -> SensorDecision:
    return msgspec.structs.replace(
        result,
        statistic=None,
        threshold=None,
        alarm=False,
        isolated=False,
        reason=reason,
        suspect="",
    )
