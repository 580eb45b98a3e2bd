"""Which satellites stay left out, and when one comes back."""

from dataclasses import replace

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.measure import Modelled
from analysis.fdi.state import Exclusion
from analysis.fdi.thresholds import two_sided
from analysis.samples import Vector

HEALTHY_P = 1e-3  # a satellite looks healthy within the bounds of this probability


def exclude(
    excluded: dict[str, Exclusion], names: tuple[str, ...], onset_us: int, found_us: int
) -> dict[str, Exclusion]:
    """Leave out more satellites since `onset_us`; those that are out already stay as they are."""
    new = {name: Exclusion(onset_us, found_us) for name in names if name not in excluded}
    return {**excluded, **new} if new else excluded


def readmit(
    excluded: dict[str, Exclusion],
    satellites: tuple[str, ...],
    modelled: Modelled,
    p: Vector,
    t_us: int,
    config: DetectorConfig,
) -> dict[str, Exclusion]:
    """Those still left out after their innovations at `t_us`; arrays are of `satellites`.

    An excluded satellite's innovation against a filter that does not use it is normal when it is
    healthy; it comes back when that has been so for `readmit_s` without a break.
    """
    if not excluded:
        return excluded
    variance = np.einsum("ij,jk,ik->i", modelled.h, p, modelled.h) + modelled.variance
    healthy = np.abs(modelled.v_m) <= two_sided(HEALTHY_P) * np.sqrt(variance)
    left = dict(excluded)
    for i, name in enumerate(satellites):
        entry = left.get(name)
        if entry is None:
            continue
        since = entry.healthy_since_us if entry.healthy_since_us is not None else t_us
        if not healthy[i] or t_us < entry.found_us:
            left[name] = replace(entry, healthy_since_us=None)
        elif (t_us - since) * 1e-6 >= config.readmit_s:
            del left[name]
        else:
            left[name] = replace(entry, healthy_since_us=since)
    return left
