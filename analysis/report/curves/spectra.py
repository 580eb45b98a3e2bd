"""Spectra of fast signals: power spectral densities (Welch), spectrograms, filter frequencies.

Signals logged below `LEAST_HZ` or unevenly (thinned logs) have no spectrum. The highest frequency
is half the logging rate, which is often far below the sensor's rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from analysis.report.curves.recording import FlightData, Signal, Vector

# Chosen: below 20 Hz there is no motor vibration or filter effect.
LEAST_HZ, LEAST_SAMPLES = 20.0, 512
# Loggers drop samples occasionally: a signal is resampled if most of its steps are equal.
EVEN_SHARE, EVEN_WITHIN = 0.8, 0.5  # share of steps, and their tolerance relative to the median
SEGMENT, WINDOW = 1024, 256  # samples of Welch's segments, of a spectrogram's windows
COLUMNS, BINS = 300, 20  # time columns at most, throttle bins
LEAST_WINDOWS = 3  # per throttle bin

# key, title, panels in order of preference, unit of the signals
GROUPS = (
    ("spectrum-gyro", "Gyroscopes, as logged by the sensors", ("gyro-instances", "gyro"), "rad/s"),
    (
        "spectrum-rate", "Angular rates after the filters, as the controller uses them",
        ("rate-roll", "rate-pitch", "rate-yaw"), "deg/s",
    ),
    ("spectrum-accel", "Accelerometers", ("accel-instances", "accel"), "m/s²"),
    ("spectrum-torque", "Torque setpoint", ("torque",), "1"),
    ("spectrum-actuators", "Motors and outputs", ("actuators", "outputs"), "1"),
)  # fmt: skip
FILTERS = (
    ("IMU_GYRO_CUTOFF", "gyro low-pass"), ("IMU_DGYRO_CUTOFF", "D-term low-pass"),
    ("IMU_GYRO_NF0_FRQ", "notch 1"), ("IMU_GYRO_NF1_FRQ", "notch 2"),
    ("IMU_ACCEL_CUTOFF", "accel low-pass"), ("INS_GYRO_FILTER", "gyro low-pass"),
    ("INS_ACCEL_FILTER", "accel low-pass"), ("INS_HNTCH_FREQ", "harmonic notch"),
    ("INS_HNTC2_FREQ", "second harmonic notch"), ("INS_NOTCH_FREQ", "notch"),
)  # fmt: skip
ENABLED = {
    "INS_HNTCH_FREQ": "INS_HNTCH_ENABLE",
    "INS_HNTC2_FREQ": "INS_HNTC2_ENABLE",
    "INS_NOTCH_FREQ": "INS_NOTCH_ENABLE",
}


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One power spectral density: unit^2/Hz over frequency, shape (n,) each."""

    name: str
    frequency_hz: Vector
    density: Vector


@dataclass(frozen=True, slots=True)
class Spectrogram:
    """Density in decibels, shape (frequencies, columns); columns from `start` to `end` of `axis`.

    `axis` is "time" (s) or "throttle" (%).
    """

    axis: str
    start: float
    end: float
    highest_hz: float
    level_db: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SpectrumPanel:
    """The spectra of one kind of signal: densities in one plot, and spectrograms."""

    key: str
    title: str
    unit: str
    spectra: Sequence[Spectrum]
    images: Sequence[Spectrogram]


def spectrum_panels(
    recording: FlightData, window: tuple[float, float] | None = None
) -> list[SpectrumPanel]:
    """Spectra of all sufficiently fast signals, within `window` (s) if given."""

    found = []
    for key, title, panels, unit in GROUPS:
        fast = _fast_signals(recording, panels, window)
        if not fast:
            continue
        densities = [_density(signal) for signal in fast]
        found.append(SpectrumPanel(key, title, unit, densities, _images(recording, fast)))
    return found


def frequency_marks(recording: FlightData) -> list[tuple[float, str]]:
    """Frequencies (Hz) and names of filters, from parameters, and motors, from their speed."""
    # The last value, as a filter may have been set after the start.
    last = {name: history[-1][1] for name, history in recording.parameters.items() if history}
    found = [
        (last[name], text)
        for name, text in FILTERS
        # A filter without an enable parameter is on if its frequency is above zero.
        if last.get(name, 0) > 0 and last.get(ENABLED.get(name, name), 1) > 0
    ]
    # rev/min to Hz; stopped motors are ignored.
    speeds = [s.value[s.value > 0] / 60 for s in recording.of("rpm") if (s.value > 0).any()]
    if speeds:
        middle = float(np.median(np.concatenate(speeds)))
        found += [(middle, "motors"), (2 * middle, "motors × 2")]
    return found


def _fast_signals(
    recording: FlightData, panels: Sequence[str], window: tuple[float, float] | None
) -> list[Signal]:
    """Evenly sampled signals of the first panel that has any; all panels if they are axes."""
    axes = panels[0].startswith("rate-")
    found: list[Signal] = []
    for panel in panels:
        for signal in recording.of(panel):
            if axes and signal.name != "actual":
                continue
            name = panel.removeprefix("rate-") if axes else signal.name
            even = _even(signal, window)
            if even is not None:
                found.append(Signal(panel, name, *even))
        # Rates are in three panels, one per axis; else the first panel is enough.
        if found and not axes:
            break
    return found


