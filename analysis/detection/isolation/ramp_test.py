"""Ramp tests over a flight: the windows of `ramp_windows`, and the verdict on them."""

import numpy as np

from analysis.detection.filter.inertial import ERROR_SIZE
from analysis.detection.isolation.constellations import PENALTY
from analysis.detection.isolation.isolation_config import IsolationConfig
from analysis.detection.isolation.ramp_windows import (
    STRIDE_S,
    WINDOW_COUNT,
    RampWindows,
    StrongestRamp,
    ramp_statistics,
)
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

STRIDE_US = round(STRIDE_S * 1e6)
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
        d, sums = self.windows.d.copy(), self.windows.sums.copy()
        # The last three responses of each window are those of accelerations.
        d.reshape(ERROR_SIZE, WINDOW_COUNT, -1)[:, :, -3:] = 0.0
        # c (3,) and J (3, 3) of the accelerations.
        sums[:, -12:] = 0.0
        return self._replace(windows=self.windows._replace(d=d, sums=sums))


class RampVerdict(Value, frozen=True):
    """The largest ramp statistic, its threshold, and the hypothesis: none, satellites or imu."""

    statistic: float
    threshold: float
    hypothesis: str = "none"
    satellite: str = ""
    onset_us: int = 0


def new_ramps(t_us: int) -> RampBank:
    """Windows that start one after the other, the first when the filter has settled."""
    none, table = np.empty(0), np.empty((WINDOW_COUNT, 0))
    d, sums = np.zeros((ERROR_SIZE, 3 * WINDOW_COUNT)), np.zeros((WINDOW_COUNT, 12))
    starts_us = np.zeros(WINDOW_COUNT, dtype=np.int64)
    return RampBank(t_us + STRIDE_US, (), RampWindows(starts_us, d, sums, none, none, table, table))


def prepare_ramps(
    ramps: RampBank,
    t_us: int,
    names: tuple[str, ...],
    variance: Vector,
    config: IsolationConfig,
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
    before, old, new = ramps.windows, len(ramps.names), len(names)
    d = np.zeros((ERROR_SIZE, WINDOW_COUNT, new + 3))
    d_before = before.d.reshape(ERROR_SIZE, -1, old + 3)
    sums = np.zeros((WINDOW_COUNT, 5 * new + 12))
    offset, spread = np.zeros(new), most.copy()
    offsets, spreads = np.zeros((WINDOW_COUNT, new)), np.tile(most, (WINDOW_COUNT, 1))
    d[:, :, new:] = d_before[:, :, old:]
    sums[:, 5 * new :] = before.sums[:, 5 * old :]
    place = {name: i for i, name in enumerate(ramps.names)}
    for i, name in enumerate(names):
        at = place.get(name)
        # A satellite that was not used at the last epoch starts from zero.
        if at is not None:
            d[:, :, i] = d_before[:, :, at]
            sums[:, i : 5 * new : new] = before.sums[:, at : 5 * old : old]
            offset[i], spread[i] = before.offset[at], before.spread[at]
            offsets[:, i], spreads[:, i] = before.offsets[:, at], before.spreads[:, at]
    flat = d.reshape(ERROR_SIZE, -1)
    return RampWindows(before.starts_us, flat, sums, offset, spread, offsets, spreads)


def _renewed(windows: RampWindows, t_us: int) -> RampWindows:
    """The windows with the oldest restarted."""
    # A window that has not started has stamp 0, so it is the oldest.
    oldest, each = int(windows.starts_us.argmin()), len(windows.offset) + 3
    starts_us, d, sums = windows.starts_us.copy(), windows.d.copy(), windows.sums.copy()
    offsets, spreads = windows.offsets.copy(), windows.spreads.copy()
    starts_us[oldest] = t_us
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    sums[oldest] = 0.0
    offsets[oldest], spreads[oldest] = windows.offset, windows.spread
    return RampWindows(starts_us, d, sums, windows.offset, windows.spread, offsets, spreads)


def evaluate_ramps(
    ramps: RampBank, strongest: StrongestRamp, config: IsolationConfig
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


def ramp_onset_us(ramps: RampBank | None, name: str, t_us: int, config: IsolationConfig) -> int:
    """Since when a satellite isolated at `t_us` has been faulty, by the windows."""
    if ramps is None or name not in ramps.names:
        return t_us
    windows = ramps.windows
    table = ramp_statistics(windows.sums, windows.spreads, config.ramp_numbers.slope)
    ratios = table[:, ramps.names.index(name)]
    window = int(ratios.argmax())
    start_us = int(windows.starts_us[window])
    # Without a ramp in any window the fault starts when it was found.
    return start_us if start_us and ratios[window] >= ONSET_RATIO else t_us
