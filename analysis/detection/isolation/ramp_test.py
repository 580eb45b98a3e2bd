"""The windows of `ramp_windows` kept over a flight, and what they say."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.inertial import ERRORS
from analysis.detection.filter.measurement import Indices
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.hypotheses import PENALTY
from analysis.detection.isolation.ramp_windows import STRIDE_S, WINDOWS, ramp_statistics
from analysis.detection.values import Value
from analysis.samples.sample import Vector

STRIDE_US = round(STRIDE_S * 1e6)
NOWHERE = np.empty(0, dtype=np.int64)
LATE = 9.0  # a ramp's likelihood ratio that dates the fault of a satellite found otherwise


class Memory(Value, frozen=True):
    """Windows over `names` (n satellites), each since `starts_us` (w,) (0: not begun yet), the next
    to begin at `due_us`; d and sums as in `ramp_windows`.

    The satellites are those at `places` (n,) among all of an epoch, `among`.

    `offset` and `spread` (n,) are mean and variance of each satellite's offset now, `offsets` and
    `spreads` (w, n) the same when a window started.
    """

    due_us: int
    names: tuple[str, ...]
    starts_us: Indices
    d: Vector
    sums: Vector
    offset: Vector
    spread: Vector
    offsets: Vector
    spreads: Vector
    among: tuple[str, ...] = ()
    places: Indices = NOWHERE

    def turned_over(self, t_us: int) -> "Memory":
        """The oldest window started anew where one is due."""
        return self if t_us < self.due_us else _turned_over(self, t_us)

    def without_accelerations(self) -> "Memory":
        """The windows without what they have seen of an acceleration: to a filter that moves freely
        the vehicle's own is one, to one that the IMU moves it is none."""
        d, sums = self.d.copy(), self.sums.copy()
        d.reshape(ERRORS, WINDOWS, -1)[:, :, -3:] = 0.0
        sums[:, -12:] = 0.0
        return self._replace(d=d, sums=sums)


class Strongest(Value, frozen=True):
    """What stands out most: the ratio of a ramp, in which window and of which satellite (-1: no
    window is old enough), and that of the rival, a wrong acceleration."""

    ramp: float
    window: int
    satellite: int
    rival: float


class SlowVerdict(Value, frozen=True):
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
    starts_us = np.zeros(WINDOWS, dtype=np.int64)
    return Memory(t_us + STRIDE_US, (), starts_us, d, sums, none, none, table, table)


def ready(
    memory: Memory,
    t_us: int,
    among: tuple[str, ...],
    names: tuple[str, ...],
    variance: Vector,
    config: DetectorConfig,
) -> Memory:
    """The memory before an epoch at `t_us` in which `names` (n satellites) are used of `among`;
    `variance` (n,) of their ranges."""
    if memory.names != names:
        memory = _renamed(memory, names, config.sigma.slow**2 * variance)
    if memory.among is not among:
        places = np.array([among.index(name) for name in names], dtype=np.int64)
        memory = memory._replace(among=among, places=places)
    return memory.turned_over(t_us)


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
        memory.due_us, names, memory.starts_us, flat, sums, offset, spread, offsets, spreads
    )


def _turned_over(memory: Memory, t_us: int) -> Memory:
    """The oldest window started anew."""
    oldest = int(memory.starts_us.argmin())
    each = len(memory.names) + 3
    starts_us, d, sums = memory.starts_us.copy(), memory.d.copy(), memory.sums.copy()
    offsets, spreads = memory.offsets.copy(), memory.spreads.copy()
    starts_us[oldest] = t_us
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    sums[oldest] = 0.0
    offsets[oldest], spreads[oldest] = memory.offset, memory.spread
    return memory._replace(
        due_us=t_us + STRIDE_US,
        starts_us=starts_us,
        d=d,
        sums=sums,
        offsets=offsets,
        spreads=spreads,
    )


def judge_slow(memory: Memory, found: Strongest, config: DetectorConfig) -> SlowVerdict:
    """Whether a window has seen a ramp, and whose; the rival is a wrong acceleration."""
    count = len(memory.names)
    threshold = chi_square(1, config.p_slow / max(count, 1))
    statistic, imu_cost = found.ramp, found.rival - 3.0 * PENALTY
    wrong = found.rival > chi_square(3, config.p_slow)
    if wrong and imu_cost > statistic - 2.0 * PENALTY:
        return SlowVerdict(statistic, threshold, "imu")
    if statistic <= threshold:
        return SlowVerdict(statistic, threshold)
    onset_us = int(memory.starts_us[found.window])
    return SlowVerdict(statistic, threshold, "satellites", memory.names[found.satellite], onset_us)


def onset_of(memory: Memory | None, name: str, t_us: int, config: DetectorConfig) -> int:
    """Since when a satellite found faulty at `t_us` has been so, by the windows."""
    if memory is None or name not in memory.names:
        return t_us
    table = ramp_statistics(memory.sums, memory.spreads, config.sigma.slow_mps**2)
    ratios = table[:, memory.names.index(name)]
    window = int(ratios.argmax())
    start_us = int(memory.starts_us[window])
    return start_us if start_us and ratios[window] >= LATE else t_us
