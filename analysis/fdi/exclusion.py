"""Which satellites stay left out, and when one comes back."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import CLOCK, ERRORS, ISB, X_CLOCK, X_ISB
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Exclusion, Motion
from analysis.fdi.thresholds import two_sided
from analysis.samples import Vector

HEALTHY_P = 1e-3  # a satellite looks healthy within the bounds of this probability


class Outside(NamedTuple):
    """Satellites left out, with their innovations (n,) in m and over their own sigma."""

    names: tuple[str, ...]
    v_m: Vector
    normalised: Vector


NOBODY = Outside((), np.empty(0), np.empty(0))


def outside(names: tuple[str, ...], modelled: Modelled, before: Motion, after: Motion) -> Outside:
    """Those left out against the filter after the epoch, which does not use them.

    Their innovations in `modelled` are against the filter before; the update is taken off.
    """
    moved = np.zeros(ERRORS)
    moved[0:3] = after.x[0:3] - before.x[0:3]
    moved[CLOCK], moved[ISB] = (
        after.x[X_CLOCK] - before.x[X_CLOCK],
        after.x[X_ISB] - before.x[X_ISB],
    )
    h = modelled.h
    v_m = modelled.v_m - h @ moved
    variance = np.einsum("ij,jk,ik->i", h, after.p, h) + modelled.variance
    return Outside(names, v_m, v_m / np.sqrt(variance))


def exclude(
    excluded: dict[str, Exclusion], names: tuple[str, ...], onset_us: int, found_us: int
) -> dict[str, Exclusion]:
    """Leave out more satellites since `onset_us`; those that are out already stay as they are."""
    new = {name: Exclusion(onset_us, found_us) for name in names if name not in excluded}
    return {**excluded, **new} if new else excluded


def readmit(
    excluded: dict[str, Exclusion], left: Outside, t_us: int, config: DetectorConfig
) -> dict[str, Exclusion]:
    """Those still left out after what was seen of them at `t_us`.

    An excluded satellite's innovation against a filter that does not use it is normal when it is
    healthy; it comes back when that has been so for `readmit_s` without a break.
    """
    if not excluded:
        return excluded
    out = dict(excluded)
    healthy = np.abs(left.normalised) <= two_sided(HEALTHY_P)
    for name, fine in zip(left.names, healthy.tolist(), strict=True):
        entry = out[name]
        since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
        if not fine or t_us < entry.found_us:
            out[name] = replace(entry, healthy_since_us=None)
        elif (t_us - since) * 1e-6 >= config.readmit_s:
            del out[name]
        else:
            out[name] = replace(entry, healthy_since_us=since)
    return out
