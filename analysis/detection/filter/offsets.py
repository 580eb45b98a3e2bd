"""Offsets of healthy satellites, held so that the position does not jump with the geometry.

Every satellite has an offset of its own for minutes; their weighted mean is the position's error.
When one is left out, or sets, the mean is another one. So what was learnt of the offsets by then is
taken off the ranges from there on; it fades as offsets do, in `slow_s`.
"""

import math

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import Core, Held
from analysis.samples.sample import Vector


def held(core: Core, names: tuple[str, ...], t_us: int, config: DetectorConfig) -> Vector:
    """The offsets (n,) in m that are taken off the ranges at `t_us`."""
    known = core.held.offsets_m
    if not known:
        return np.zeros(len(names))
    fading = math.exp(-(t_us - core.held.t_us) * 1e-6 / config.sigma.slow_s)
    result: Vector = fading * np.array([known.get(name, 0.0) for name in names])
    return result


def learnt(core: Core, names: tuple[str, ...]) -> Vector:
    """What is known of the offsets (n,) in m beyond those that are taken off."""
    if core.memory is None:
        return np.zeros(len(names))
    known = dict(zip(core.memory.names, core.memory.offset.tolist(), strict=True))
    return np.array([known.get(name, 0.0) for name in names])


def hold(core: Core, t_us: int, config: DetectorConfig) -> Core:
    """The core with what was learnt of the offsets taken off the ranges from now on."""
    memory = core.memory
    if memory is None:
        return core
    names = tuple(dict.fromkeys((*core.held.offsets_m, *memory.names)))
    offsets_m = held(core, names, t_us, config) + learnt(core, names)
    memory = memory._replace(
        offset=np.zeros_like(memory.offset), offsets=memory.offsets - memory.offset
    )
    known = dict(zip(names, offsets_m.tolist(), strict=True))
    return core._replace(held=Held(t_us, known), memory=memory)
