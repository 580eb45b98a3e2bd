"""Predict: the filter at an epoch, by the IMU where it is usable, before the epoch is used."""

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import ImuSegment, imu_segment, propagate_filter
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector


class Prediction(Value, frozen=True):
    """The filter `before`, at the last epoch, and `motion`, at this one; the transition (20, 20) of
    its errors in between, and the IMU's samples."""

    before: MotionEstimate
    motion: MotionEstimate
    transition: Vector
    segment: ImuSegment

    @property
    def dt_s(self) -> float:
        """The time between the epochs."""
        return (self.motion.t_us - self.before.t_us) * 1e-6

    @property
    def is_inertial(self) -> bool:
        """Whether the IMU propagated the filter all the way."""
        return self.before.inertial and self.motion.inertial


def predict(before: MotionEstimate, run: ImuRun, t_us: int, config: FilterConfig) -> Prediction:
    """The filter at `t_us` by the IMU's samples `run` since the last epoch."""
    segment = imu_segment(run, before, t_us)
    motion, transition = propagate_filter(before, segment, t_us, config)
    return Prediction(before, motion, transition, segment)
