"""Which satellites stay left out, when one comes back, and what is held meanwhile.

The healthy satellites have offsets of their own, whose weighted mean is the position's error. With
a satellite left out the mean is another one, and the position would jump. So what was learnt of the
offsets is taken off while satellites are left out; it fades as offsets do, in `slow_s`.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core, Held
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Exclusion
from analysis.fdi.thresholds import two_sided
from analysis.samples import Vector

HEALTHY_P = 1e-3  # a satellite looks healthy within the bounds of this probability


class Outside(NamedTuple):
    """Satellites left out, with their innovations (n,) in m and over their own sigma."""

    names: tuple[str, ...]
    v_m: Vector
    normalised: Vector


def outside(names: tuple[str, ...], modelled: Modelled, p: Vector) -> Outside:
    """Those left out against the filter with covariance p (18, 18), which does not use them."""
    variance = np.einsum("ij,jk,ik->i", modelled.h, p, modelled.h) + modelled.variance
    return Outside(names, modelled.v_m, modelled.v_m / np.sqrt(variance))


NOBODY = Outside((), np.empty(0), np.empty(0))


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


def standing(core: Core, names: tuple[str, ...], t_us: int, config: DetectorConfig) -> Vector:
    """What is known at `t_us` of the offsets (n,) in m: held before, and learnt since."""
    known = held(core, names, t_us, config)
    if core.memory is not None:
        place = {name: i for i, name in enumerate(core.memory.names)}
        for i, name in enumerate(names):
            if name in place:
                known[i] += core.memory.offset[place[name]]
    return known


def held(core: Core, names: tuple[str, ...], t_us: int, config: DetectorConfig) -> Vector:
    """The offsets (n,) in m that are taken off the ranges at `t_us`."""
    fading = math.exp(-(t_us - core.held.t_us) * 1e-6 / config.sigma.slow_s)
    return np.array([fading * core.held.offsets_m.get(name, 0.0) for name in names])


def holding(core: Core, excluded: dict[str, Exclusion], t_us: int, config: DetectorConfig) -> Core:
    """The core with other satellites left out from now on: what is known of the others is held.

    The windows with memory start anew: the innovations' means are other ones.
    """
    if excluded.keys() == core.excluded.keys():
        return core._replace(excluded=excluded)
    known = core.memory.names if core.memory is not None else ()
    names = tuple({*known, *core.held.offsets_m} - excluded.keys())
    offsets_m = dict(zip(names, standing(core, names, t_us, config).tolist(), strict=True))
    return core._replace(excluded=excluded, held=Held(t_us, offsets_m), memory=None)
