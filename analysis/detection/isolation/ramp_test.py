"""The windows of `ramp_windows` over a flight, and their verdict."""

import numpy as np

from analysis.detection.filter.inertial import ERROR_SIZE
from analysis.detection.filter.measurement import Indices
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
NO_PLACES = np.empty(0, dtype=np.int64)
# 3 sigma of one parameter.
ONSET_RATIO = 9.0  # a ramp's likelihood ratio that dates the fault of a satellite found otherwise


class RampBank(Value, frozen=True):
    """The ramp tests' windows over `names` (n satellites), those at `places` (n,) among all of an
    epoch, `in_view`; the oldest begins anew at `due_us`."""

    due_us: int
    names: tuple[str, ...]
    windows: RampWindows
    in_view: tuple[str, ...] = ()
    places: Indices = NO_PLACES

    def renewed(self, t_us: int) -> "RampBank":
        """The oldest window begun anew where one is due."""
        # One at a time, a stride apart: the oldest always looks back three strides at least.
        if t_us < self.due_us:
            return self
        return self._replace(due_us=t_us + STRIDE_US, windows=_renewed(self.windows, t_us))

    def without_accelerations(self) -> "RampBank":
        """The windows with their acceleration sums cleared: without an IMU the vehicle's own
        acceleration counts as an error, with one it does not."""
        d, sums = self.windows.d.copy(), self.windows.sums.copy()
        # The last three responses of each window are those of accelerations.
        d.reshape(ERROR_SIZE, WINDOW_COUNT, -1)[:, :, -3:] = 0.0
        # c (3,) and J (3, 3) of the accelerations.
        sums[:, -12:] = 0.0
        return self._replace(windows=self.windows._replace(d=d, sums=sums))


class RampVerdict(Value, frozen=True):
    """The largest ramp statistic and its threshold; whose fault it is (none, satellites, imu)."""

    statistic: float
    threshold: float
    hypothesis: str = "none"
    satellite: str = ""
    onset_us: int = 0


def new_ramps(t_us: int) -> RampBank:
    """Windows that begin one after the other, the first when the filter has settled."""
    none, table = np.empty(0), np.empty((WINDOW_COUNT, 0))
    d, sums = np.zeros((ERROR_SIZE, 3 * WINDOW_COUNT)), np.zeros((WINDOW_COUNT, 12))
    starts_us = np.zeros(WINDOW_COUNT, dtype=np.int64)
    return RampBank(t_us + STRIDE_US, (), RampWindows(starts_us, d, sums, none, none, table, table))


def prepare_ramps(
    ramps: RampBank,
    t_us: int,
    among: tuple[str, ...],
    names: tuple[str, ...],
    variance: Vector,
    config: IsolationConfig,
) -> RampBank:
    """The ramp tests before an epoch at `t_us` in which `names` (n satellites) are used of
    `in_view`; `variance` (n,) of their ranges."""
    if ramps.names != names:
        # A new satellite's offset is as unsure as the noise model allows.
        windows = _rearranged(ramps, names, config.sigma.slow**2 * variance)
        ramps = RampBank(ramps.due_us, names, windows)
    if ramps.in_view is not among:
        places = np.array([among.index(name) for name in names], dtype=np.int64)
        # Identity: the names are compared once per change of view, not once per epoch.
        ramps = ramps._replace(in_view=among, places=places)
    return ramps.renewed(t_us)


def _rearranged(ramps: RampBank, names: tuple[str, ...], most: Vector) -> RampWindows:
    """The windows over `names`; new satellites start from nothing, with the variances `most`."""
    before, old, new = ramps.windows, len(ramps.names), len(names)
    d, d_before = (
        np.zeros((ERROR_SIZE, WINDOW_COUNT, new + 3)),
        before.d.reshape(ERROR_SIZE, -1, old + 3),
    )
    sums = np.zeros((WINDOW_COUNT, 5 * new + 12))
    offset, spread = np.zeros(new), most.copy()
    offsets, spreads = np.zeros((WINDOW_COUNT, new)), np.tile(most, (WINDOW_COUNT, 1))
    d[:, :, new:] = d_before[:, :, old:]
    sums[:, 5 * new :] = before.sums[:, 5 * old :]
    place = {name: i for i, name in enumerate(ramps.names)}
    for i, name in enumerate(names):
        at = place.get(name)
        # Satellites that left take their columns along; one that comes back starts from nothing.
        if at is not None:
            d[:, :, i] = d_before[:, :, at]
            sums[:, i : 5 * new : new] = before.sums[:, at : 5 * old : old]
            offset[i], spread[i] = before.offset[at], before.spread[at]
            offsets[:, i], spreads[:, i] = before.offsets[:, at], before.spreads[:, at]
    flat = d.reshape(ERROR_SIZE, -1)
    return RampWindows(before.starts_us, flat, sums, offset, spread, offsets, spreads)


def _renewed(windows: RampWindows, t_us: int) -> RampWindows:
    """The oldest window begun anew."""
    # A window that has not begun has stamp 0, so it is the oldest.
    oldest, each = int(windows.starts_us.argmin()), len(windows.offset) + 3
    starts_us, d, sums = windows.starts_us.copy(), windows.d.copy(), windows.sums.copy()
    offsets, spreads = windows.offsets.copy(), windows.spreads.copy()
    starts_us[oldest] = t_us
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    sums[oldest] = 0.0
    offsets[oldest], spreads[oldest] = windows.offset, windows.spread
    return RampWindows(starts_us, d, sums, windows.offset, windows.spread, offsets, spreads)


def evaluate_ramps(ramps: RampBank, found: StrongestRamp, config: IsolationConfig) -> RampVerdict:
    """Whether a window has seen a ramp, and whose; the rival is a wrong acceleration."""
    count = len(ramps.names)
    threshold = chi_square_threshold(1, config.p_slow / max(count, 1))
    # Each less a penalty for what it frees: three components of an acceleration, two for a ramp.
    statistic, imu_cost = found.ramp, found.rival - 3.0 * PENALTY
    wrong = found.rival > chi_square_threshold(3, config.p_slow)
    if wrong and imu_cost > statistic - 2.0 * PENALTY:
        return RampVerdict(statistic, threshold, "imu")
    if statistic <= threshold:
        return RampVerdict(statistic, threshold)
    onset_us = int(ramps.windows.starts_us[found.window])
    return RampVerdict(statistic, threshold, "satellites", ramps.names[found.satellite], onset_us)


def ramp_onset_us(ramps: RampBank | None, name: str, t_us: int, config: IsolationConfig) -> int:
    """Since when a satellite found faulty at `t_us` has been so, by the windows."""
    if ramps is None or name not in ramps.names:
        return t_us
    windows = ramps.windows
    table = ramp_statistics(windows.sums, windows.spreads, config.ramp_numbers.slope)
    ratios = table[:, ramps.names.index(name)]
    window = int(ratios.argmax())
    start_us = int(windows.starts_us[window])
    # A window without a ramp dates nothing: then the finding itself does.
    return start_us if start_us and ratios[window] >= ONSET_RATIO else t_us
