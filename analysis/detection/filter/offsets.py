"""Offsets of healthy satellites, frozen so that the position does not jump with the geometry.

Every satellite has an offset of its own for minutes; their weighted mean is the position's error.
When one is left out, or sets, the mean is another one. So what was learnt of the offsets by then is
subtracted from the ranges from there on; it fades as offsets do, in `slow_s`.
"""

import math

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, FrozenOffsets
from analysis.samples.sample import Vector


def frozen_offsets_m(
    core: DetectorCore, names: tuple[str, ...], t_us: int, config: DetectorConfig
) -> Vector:
    """The offsets (n,) in m that are subtracted from the ranges at `t_us`."""
    known = core.frozen.offsets_m
    if not known:
        # Nothing is frozen in most flights: no dictionary is searched then.
        return np.zeros(len(names))
    fading = _fading(core, t_us, config)
    result: Vector = fading * np.array([known.get(name, 0.0) for name in names])
    return result


def _fading(core: DetectorCore, t_us: int, config: DetectorConfig) -> float:
    """What is left at `t_us` of an offset that was frozen."""
    return math.exp(-(t_us - core.frozen.t_us) * 1e-6 / config.sigma.slow_s)


def learned_offsets_m(core: DetectorCore, names: tuple[str, ...]) -> Vector:
    """What is known of the offsets (n,) in m beyond those that are subtracted."""
    ramps = core.ramps
    if ramps is None:
        return np.zeros(len(names))
    known = dict(zip(ramps.names, ramps.windows.offset.tolist(), strict=True))
    return np.array([known.get(name, 0.0) for name in names])


def freeze_offsets(core: DetectorCore, t_us: int, config: DetectorConfig) -> DetectorCore:
    """The core with what was learnt of the offsets subtracted from the ranges from now on."""
    ramps = core.ramps
    if ramps is None:
        return core
    fading = _fading(core, t_us, config)
    # Names frozen earlier may be out of view now and come back: they stay in the table.
    known = {name: fading * offset_m for name, offset_m in core.frozen.offsets_m.items()}
    for name, offset_m in zip(ramps.names, ramps.windows.offset.tolist(), strict=True):
        known[name] = known.get(name, 0.0) + offset_m
    windows = ramps.windows
    # What the windows knew at their start moves along, so that differences stay.
    windows = windows._replace(
        offset=np.zeros_like(windows.offset), offsets=windows.offsets - windows.offset
    )
    return core._replace(frozen=FrozenOffsets(t_us, known), ramps=ramps._replace(windows=windows))
