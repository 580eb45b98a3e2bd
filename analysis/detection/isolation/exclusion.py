"""Which satellites stay excluded, and when one is readmitted."""

import math
from dataclasses import replace

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import Exclusion, MotionEstimate
from analysis.detection.filter.inertial import CLOCK
from analysis.detection.filter.lasting_errors import lasting_variance
from analysis.detection.filter.measurement import Innovations
from analysis.detection.isolation.chi_square import two_sided_bound
from analysis.detection.values import Value
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

RETURNED_SHARE = 0.75  # share of a system's satellites that look healthy once it is
HEALTHY_P = 1e-3  # a satellite looks healthy within the bounds of this probability


class ExcludedInnovations(Value, frozen=True):
    """Excluded satellites, with their innovations (n,) in m and over their own sigma, without and
    with what lasts in it."""

    names: tuple[str, ...]
    v_m: Vector
    normalised: Vector
    lasting: Vector


NONE_EXCLUDED = ExcludedInnovations((), np.empty(0), np.empty(0), np.empty(0))


def innovations_of_excluded(
    names: tuple[str, ...], modelled: Innovations, before: MotionEstimate, after: MotionEstimate
) -> ExcludedInnovations:
    """Those excluded against the filter after the epoch, which does not use them."""
    if not names:
        return NONE_EXCLUDED
    table = _outside(modelled, before.x, after.x, after.p)
    return ExcludedInnovations(names, table[0], table[1], table[2])


@compiled
def _outside(modelled: Innovations, before: Vector, after: Vector, p: Vector) -> Vector:
    """Innovations (3, n), in m and over their sigma without and with what lasts, at the state
    `after` with covariance p.

    Those of `modelled` are at the state `before`; what moved in between is subtracted.
    """
    v, h, lasts = modelled.v_m, modelled.h, lasting_variance(modelled, 1.0)
    moved = np.zeros(h.shape[1])
    # Attitude and biases stand between and are not seen by a range.
    for i in range(3):
        moved[i] = after[i] - before[i]
    # The state has one number more than the error before this, the quaternion's fourth.
    for i in range(CLOCK, h.shape[1]):
        moved[i] = after[i + 1] - before[i + 1]
    out = np.empty((3, v.shape[0]))
    for i in range(v.shape[0]):
        remaining, total = v[i], modelled.variance[i]
        for j in range(h.shape[1]):
            remaining -= h[i, j] * moved[j]
            for k in range(h.shape[1]):
                total += h[i, j] * p[j, k] * h[i, k]
        out[0, i], out[1, i] = remaining, remaining / math.sqrt(total)
        out[2, i] = remaining / math.sqrt(total + lasts[i])
    return out


def add_exclusions(
    excluded: dict[str, Exclusion],
    names: tuple[str, ...],
    onset_us: int,
    found_us: int,
    whole: bool = False,
) -> dict[str, Exclusion]:
    """Exclude more satellites since `onset_us`, as a `whole_system` system or each for itself;
    those excluded already stay as they are."""
    # The first onset stays: a second finding is the same fault.
    new = {
        name: Exclusion(onset_us, found_us, None, whole) for name in names if name not in excluded
    }
    return {**excluded, **new} if new else excluded


def readmit_satellites(
    excluded: dict[str, Exclusion], outside: ExcludedInnovations, t_us: int, config: DetectorConfig
) -> dict[str, Exclusion]:
    """Those still excluded after what was seen of them at `t_us`.

    An excluded satellite's innovation against a filter that does not use it is normal when it is
    healthy; it is readmitted when that has been so for `readmit_s` without a break.
    """
    if not excluded:
        return excluded
    out = dict(excluded)
    bound = two_sided_bound(HEALTHY_P)
    # Over its own sigma: a satellite low over the horizon is noisier, not less healthy.
    healthy = (np.abs(outside.normalised) <= bound).tolist()
    returned = _returned_systems(excluded, outside, bound)
    for i, (name, fine) in enumerate(zip(outside.names, healthy, strict=True)):
        entry = out[name]
        if entry.whole_system:
            fine = name[0] in returned and bool(abs(outside.lasting[i]) <= bound)
        since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
        # A break starts the wait again, and so does an epoch from before it was found.
        if not fine or t_us < entry.found_us:
            out[name] = replace(entry, healthy_since_us=None)
        elif (t_us - since) * 1e-6 >= config.readmit_s:
            del out[name]
        else:
            out[name] = replace(entry, healthy_since_us=since)
    return out


def _returned_systems(
    excluded: dict[str, Exclusion], outside: ExcludedInnovations, bound: float
) -> set[str]:
    """The systems that were left out as a whole and nearly all of whose satellites look healthy.

    One that lies across a spoofer's shift looks so alone. Each may be off by what lasts: nothing
    was held against it, and what had been learnt of it in use is lost.
    """
    looks: dict[str, list[bool]] = {}
    for name, normalised in zip(outside.names, outside.lasting.tolist(), strict=True):
        if excluded[name].whole_system:
            looks.setdefault(name[0], []).append(abs(normalised) <= bound)
    return {system for system, fine in looks.items() if sum(fine) >= RETURNED_SHARE * len(fine)}
