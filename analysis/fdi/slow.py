"""The windows of `memory` kept over a flight, and what they say."""

import math
from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import ERRORS
from analysis.fdi.memory import (
    STRIDE_S,
    WINDOWS,
    acceleration_statistics,
    learn_offsets,
    ramp_statistics,
    respond,
    respond_to_rates,
)
from analysis.fdi.thresholds import chi_square
from analysis.fdi.update import Update
from analysis.fdi.verdict import PENALTY
from analysis.samples import Vector

YOUNGEST_S = 0.5  # a younger window says nothing that the main test does not
EPISODES = 1.2  # alarms per epoch over single-test probability, over windows and time: measured
LATE = 9.0  # a ramp's likelihood ratio that dates the fault of a satellite found otherwise
NEWS_S = 1.0  # epochs closer than this tell little new of an offset


class Memory(NamedTuple):
    """Windows over `names` (n satellites) since `starts_us` (None: not begun yet), kept since
    `since_us`; d and sums as in `memory`.

    `offset` and `spread` (n,) are mean and variance of each satellite's offset now, `offsets` and
    `spreads` (w, n) the same when a window started.
    """

    since_us: int
    names: tuple[str, ...]
    starts_us: tuple[int | None, ...]
    d: Vector
    sums: Vector
    offset: Vector
    spread: Vector
    offsets: Vector
    spreads: Vector


class SlowVerdict(NamedTuple):
    """The largest ramp statistic and its threshold; whose fault it is (none, satellites, imu)."""

    statistic: float
    threshold: float
    hypothesis: str = "none"
    satellite: str = ""
    onset_us: int = 0


def new_memory(t_us: int) -> Memory:
    """Windows that begin one after the other, the first when the filter has settled."""
    none, table = np.empty(0), np.empty((WINDOWS, 0))
    d, sums = np.zeros((ERRORS, 3 * WINDOWS)), np.zeros((WINDOWS, 12))
    return Memory(t_us, (), (None,) * WINDOWS, d, sums, none, none, table, table)


def remember(
    memory: Memory,
    t_us: int,
    dt_s: float,
    phi: Vector,
    names: tuple[str, ...],
    p: Vector,
    update: Update,
    config: DetectorConfig,
) -> Memory:
    """One epoch more, as the filter took it: the ranges of `names` (n satellites) and the rates.

    `p` (18, 18) is the covariance before the update.
    """
    slow = config.sigma.slow**2
    if memory.names != names:
        memory = _renamed(memory, names, slow * update.variance)
    memory = _turned_over(memory, t_us)
    ages = np.array([(t_us - start) * 1e-6 if start else 0.0 for start in memory.starts_us])
    gain, m, h, v = update.gain, update.m, update.h, update.v
    d, sums = respond(memory.d, memory.sums, memory.offsets, ages, phi, gain, m, h, v, dt_s)
    if len(update.v_rate):
        d, sums = respond_to_rates(
            d, sums, update.gain_rate, update.m_rate, update.h_rate, update.v_rate
        )
    stays = math.exp(-dt_s / config.sigma.slow_s)
    offset, spread = learn_offsets(
        memory.offset, memory.spread, p, h, update.variance, v, slow, stays, min(dt_s / NEWS_S, 1.0)
    )
    return memory._replace(d=d, sums=sums, offset=offset, spread=spread)


def _renamed(memory: Memory, names: tuple[str, ...], most: Vector) -> Memory:
    """The windows over `names`; new satellites start from nothing, with the variances `most`."""
    old, new = len(memory.names), len(names)
    d = np.zeros((ERRORS, WINDOWS, new + 3))
    sums = np.zeros((WINDOWS, 5 * new + 12))
    offset, spread = np.zeros(new), most.copy()
    offsets, spreads = np.zeros((WINDOWS, new)), np.tile(most, (WINDOWS, 1))
    before = memory.d.reshape(ERRORS, WINDOWS, old + 3)
    d[:, :, new:] = before[:, :, old:]
    sums[:, 5 * new :] = memory.sums[:, 5 * old :]
    place = {name: i for i, name in enumerate(memory.names)}
    for i, name in enumerate(names):
        at = place.get(name)
        if at is not None:
            d[:, :, i] = before[:, :, at]
            sums[:, i : 5 * new : new] = memory.sums[:, at : 5 * old : old]
            offset[i], spread[i] = memory.offset[at], memory.spread[at]
            offsets[:, i], spreads[:, i] = memory.offsets[:, at], memory.spreads[:, at]
    flat = d.reshape(ERRORS, -1)
    return Memory(
        memory.since_us, names, memory.starts_us, flat, sums, offset, spread, offsets, spreads
    )


def _turned_over(memory: Memory, t_us: int) -> Memory:
    """The oldest window started anew when the youngest is a stride old."""
    starts = [start or 0 for start in memory.starts_us]
    if (t_us - max(memory.since_us, *starts)) * 1e-6 < STRIDE_S:
        return memory
    oldest = starts.index(min(starts))
    starts[oldest] = t_us
    each = len(memory.names) + 3
    d, sums = memory.d.copy(), memory.sums.copy()
    offsets, spreads = memory.offsets.copy(), memory.spreads.copy()
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    sums[oldest] = 0.0
    offsets[oldest], spreads[oldest] = memory.offset, memory.spread
    return memory._replace(
        starts_us=tuple(start or None for start in starts),
        d=d,
        sums=sums,
        offsets=offsets,
        spreads=spreads,
    )


def ramp_table(memory: Memory, config: DetectorConfig) -> Vector:
    """Likelihood ratios (w, n) of a ramp on each satellite."""
    return ramp_statistics(memory.sums, memory.spreads, config.sigma.slow_mps**2)


def judge_slow(memory: Memory, t_us: int, inertial: bool, config: DetectorConfig) -> SlowVerdict:
    """Whether a window has seen a ramp, and whose; the rival is a wrong acceleration."""
    count = len(memory.names)
    threshold = chi_square(1, config.p_slow / (EPISODES * max(count, 1)))
    starts = [start or t_us for start in memory.starts_us]
    old_enough = [w for w in range(WINDOWS) if (t_us - starts[w]) * 1e-6 >= YOUNGEST_S]
    if not old_enough or not count:
        return SlowVerdict(0.0, threshold)
    ramps = ramp_table(memory, config)
    if len(old_enough) < WINDOWS:
        ramps = ramps[old_enough]
    window, worst = divmod(int(ramps.argmax()), count)
    statistic = float(ramps[window, worst])
    wrong = 0.0
    if inertial:
        rivals = acceleration_statistics(memory.sums, config.slow_accel_mps2**2)
        wrong = max(float(rivals[w]) for w in old_enough)
    imu_cost = wrong - 3.0 * PENALTY
    if wrong > chi_square(3, config.p_slow / EPISODES) and imu_cost > statistic - 2.0 * PENALTY:
        return SlowVerdict(statistic, threshold, "imu")
    if statistic <= threshold:
        return SlowVerdict(statistic, threshold)
    onset_us = starts[old_enough[window]]
    return SlowVerdict(statistic, threshold, "satellites", memory.names[worst], onset_us)


def onset_of(memory: Memory | None, name: str, t_us: int, config: DetectorConfig) -> int:
    """Since when a satellite found faulty at `t_us` has been so, by the windows."""
    if memory is None or name not in memory.names:
        return t_us
    ratios = ramp_table(memory, config)[:, memory.names.index(name)]
    window = int(ratios.argmax())
    start_us = memory.starts_us[window]
    return start_us if start_us is not None and ratios[window] >= LATE else t_us
