"""What lies between two epochs: the IMU's samples, split and mended when data come late."""

from collections.abc import Sequence

import numpy as np

from analysis.detection.detection_config import Noise
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.propagation import RATE_SIGMA_RPS, Segment, run_of, segment
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import ImuSample, Vector

NOTHING: Vector = np.empty(0)


class Edge(Value, frozen=True):
    """From the epoch `before`: the IMU between, its noise and whether it is trusted, how far the
    clock may have leapt in m, how fast the body may have turned where there is no IMU in rad/s."""

    before: int
    part: Segment
    noise: Noise
    trusted: bool
    jumped_m: float
    rate_sigma_rps: float = RATE_SIGMA_RPS

    def sound(self, gap_s: float) -> bool:
        """Whether the IMU ties the two epochs; silence longer than `gap_s` is not bridged."""
        return self.trusted and self.part.heard and 0.0 <= self.part.gap_s <= gap_s


def between(run: ImuRun, start_us: int, end_us: int) -> Segment:
    """The samples of a run between two times."""
    return segment(run, Motion(start_us, NOTHING, NOTHING), end_us)


def samples_of(part: Segment, start_us: int) -> list[ImuSample]:
    """The samples a segment was made of."""
    # Steps are seconds; the stamps they came from were whole microseconds.
    stamps = start_us + np.rint(np.cumsum(part.samples[:-1, 0]) * 1e6).astype(int)
    return [
        ImuSample(int(t_us), row[1:4], row[4:7])
        for t_us, row in zip(stamps, part.samples[:-1], strict=True)
    ]


def split(part: Segment, start_us: int, at_us: int, end_us: int) -> tuple[Segment, Segment]:
    """The segments before and after a time in between."""
    run = samples_of(part, start_us)
    first = run_of(sample for sample in run if sample.t_us <= at_us)
    second = run_of(sample for sample in run if sample.t_us > at_us)
    return between(first, start_us, at_us), between(second, at_us, end_us)


def mended(part: Segment, start_us: int, end_us: int, late: Sequence[ImuSample]) -> Segment:
    """The segment with samples that came late."""
    # By stamp, as a late sample may have been heard before.
    known = {sample.t_us: sample for sample in (*samples_of(part, start_us), *late)}
    return between(run_of(known[t_us] for t_us in sorted(known)), start_us, end_us)
