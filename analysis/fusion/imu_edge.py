"""The constraint between two epochs: IMU samples, split or extended when data come late."""

import numpy as np

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import (
    RATE_SIGMA_RPS,
    ImuSegment,
    imu_segment,
)
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

EMPTY: Vector = np.empty(0)


class Edge(Value, frozen=True):
    """From the epoch `before`: the IMU segment, its noise and whether it is trusted; how far the
    clock may have jumped in m; the sigma of the body's rate in rad/s where there is no IMU."""

    before: int
    part: ImuSegment
    noise: ProcessNoise
    trusted: bool
    clock_jump_m: float
    rate_sigma_rps: float = RATE_SIGMA_RPS

    def uses_imu(self, gap_s: float) -> bool:
        """Whether the IMU connects the two epochs; a gap longer than `gap_s` is not bridged."""
        return self.trusted and self.part.any_sample and 0.0 <= self.part.gap_s <= gap_s


def segment_between(run: ImuRun, start_us: int, end_us: int) -> ImuSegment:
    """The segment of a run between two times."""
    return imu_segment(run, MotionEstimate(start_us, EMPTY, EMPTY), end_us)


def segment_run(part: ImuSegment, start_us: int) -> ImuRun:
    """The samples of a segment."""
    # Steps are seconds; the original stamps were whole microseconds.
    stamps = start_us + np.rint(np.cumsum(part.samples[:-1, 0]) * 1e6).astype(int)
    return ImuRun(stamps, part.samples[:-1, 1:])


def split_segment(
    part: ImuSegment, start_us: int, at_us: int, end_us: int
) -> tuple[ImuSegment, ImuSegment]:
    """The segments before and after a time in between."""
    stamps, values = segment_run(part, start_us)
    first = stamps <= at_us
    return (
        segment_between(ImuRun(stamps[first], values[first]), start_us, at_us),
        segment_between(ImuRun(stamps[~first], values[~first]), at_us, end_us),
    )


def add_late_samples(part: ImuSegment, start_us: int, end_us: int, late: ImuRun) -> ImuSegment:
    """The segment with samples that came late."""
    known = segment_run(part, start_us)
    # Each stamp once, as a late sample may have arrived before.
    stamps, rows = np.unique(np.concatenate([late.t_us, known.t_us]), return_index=True)
    run = ImuRun(stamps, np.concatenate([late.values, known.values])[rows])
    return segment_between(run, start_us, end_us)
