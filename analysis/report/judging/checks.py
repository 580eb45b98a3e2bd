"""The checks: limits held against curves, with windows and evidence.

Peaks and percentiles are judged, not means: a second of loss of control does not move a mean. A
check whose data are missing, or too few, says so and gives no verdict.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.report.recordings.recording import FlightData, Signal, Vector, true_runs

PASS, WARN, FAIL, NONE = "PASS", "WARN", "FAIL", "not judged"
# A check that was not judged ranks below one that passed.
RANK = {NONE: 0, PASS: 1, WARN: 2, FAIL: 3}
Windows = Sequence[tuple[float, float]]  # seconds
MIN_SAMPLES = 5  # samples below which a curve bears no verdict
LONG_GAP_S = 5.0
PASS_WITHOUT_FLIGHT = {  # checks that may pass without a flight
    # These pass on a log from the bench as well.
    "log is whole", "messages of the autopilot", "system status of the autopilot",
    "GPS jamming indicator", "before arming", "log ends on the ground", "scheduler",
}  # fmt: skip


class FlightCheck(msgspec.Struct, frozen=True, kw_only=True):
    """One check: what was found, against which limit, and when.

    `windows` are seconds on the report's axis; `panel` is the plot that shows it, `levels` the
    values that warn and fail.
    """

    name: str
    verdict: str
    evidence: str
    limit: str = ""
    windows: tuple[tuple[float, float], ...] = ()
    panel: str = ""
    levels: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class CheckLimits:
    """Warning and failure limit of a value; `below` where small values are bad."""

    warn: float
    fail: float
    unit: str = ""
    below: bool = False
    hold_s: float = 0.0

    def text(self) -> str:
        """For people."""
        word = "below" if self.below else "above"
        hold = f" for {self.hold_s:g} s" if self.hold_s else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"warn {word} {self.warn:g}{unit}, fail {word} {self.fail:g}{unit}{hold}"


def verdict_of(checks: Sequence[FlightCheck]) -> str:
    """The worst of all; NO VERDICT if nothing measured in flight could be judged.

    A log that is whole, or a link without losses, says nothing about the flight.
    """
    worst = max((check.verdict for check in checks), key=RANK.__getitem__, default=NONE)
    # A bench log passes every formal check and shows no flight.
    if worst == PASS and all(_formal(check) for check in checks if check.verdict == PASS):
        worst = NONE
    return "NO VERDICT" if worst == NONE else worst


def _formal(check: FlightCheck) -> bool:
    return check.name in PASS_WITHOUT_FLIGHT or check.name.startswith("link from")


def lasting_windows(
    t_s: Vector, beyond: NDArray[np.bool_], hold_s: float
) -> list[tuple[float, float]]:
    """Stretches of at least `hold_s` in which a condition `beyond` (n,) was true at every sample.

    A sample stands for the time until the next one, but not across a gap in the data.
    """
    if len(t_s) == 0:
        return []
    # The last sample stands for as long as the usual one.
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    windows = []
    for begin, end in true_runs(beyond):
        # The value between two samples is known only if they are close.
        cuts = [begin, *(begin + 1 + np.flatnonzero(np.diff(t_s[begin:end]) > LONG_GAP_S)), end]
        for first, last in itertools.pairwise(cuts):
            stop = float(t_s[last - 1]) + step
            if stop - float(t_s[first]) >= hold_s:
                windows.append((float(t_s[first]), stop))
    return windows


def check_level(
    name: str,
    signals: Sequence[Signal],
    limits: CheckLimits,
    only: Sequence[tuple[float, float]] | None,
) -> FlightCheck:
    """Hold curves of one panel against limits, inside the windows `only` (None: everywhere)."""
    panel = signals[0].panel if signals else ""
    rows = [(s.name, *_inside(s, only)) for s in signals]
    # A handful of samples is an accident of logging, no evidence.
    rows = [row for row in rows if len(row[1]) >= MIN_SAMPLES]
    if not rows:
        reason = "no data" if not signals or only is None else "no data while armed"
        return FlightCheck(
            name=name, verdict=NONE, evidence=reason, limit=limits.text(), panel=panel
        )
    verdict, windows, worst = PASS, [], []
    for label, t_s, value in rows:
        # One comparison for both kinds of limit.
        sign = -1.0 if limits.below else 1.0
        failing = lasting_windows(t_s, sign * value > sign * limits.fail, limits.hold_s)
        # Beyond the failing limit is beyond the warning one too.
        warning = lasting_windows(t_s, sign * value > sign * limits.warn, limits.hold_s)
        found = FAIL if failing else WARN if warning else PASS
        # The worst curve of the panel decides.
        if RANK[found] > RANK[verdict]:
            verdict = found
        windows.extend(warning)
        # Signed, so that the largest is the worst for both kinds of limit.
        worst.append((sign * value.max() if sign > 0 else -value.min(), label, t_s, value))
    _, label, t_s, value = max(worst, key=lambda row: row[0])
    evidence = _evidence(label, t_s, value, limits, len(rows) > 1)
    if windows:
        evidence += _excess_text(merged_windows(windows), limits.hold_s)
    return FlightCheck(
        name=name,
        verdict=verdict,
        evidence=evidence,
        limit=limits.text(),
        windows=tuple(merged_windows(windows)),
        panel=panel,
        levels=(limits.warn, limits.fail),
    )


def _excess_text(windows: Sequence[tuple[float, float]], hold_s: float) -> str:
    if hold_s == 0:
        return f"; beyond the limit {len(windows)} time{'s' if len(windows) > 1 else ''}"
    return f"; beyond the limit for {sum(end - start for start, end in windows):.1f} s"


def _inside(signal: Signal, only: Sequence[tuple[float, float]] | None) -> tuple[Vector, Vector]:
    keep = np.isfinite(signal.value)
    if only is not None:
        within = np.zeros(len(signal.t_s), bool)
        for start, end in only:
            within |= (signal.t_s >= start) & (signal.t_s <= end)
        keep &= within
    return signal.t_s[keep], signal.value[keep]


def _evidence(label: str, t_s: Vector, value: Vector, limits: CheckLimits, several: bool) -> str:
    at = int(value.argmin() if limits.below else value.argmax())
    word = "least" if limits.below else "peak"
    # The percentile tells a lone peak from a habit.
    percent = 1 if limits.below else 99
    unit = f" {limits.unit}" if limits.unit else ""
    who = f"{label}: " if several else ""
    return (
        f"{who}{word} {value[at]:.4g}{unit} at {t_s[at]:.1f} s, "
        f"{percent}{'st' if percent == 1 else 'th'} percentile {np.percentile(value, percent):.4g}"
    )


def merged_windows(windows: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Windows in order, those that touch as one."""
    found: list[tuple[float, float]] = []
    for start, end in sorted(windows):
        # Windows that touch are one.
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((start, end))
    return found


def is_within(t_s: float, windows: Windows | None) -> bool:
    """Whether an instant lies in one of some windows (None: everywhere)."""
    return windows is None or any(start <= t_s <= end for start, end in windows)


def armed_windows(recording: FlightData) -> list[tuple[float, float]] | None:
    """When the vehicle was armed; None if the log does not say."""
    spans = [span for span in recording.spans if span.lane.startswith("armed")]
    if not spans:
        # Not "never armed": the log does not say.
        return None
    return merged_windows([(s.start_s, s.end_s) for s in spans if s.text == "armed"])
