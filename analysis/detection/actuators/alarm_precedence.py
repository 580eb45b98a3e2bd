"""Which verdicts count when sensors and actuators seem faulty at once (docs/watches.md)."""

from collections.abc import Iterable
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.detection.detector_registry import ENDED_US
from analysis.results import OR_SEPARATOR, Decision, Result, SensorDecision
from analysis.samples.block import NEVER_US

ACTUATORS = "actuators"  # their `sensor` in results
# After a sensor was isolated, or the attitude was lost: the time for which the sensor is held out
# (10 s, `imu_hold_s`), and that to find the attitude and learn the model again.
RELEARNED_US = 20_000_000
IMPACT_MPS2 = 100.0  # 10 g: more than any manoeuvre
CRASHED = "after a crash"
TUMBLING = "turns faster than the gyro's range"


@dataclass(slots=True)
class AlarmPrecedence:
    """When each source that the actuators are tested with was found faulty last, by its hypothesis,
    and the newest alarm of an actuator that counted."""

    faulty_us: dict[str, int]
    actuator_us: int = NEVER_US

    def apply(
        self, rows: Iterable[tuple[int, Result]], crash_us: int, tumbling: NDArray[np.bool_]
    ) -> list[tuple[int, Result]]:
        """The results that count, by row in order.

        The vehicle crashed at `crash_us`; `tumbling` (n,) says where the attitude is lost.
        """
        results: list[tuple[int, Result]] = []
        for row, result in rows:
            crashed = result.t_us >= crash_us
            lost = CRASHED if crashed else TUMBLING if tumbling[row] else ""
            if lost:
                result = _without_sensor_verdict(result, lost)
            if (found := _isolated_source(result)) in self.faulty_us:
                self.faulty_us[found] = result.t_us
            elif isinstance(result, SensorDecision) and result.sensor == ACTUATORS and result.alarm:
                result = self._actuator_alarm(result, lost)
            results.append((row, result))
        return results

    def _actuator_alarm(self, alarm: SensorDecision, lost: str) -> SensorDecision:
        # A faulty actuator puts the IMU in doubt itself: what was isolated before stays isolated.
        is_new = alarm.t_us - self.actuator_us > ENDED_US
        # What lies upside down follows no command, and a saturated gyro shows no response.
        if is_new and lost:
            return _untested(alarm, lost)
        for source, at_us in self.faulty_us.items():
            if alarm.t_us - at_us < RELEARNED_US and (is_new or OR_SEPARATOR not in source):
                return _untested(alarm, f"{source} is at fault")
        self.actuator_us = alarm.t_us
        return alarm


def _isolated_source(result: Result) -> str:
    if isinstance(result, Decision):
        return result.hypothesis if result.alarm else ""
    return result.sensor if isinstance(result, SensorDecision) and result.isolated else ""


def _without_sensor_verdict(result: Result, reason: str) -> Result:
    if isinstance(result, Decision):
        return msgspec.structs.replace(
            result, alarm=False, hypothesis="untestable", excluded=(), reason=reason
        )
    if isinstance(result, SensorDecision) and result.sensor != ACTUATORS:
        return _untested(result, reason)
    return result


def _untested(result: SensorDecision, reason: str) -> SensorDecision:
    return SensorDecision(t_us=result.t_us, sensor=result.sensor, dof=result.dof, reason=reason)
