"""Ramp tests over a flight: the windows of `ramp_windows`, and the verdict on them."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.inertial import ERROR_SIZE
from analysis.detection.isolation.hypotheses import PENALTY
from analysis.detection.isolation.ramp_windows import (
    STRIDE_S,
    WINDOW_COUNT,
    RampWindows,
    StrongestRamp,
    ramp_ratio,
)
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

STRIDE_US = round(STRIDE_S * 1e6)  # between windows
# 3 sigma of one parameter: the ramp's likelihood ratio that dates a fault found by another test.
ONSET_RATIO = 9.0


class RampBank(Value, frozen=True):
    """Windows of ramp tests over the satellites `names` (n,); the oldest restarts at `due_us`."""

    due_us: int
    names: tuple[str, ...]
    windows: RampWindows

    def renewed(self, t_us: int) -> "RampBank":
        """With the oldest window restarted where that is due."""
        # One at a time, a stride apart: the oldest always looks back three strides at least.
        if t_us < self.due_us:
            return self
        return self._replace(due_us=t_us + STRIDE_US, windows=_renewed(self.windows, t_us))

    def without_accelerations(self) -> "RampBank":
        """The windows without their acceleration sums: for a filter without an IMU the vehicle's
        own acceleration is an error, for one that the IMU propagates it is not."""
        d = self.windows.d.copy()
        # The last three responses of each window are those of accelerations.
        d[:, :, -3:] = 0.0
        c, j = np.zeros_like(self.windows.c), np.zeros_like(self.windows.j)
        return self._replace(windows=self.windows._replace(d=d, c=c, j=j))


class RampVerdict(Value, frozen=True):
    """The largest ramp statistic, its threshold, and the hypothesis: none, satellites or imu."""

    statistic: float
    threshold: float
    hypothesis: str = "none"
    satellite: str = ""
    onset_us: int = 0


def new_ramps(t_us: int) -> RampBank:
    """Windows that start one after the other, the first when the filter has settled."""
    none, table, w = np.empty(0), np.empty((WINDOW_COUNT, 0)), WINDOW_COUNT
    d, sums, c, j = (
        np.zeros(shape) for shape in ((ERROR_SIZE, w, 3), (5, w, 0), (w, 3), (w, 3, 3))
    )
    starts_us = np.zeros(w, dtype=np.int64)
    windows = RampWindows(starts_us, d, sums, c, j, none, none, table, table)
    return RampBank(t_us + STRIDE_US, (), windows)


def prepare_ramps(
    ramps: RampBank,
    t_us: int,
    names: tuple[str, ...],
    variance: Vector,
    config: DetectorConfig,
) -> RampBank:
    """The ramp tests before an epoch at `t_us` that uses the satellites `names` (n,), with the
    `variance` (n,) of their ranges."""
    if ramps.names != names:
        # A new satellite's offset is as uncertain as the noise model allows.
        windows = _rearranged(ramps, names, config.sigma.slow**2 * variance)
        ramps = RampBank(ramps.due_us, names, windows)
    return ramps.renewed(t_us)


def _rearranged(ramps: RampBank, names: tuple[str, ...], most: Vector) -> RampWindows:
    """The windows over `names`; new satellites start from zero, with the variances `most`."""
    before, new = ramps.windows, len(names)
    place = {name: i for i, name in enumerate(ramps.names)}
    to = [i for i, name in enumerate(names) if name in place]
    at = [place[names[i]] for i in to]
    d, sums = np.zeros((ERROR_SIZE, WINDOW_COUNT, new + 3)), np.zeros((5, WINDOW_COUNT, new))
    offset, spread = np.zeros(new), most.copy()
    offsets, spreads = np.zeros((WINDOW_COUNT, new)), np.tile(most, (WINDOW_COUNT, 1))
    d[:, :, new:], d[:, :, to] = before.d[:, :, -3:], before.d[:, :, at]
    sums[:, :, to] = before.sums[:, :, at]
    offset[to], spread[to] = before.offset[at], before.spread[at]
    offsets[:, to], spreads[:, to] = before.offsets[:, at], before.spreads[:, at]
    return before._replace(
        d=d, sums=sums, offset=offset, spread=spread, offsets=offsets, spreads=spreads
    )


def _renewed(windows: RampWindows, t_us: int) -> RampWindows:
    """The windows with the oldest restarted."""
    copies = {name: column.copy() for name, column in windows._asdict().items()}
    windows = windows._replace(**copies)
    # A window that has not started has stamp 0, so it is the oldest.
    oldest = int(windows.starts_us.argmin())
    windows.starts_us[oldest] = t_us
    windows.d[:, oldest] = windows.sums[:, oldest] = 0.0
    windows.c[oldest] = windows.j[oldest] = 0.0
    windows.offsets[oldest], windows.spreads[oldest] = windows.offset, windows.spread
    return windows


def evaluate_ramps(
    ramps: RampBank, strongest: StrongestRamp, config: DetectorConfig
) -> RampVerdict:
    """Whether a window shows a ramp, and of which satellite, or a wrong acceleration instead."""
    count = len(ramps.names)
    threshold = chi_square_threshold(1, config.p_slow / max(count, 1))
    # Each less a penalty per freed parameter: three of an acceleration, two of a ramp.
    statistic, imu_cost = strongest.ramp, strongest.rival - 3.0 * PENALTY
    wrong = strongest.rival > chi_square_threshold(3, config.p_slow)
    if wrong and imu_cost > statistic - 2.0 * PENALTY:
        return RampVerdict(statistic, threshold, "imu")
    if statistic <= threshold:
        return RampVerdict(statistic, threshold)
    onset_us = int(ramps.windows.starts_us[strongest.window])
    return RampVerdict(
        statistic, threshold, "satellites", ramps.names[strongest.satellite], onset_us
    )


def ramp_onset_us(ramps: RampBank | None, name: str, t_us: int, config: DetectorConfig) -> int:
    """Since when a satellite isolated at `t_us` has been faulty, by the windows."""
    if ramps is None or name not in ramps.names:
        return t_us
    windows, i, slope = ramps.windows, ramps.names.index(name), float(config.sigma.slow_mps) ** 2
    ratios = [ramp_ratio(windows, w, i, slope) for w in range(WINDOW_COUNT)]
    window = ratios.index(max(ratios))
    start_us = int(windows.starts_us[window])
    # Without a ramp in any window the fault starts when it was found.
    return start_us if start_us and ratios[window] >= ONSET_RATIO else t_us
