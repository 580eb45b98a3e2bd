"""What lies between two epochs: the IMU's samples, split and mended when data come late."""

from collections.abc import Sequence

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.process_noise import ProcessNoise
from analysis.detection.filter.propagation import (
    RATE_SIGMA_RPS,
    ImuSegment,
    imu_run_of,
    imu_segment,
)
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import ImuSample, Vector

EMPTY: Vector = np.empty(0)


class Edge(Value, frozen=True):
    """From the epoch `before`: the IMU between, its noise and whether it is trusted, how far the
    clock may have leapt in m, how fast the body may have turned where there is no IMU in rad/s."""

    before: int
    part: ImuSegment
    noise: ProcessNoise
    trusted: bool
    clock_jump_m: float
    rate_sigma_rps: float = RATE_SIGMA_RPS

    def uses_imu(self, gap_s: float) -> bool:
        """Whether the IMU ties the two epochs; silence longer than `gap_s` is not bridged."""
        return self.trusted and self.part.any_sample and 0.0 <= self.part.gap_s <= gap_s


def segment_between(run: ImuRun, start_us: int, end_us: int) -> ImuSegment:
    """The samples of a run between two times."""
    return imu_segment(run, MotionEstimate(start_us, EMPTY, EMPTY), end_us)


def imu_samples(part: ImuSegment, start_us: int) -> list[ImuSample]:
    """The samples a segment was made of."""
    # Steps are seconds; the stamps they came from were whole microseconds.
    stamps = start_us + np.rint(np.cumsum(part.samples[:-1, 0]) * 1e6).astype(int)
    return [
        ImuSample(int(t_us), row[1:4], row[4:7])
        for t_us, row in zip(stamps, part.samples[:-1], strict=True)
    ]


def split_segment(
    part: ImuSegment, start_us: int, at_us: int, end_us: int
) -> tuple[ImuSegment, ImuSegment]:
    """The segments before and after a time in between."""
    run = imu_samples(part, start_us)
    first = imu_run_of(sample for sample in run if sample.t_us <= at_us)
    second = imu_run_of(sample for sample in run if sample.t_us > at_us)
    return segment_between(first, start_us, at_us), segment_between(second, at_us, end_us)


def add_late_samples(
    part: ImuSegment, start_us: int, end_us: int, late: Sequence[ImuSample]
) -> ImuSegment:
    """The segment with samples that came late."""
    # By stamp, as a late sample may have been heard before.
    known = {sample.t_us: sample for sample in (*imu_samples(part, start_us), *late)}
    return segment_between(imu_run_of(known[t_us] for t_us in sorted(known)), start_us, end_us)
