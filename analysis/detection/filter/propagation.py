"""The filter from one epoch to the next: by the IMU where it is usable, freely otherwise."""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.antenna import shift_by_lever_arm
from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import PSI, propagate_freely, propagate_inertial
from analysis.samples.block import ImuRun
from analysis.samples.sample import IMU_VALUE_LIMIT, Vector

PENDING_MAX = 40_000  # samples between two epochs, 200 s at 200 Hz; older ones are dropped
NO_RUN = ImuRun(np.empty(0, np.int64), np.empty((0, 6)))
RATE_SIGMA_RPS = 0.5  # one sigma of a vehicle's rate while its IMU is silent: 30 degrees/s
SHORT_GAP_S = 1.0  # after a longer one the attitude is searched for again
SILENT_INTERVALS = 5.0  # usual intervals that a gap must exceed to be the IMU's fault
INTERVAL_GAIN = 0.05  # of the usual interval's filter: a memory of 20 epochs


class ImuSegment(NamedTuple):
    """The IMU between two epochs: samples (k, 7), each with the length of its step; `gap_s` is the
    longest silence, `any_sample` whether there was any sample."""

    samples: Vector
    gap_s: float
    any_sample: bool


def add_pending(run: ImuRun, pending: ImuRun) -> ImuRun:
    """The samples that wait for an epoch with one run more; only the newest are kept."""
    if not len(run.t_us):
        return pending
    t_us, values = (np.concatenate(both)[-PENDING_MAX:] for both in zip(pending, run, strict=True))
    return ImuRun(t_us, values)


def split_pending(pending: ImuRun, until_us: int) -> tuple[ImuRun, ImuRun]:
    """Samples up to `until_us`, each later than all before it, and those that stay pending."""
    t_us, values = pending
    if (t_us[1:] <= t_us[:-1]).any():
        # Stamps that go back are dropped: sorting would mix two clocks.
        later = np.append(True, t_us[1:] > np.maximum.accumulate(t_us)[:-1])
        t_us, values = t_us[later], values[later]
    # `right`: a sample at the epoch's own stamp belongs to the time before it.
    at = int(t_us.searchsorted(until_us, side="right"))
    return ImuRun(t_us[:at], values[:at]), ImuRun(t_us[at:], values[at:])


def update_interval_s(known_s: float, run: ImuRun) -> float:
    """The time between two samples of the IMU, of which `run` are the newest; 0 while unknown."""
    count = len(run.t_us)
    if count < 2:
        return known_s
    interval_s = int(run.t_us[-1] - run.t_us[0]) * 1e-6 / (count - 1)
    return known_s + (INTERVAL_GAIN if known_s > 0.0 else 1.0) * (interval_s - known_s)


def is_silent(gap_s: float, usual_s: float, config: FilterConfig) -> bool:
    """Whether a gap is the IMU's fault: too long for the filter, and for this IMU."""
    return gap_s > max(config.gap_s, SILENT_INTERVALS * usual_s)


def imu_segment(run: ImuRun, motion: MotionEstimate, until_us: int) -> ImuSegment:
    """The steps from the filter's time to `until_us`; the last sample extends to the end. Without
    samples if one of them is implausible."""
    # Samples before the filter's time have been used already.
    at = run.t_us.searchsorted(motion.t_us, side="right")
    t_us, values = run.t_us[at:], run.values[at:]
    if not len(t_us):
        return ImuSegment(np.empty((0, 7)), (until_us - motion.t_us) * 1e-6, False)
    steps_s = np.diff(t_us, prepend=motion.t_us, append=until_us) * 1e-6
    if not (np.abs(values) <= IMU_VALUE_LIMIT).all():  # which NaN is not
        return ImuSegment(np.empty((0, 7)), float(steps_s.sum()), True)
    table = np.column_stack((steps_s, np.concatenate((values, values[-1:]))))
    return ImuSegment(table, float(steps_s.max()), True)


def propagate_filter(
    motion: MotionEstimate, segment: ImuSegment, until_us: int, config: FilterConfig
) -> tuple[MotionEstimate, Vector]:
    """The filter at `until_us`, before the epoch there is used, and the transition (20, 20)."""
    dt_s = (until_us - motion.t_us) * 1e-6
    noise = config.noise
    complete = segment.gap_s <= config.gap_s and len(segment.samples) > 0
    if motion.inertial and complete and config.antenna is None:
        x, p, phi = propagate_inertial(motion.x, motion.p, segment.samples, noise)
        return MotionEstimate(until_us, x, p, True), phi
    # The filter's position is the antenna's, the IMU measures at its own: there and back.
    if motion.inertial and complete and config.antenna is not None:
        first, last, arm = segment.samples[0, 1:4], segment.samples[-1, 1:4], config.antenna
        x, p, back = shift_by_lever_arm(motion.x, motion.p, first, arm, -1.0)
        x, p, phi = propagate_inertial(x, p, segment.samples, noise)
        x, p, out = shift_by_lever_arm(x, p, last, arm, 1.0)
        return MotionEstimate(until_us, x, p, True), out @ phi @ back
    x, p, phi = propagate_freely(motion.x, motion.p, dt_s, noise)
    # Over a short silence the attitude is still known, but less well.
    inertial = motion.inertial and segment.gap_s <= SHORT_GAP_S and segment.any_sample
    if inertial:
        p[range(PSI, PSI + 3), range(PSI, PSI + 3)] += (RATE_SIGMA_RPS * segment.gap_s) ** 2
    # A gap breaks the integrals of an alignment.
    alignment = motion.alignment if complete and not motion.inertial else None
    return MotionEstimate(until_us, x, p, inertial, alignment), phi
