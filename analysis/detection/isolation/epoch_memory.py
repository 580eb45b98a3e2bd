"""The memory of the tests from epoch to epoch, including the satellites' offsets, which are frozen
when other satellites are used than before (docs/fdi.md, "Offsets").
"""

import math
from collections.abc import Mapping

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.isolation.common_shift import CommonShift
from analysis.detection.isolation.ramp_test import RampBank
from analysis.detection.values import Value
from analysis.samples.sample import Vector


class FrozenOffsets(Value, frozen=True):
    """Offsets in m of satellites' ranges at `t_us`, subtracted since other satellites are used."""

    t_us: int
    offsets_m: dict[str, float]


NOTHING_FROZEN = FrozenOffsets(0, {})


class EpochMemory(Value, frozen=True):
    """The tests with memory.

    `ramps` are the windows that look for growing faults (None: they restart), `frozen` the
    offsets subtracted from the ranges, `variance_factor` how the ranges have fitted their noise
    model over the last minute, `common_shift` a velocity that all Doppler rates share.
    """

    ramps: RampBank | None = None
    frozen: FrozenOffsets = NOTHING_FROZEN
    variance_factor: VarianceFactor = VarianceFactor()
    common_shift: CommonShift = CommonShift()


def frozen_offsets_m(
    frozen: FrozenOffsets, names: tuple[str, ...], t_us: int, config: FilterConfig
) -> Vector:
    """The offsets (n,) in m that are subtracted from the ranges at `t_us`."""
    known = frozen.offsets_m
    if not known:
        # Nothing is frozen in most flights: no dictionary is searched then.
        return np.zeros(len(names))
    remaining = _remaining(frozen, t_us, config)
    return np.asarray(remaining * np.array([known.get(name, 0.0) for name in names]))


def _remaining(frozen: FrozenOffsets, t_us: int, config: FilterConfig) -> float:
    """The share of frozen offsets that is left at `t_us`."""
    return math.exp(-(t_us - frozen.t_us) * 1e-6 / config.sigma.slow_s)


def learned_offsets_m(ramps: RampBank | None, names: tuple[str, ...]) -> Vector:
    """The learned offsets (n,) in m, beyond those that are frozen."""
    if ramps is None:
        return np.zeros(len(names))
    known = dict(zip(ramps.names, ramps.windows.offset.tolist(), strict=True))
    return np.array([known.get(name, 0.0) for name in names])


def freeze_offsets(memory: EpochMemory, t_us: int, config: FilterConfig) -> EpochMemory:
    """The memory with the offsets learned so far subtracted from the ranges from now on."""
    ramps = memory.ramps
    if ramps is None:
        return memory
    windows = ramps.windows
    learned = dict(zip(ramps.names, windows.offset.tolist(), strict=True))
    # The offsets known at the windows' starts move too, so that differences stay the same.
    windows = windows._replace(
        offset=np.zeros_like(windows.offset), offsets=windows.offsets - windows.offset
    )
    return add_frozen(memory, learned, t_us, config)._replace(ramps=ramps._replace(windows=windows))


def add_frozen(
    memory: EpochMemory, offsets_m: Mapping[str, float], t_us: int, config: FilterConfig
) -> EpochMemory:
    """The memory with more offsets subtracted from the ranges from now on."""
    remaining = _remaining(memory.frozen, t_us, config)
    # Satellites frozen earlier may be out of view now and return: they stay in the table.
    known = {name: remaining * offset_m for name, offset_m in memory.frozen.offsets_m.items()}
    for name, offset_m in offsets_m.items():
        known[name] = known.get(name, 0.0) + offset_m
    return memory._replace(frozen=FrozenOffsets(t_us, known))