def _even(signal: Signal, window: tuple[float, float] | None) -> tuple[Vector, Vector] | None:
    """The signal resampled at equal steps; None if slow, short, constant or uneven."""
    keep = np.isfinite(signal.value)
    if window is not None:
        keep &= (signal.t_s >= window[0]) & (signal.t_s <= window[1])
    t_s, value = signal.t_s[keep], signal.value[keep]
    if len(t_s) < LEAST_SAMPLES:
        return None
    steps = np.diff(t_s)
    step_s = float(np.median(steps))
    even = np.mean(np.abs(steps - step_s) < EVEN_WITHIN * step_s) if step_s > 0 else 0.0
    # A constant signal has no spectrum.
    if even < EVEN_SHARE or step_s > 1 / LEAST_HZ or np.ptp(value) == 0:
        return None
    # The mean step, since the median is biased if timestamps are rounded to milliseconds.
    usual = steps[np.abs(steps - step_s) < EVEN_WITHIN * step_s]
    grid = np.arange(t_s[0], t_s[-1], float(np.mean(usual)))
    return grid, np.interp(grid, t_s, value)


def _rate_hz(signal: Signal) -> float:
    return (len(signal.t_s) - 1) / float(signal.t_s[-1] - signal.t_s[0])


def _density(signal: Signal) -> Spectrum:
    # At least four segments to average over.
    segment = min(SEGMENT, 2 ** int(np.log2(len(signal.value) / 4)))
    density, frequency_hz, _ = _power(signal.value, segment, segment // 2, _rate_hz(signal))
    # Without the zero frequency.
    return Spectrum(signal.name, frequency_hz[1:], density.mean(axis=1)[1:])


def _power(
    value: Vector, size: int, hop: int, rate_hz: float
) -> tuple[NDArray[np.float64], Vector, Vector]:
    """One-sided densities (frequencies, windows) by Welch's method, frequencies, mid-times (s).

    Hann windows of an even `size`, detrended by their mean, as `matplotlib.mlab.specgram`; that
    and `scipy.signal` take longer to import than a report takes to draw.
    """
    parts = sliding_window_view(value, size)[::hop]
    window = np.hanning(size)
    lines = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    density = np.abs(lines) ** 2 / (rate_hz * np.sum(window**2))
    density[:, 1:-1] *= 2.0  # the negative frequencies
    t_s = (size / 2 + hop * np.arange(len(parts))) / rate_hz
    frequency_hz = np.fft.rfftfreq(size, 1.0 / rate_hz).astype(np.float64)
    return density.T.astype(np.float64), frequency_hz, t_s.astype(np.float64)


def _images(recording: FlightData, fast: Sequence[Signal]) -> list[Spectrogram]:
    """Spectrograms of the sum over the axes of the first instance, or over all motors: by time, and
    by throttle if logged."""
    first = [s for s in fast if s.name in ("x", "y", "z", "roll", "pitch", "yaw")] or fast
    # Axes of one sensor may differ in length by a sample.
    n = min(len(signal.value) for signal in first)
    # Windows overlap by three quarters; less in a long log, to limit the columns.
    hop = max(WINDOW // 4, -(-(n - WINDOW) // COLUMNS))
    total: NDArray[np.float64] = np.zeros(())
    for signal in first:
        level, frequency_hz, t_s = _power(signal.value[:n], WINDOW, hop, _rate_hz(signal))
        total = total + level
    # Decibels, as motors exceed the noise by orders of magnitude.
    level_db = 10 * np.log10(np.maximum(total[1:], 1e-12))
    start_s = float(first[0].t_s[0])
    step_s = float(t_s[1] - t_s[0]) if len(t_s) > 1 else 1.0
    highest_hz = float(frequency_hz[-1])
    # Columns extend by half a step on both sides.
    begin, end = start_s + float(t_s[0]) - step_s / 2, start_s + float(t_s[-1]) + step_s / 2
    images = [Spectrogram("time", begin, end, highest_hz, level_db)]
    throttle = recording.of("throttle")
    if throttle:
        by_throttle = _by_throttle(throttle[0], start_s + t_s, level_db)
        if by_throttle is not None:
            images.append(Spectrogram("throttle", 0, 100, highest_hz, by_throttle))
    return images


def _by_throttle(
    throttle: Signal, t_s: Vector, level_db: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Mean level of the columns in each throttle bin; NaN with too few."""
    # Throttle at the centre of each window.
    share = np.interp(t_s, throttle.t_s, np.nan_to_num(throttle.value))
    place = np.clip((share / 100 * BINS).astype(int), 0, BINS - 1)
    table = np.full((len(level_db), BINS), np.nan)
    for i in range(BINS):
        if (place == i).sum() >= LEAST_WINDOWS:
            table[:, i] = level_db[:, place == i].mean(axis=1)
    # At least two throttle bins are needed.
    return table if np.isfinite(table[0]).sum() > 1 else None
