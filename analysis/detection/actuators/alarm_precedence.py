"""Which verdicts count when sensors and actuators seem faulty at once (docs/watches.md)."""

from collections.abc import Iterable

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.results import Decision, Result, SensorDecision

ACTUATORS = "actuators"  # their `sensor` in results
IMU_US = 20_000_000  # after an IMU alarm: its hold time and the time to learn the model again
FOREVER_US = 1 << 62  # later than any stamp
IMPACT_MPS2 = 100.0  # 10 g: more than any manoeuvre
CRASHED, IMU_AT_FAULT = "after a crash", "the IMU is at fault"
TUMBLING = "turns faster than the gyro's range"


def apply_precedence(
    rows: Iterable[tuple[int, Result]], crash_us: int, tumbling: NDArray[np.bool_], imu_us: int
) -> tuple[list[tuple[int, Result]], int]:
    """The results that count, by row in order, and when the IMU was isolated last.

    Parameters
    ----------
    rows : iterable of row and result
        In the order of their rows.
    crash_us : int
        Time of the vehicle's crash.
    tumbling : array
        Whether the attitude is lost at each row, shape (n,).
    imu_us : int
        When the IMU was isolated last, before these rows.
    """
    results: list[tuple[int, Result]] = []
    for row, result in rows:
        changed = result
        if result.t_us >= crash_us:
            changed = _without_sensor_verdict(result, CRASHED)
        elif tumbling[row]:
            changed = _without_sensor_verdict(result, TUMBLING)
        if _isolates_imu(changed):
            imu_us = changed.t_us
        elif isinstance(changed, SensorDecision) and changed.sensor == ACTUATORS and changed.alarm:
            changed = (
                _untested(changed, IMU_AT_FAULT) if changed.t_us - imu_us < IMU_US else changed
            )
        results.append((row, changed))
    return results, imu_us


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
