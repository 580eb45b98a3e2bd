"""The windows of `memory` kept over a flight, and what they say."""

from dataclasses import dataclass

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import ERRORS
from analysis.fdi.memory import (
    STRIDE_S,
    WINDOWS,
    acceleration_statistics,
    ramp_statistics,
    respond,
    respond_to_rates,
)
from analysis.fdi.ranges import Update
from analysis.fdi.thresholds import chi_square
from analysis.fdi.verdict import PENALTY
from analysis.samples import Vector

YOUNGEST_S = 0.5  # a younger window says nothing that the main test does not
EPISODES = 1.2  # alarms per epoch over single-test probability, over windows and time: measured
LATE = 9.0  # a ramp's likelihood ratio that dates the fault of a satellite found otherwise


@dataclass(frozen=True, slots=True)
class Memory:
    """Windows over `names` (n satellites) since `starts_us`; arrays as in `memory`; `variance`
    (n,) of each satellite's range when last used."""

    names: tuple[str, ...]
    starts_us: tuple[int, ...]
    d: Vector
    sums: Vector
    variance: Vector


@dataclass(frozen=True, slots=True)
class SlowVerdict:
    """The largest ramp statistic and its threshold; whose fault it is (none, satellites, imu)."""

    statistic: float
    threshold: float
    hypothesis: str = "none"
    satellite: str = ""
    onset_us: int = 0


def new_memory(t_us: int) -> Memory:
    """Empty windows that start at `t_us`."""
    empty = np.zeros((ERRORS, 3 * WINDOWS))
    return Memory((), (t_us,) * WINDOWS, empty, np.zeros((WINDOWS, 12)), np.empty(0))


def remember(
    memory: Memory,
    t_us: int,
    dt_s: float,
    phi: Vector,
    names: tuple[str, ...],
    variance: Vector,
    update: Update,
    rates: Update | None,
) -> Memory:
    """One epoch more: the ranges of `names` (m satellites, with their variance) and the rates."""
    memory = _turned_over(_renamed(memory, names), t_us)
    place = {name: i for i, name in enumerate(memory.names)}
    slots = np.array([place[names[i]] for i in update.which], dtype=np.int64)
    known = memory.variance.copy()
    known[slots] = variance[update.which]
    ages = (t_us - np.array(memory.starts_us)) * 1e-6
    d, sums = respond(
        memory.d, memory.sums, ages, phi, update.gain, update.m, update.h, update.v, slots, dt_s
    )
    if rates is not None:
        d, sums = respond_to_rates(d, sums, rates.gain, rates.m, rates.h, rates.v)
    return Memory(memory.names, memory.starts_us, d, sums, known)


def _renamed(memory: Memory, names: tuple[str, ...]) -> Memory:
    """The windows over `names`, the same object if they are; new satellites start from nothing."""
    if memory.names == names:
        return memory
    old, new = len(memory.names), len(names)
    d = np.zeros((ERRORS, WINDOWS, 2 * new + 3))
    sums = np.zeros((WINDOWS, 5 * new + 12))
    variance = np.ones(new)
    before = memory.d.reshape(ERRORS, WINDOWS, 2 * old + 3)
    d[:, :, 2 * new :] = before[:, :, 2 * old :]
    sums[:, 5 * new :] = memory.sums[:, 5 * old :]
    place = {name: i for i, name in enumerate(memory.names)}
    for i, name in enumerate(names):
        at = place.get(name)
        if at is not None:
            for block in range(2):
                d[:, :, block * new + i] = before[:, :, block * old + at]
            for block in range(5):
                sums[:, block * new + i] = memory.sums[:, block * old + at]
            variance[i] = memory.variance[at]
    return Memory(names, memory.starts_us, d.reshape(ERRORS, -1), sums, variance)


def _turned_over(memory: Memory, t_us: int) -> Memory:
    """The oldest window started anew when the youngest is a stride old."""
    starts = list(memory.starts_us)
    if (t_us - max(starts)) * 1e-6 < STRIDE_S:
        return memory
    oldest = starts.index(min(starts))
    starts[oldest] = t_us
    each = 2 * len(memory.names) + 3
    d, sums = memory.d.copy(), memory.sums.copy()
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    sums[oldest] = 0.0
    return Memory(memory.names, tuple(starts), d, sums, memory.variance)


def ramp_table(memory: Memory, config: DetectorConfig) -> Vector:
    """Likelihood ratios (w, n) of a ramp on each satellite."""
    bias = config.sigma.slow**2 * memory.variance
    return ramp_statistics(memory.sums, bias, config.sigma.slow_mps**2)


def judge_slow(memory: Memory, t_us: int, inertial: bool, config: DetectorConfig) -> SlowVerdict:
    """Whether a window has seen a ramp, and whose; the rival is a wrong acceleration."""
    count = len(memory.names)
    threshold = chi_square(1, config.p_slow / (EPISODES * max(count, 1)))
    old_enough = (t_us - np.array(memory.starts_us)) * 1e-6 >= YOUNGEST_S
    if not old_enough.any() or not count:
        return SlowVerdict(0.0, threshold)
    ramps = np.where(old_enough[:, None], ramp_table(memory, config), 0.0)
    window, worst = np.unravel_index(int(ramps.argmax()), ramps.shape)
    statistic = float(ramps[window, worst])
    wrong = 0.0
    if inertial:
        rivals = acceleration_statistics(memory.sums, config.slow_accel_mps2**2)
        wrong = float(np.where(old_enough, rivals, 0.0).max())
    imu_cost = wrong - 3.0 * PENALTY
    if wrong > chi_square(3, config.p_slow / EPISODES) and imu_cost > statistic - 2.0 * PENALTY:
        return SlowVerdict(statistic, threshold, "imu")
    if statistic <= threshold:
        return SlowVerdict(statistic, threshold)
    onset_us = memory.starts_us[int(window)]
    return SlowVerdict(statistic, threshold, "satellites", memory.names[int(worst)], onset_us)


def onset_of(memory: Memory | None, name: str, t_us: int, config: DetectorConfig) -> int:
    """Since when a satellite found faulty at `t_us` has been so, by the windows."""
    if memory is None or name not in memory.names:
        return t_us
    ratios = ramp_table(memory, config)[:, memory.names.index(name)]
    window = int(ratios.argmax())
    return memory.starts_us[window] if ratios[window] >= LATE else t_us
