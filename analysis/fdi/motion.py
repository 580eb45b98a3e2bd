"""From one epoch to the next: by the IMU where it is there and sound, freely otherwise."""

from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import PSI, propagate_freely, propagate_inertial
from analysis.fdi.state import Motion, Pending
from analysis.samples import ImuSample, Vector

PENDING_MAX = 40_000  # samples without an epoch between; older ones are forgotten
TURN_SIGMA_RPS = 0.5  # how fast a body may turn while its IMU is silent
SHORT_GAP_S = 1.0  # after a longer one the attitude is found anew


class Segment(NamedTuple):
    """The IMU between two instants: samples (k, 7) with the length of each step; `gap_s` is the
    longest silence in it and `heard` whether there was any sample."""

    samples: Vector
    gap_s: float
    heard: bool


def keep_pending(sample: ImuSample, pending: Pending | None) -> Pending:
    """One more sample for the next epoch."""
    if pending is None or pending.depth >= PENDING_MAX:
        return Pending(sample, None, 1)
    return Pending(sample, pending, pending.depth + 1)


def split_pending(pending: Pending | None, until_us: int) -> tuple[list[ImuSample], Pending | None]:
    """Samples up to `until_us`, oldest first, and those that stay pending."""
    newer: list[ImuSample] = []
    while pending is not None and pending.sample.t_us > until_us:
        newer.append(pending.sample)
        pending = pending.older
    older: list[ImuSample] = []
    while pending is not None:
        older.append(pending.sample)
        pending = pending.older
    rest: Pending | None = None
    for sample in reversed(newer):
        rest = keep_pending(sample, rest)
    older.reverse()
    return older, rest


def segment(run: list[ImuSample], motion: Motion, until_us: int) -> Segment:
    """Steps from the filter's time to `until_us`; the last sample is held to the end."""
    run = [sample for sample in run if sample.t_us > motion.t_us]
    if not run:
        return Segment(np.empty((0, 7)), (until_us - motion.t_us) * 1e-6, False)
    stamps = np.array([motion.t_us, *[sample.t_us for sample in run], until_us])
    table = np.empty((len(run) + 1, 7))
    table[:-1, 1:4] = [sample.gyro_b_rps for sample in run]
    table[:-1, 4:7] = [sample.accel_b_mps2 for sample in run]
    table[-1, 1:7] = table[-2, 1:7]
    table[:, 0] = np.diff(stamps) * 1e-6
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        return Segment(np.empty((0, 7)), float(table[:, 0].sum()), True)
    return Segment(table, float(table[:, 0].max()), True)


def advance(
    motion: Motion, part: Segment, until_us: int, config: DetectorConfig
) -> tuple[Motion, Vector]:
    """The filter at `until_us`, before the epoch there is used, and the transition (20, 20)."""
    dt_s = (until_us - motion.t_us) * 1e-6
    noise = config.noise.densities
    whole = part.gap_s <= config.gap_s and len(part.samples) > 0
    if motion.inertial and whole:
        x, p, phi = propagate_inertial(motion.x, motion.p, part.samples, noise)
        return Motion(until_us, x, p, True), phi
    x, p, phi = propagate_freely(motion.x, motion.p, dt_s, noise)
    inertial = motion.inertial and part.gap_s <= SHORT_GAP_S and part.heard
    if inertial:
        p[range(PSI, PSI + 3), range(PSI, PSI + 3)] += (TURN_SIGMA_RPS * part.gap_s) ** 2
    alignment = motion.alignment if whole and not motion.inertial else None
    return Motion(until_us, x, p, inertial, alignment), phi
