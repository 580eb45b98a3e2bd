"""Checks: compare curves with limits, giving a verdict, evidence and time windows.

Peaks and percentiles are judged, not means: a one-second loss of control does not change a mean. A
check with missing or insufficient data is "not judged".
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import (
    Signal,
    Vector,
    Windows,
    inside_windows,
    merged_windows,
    true_runs,
)

PASS, WARN, FAIL, NONE = "PASS", "WARN", "FAIL", "not judged"
# "not judged" ranks below PASS.
RANK = {NONE: 0, PASS: 1, WARN: 2, FAIL: 3}
MET = {True: PASS, False: FAIL, None: NONE}  # the verdict of a criterion
MIN_SAMPLES = 5  # chosen: a curve of fewer samples is not judged
CAUSE_S, CHAIN_SHOWN = 10.0, 5  # chosen: a cause acts within this time; events in the sentence
LONG_GAP_S = 5.0  # chosen: across a longer gap a value is not assumed to persist
PASS_WITHOUT_FLIGHT = {  # checks that pass on a log without a flight too
    "log is complete", "messages of the autopilot", "system status of the autopilot",
    "GPS jamming indicator", "before arming", "landing before the log ends", "scheduler",
}  # fmt: skip


class FlightCheck(msgspec.Struct, frozen=True):
    """Result of one check: verdict, evidence, limit and time windows.

    `windows` are in seconds on the report's time axis; `panel` is the plot that shows the value,
    `levels` are the warning and failure limits.
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
    """Warning and failure limit of a value; `below` if small values are bad."""

    warn: float
    fail: float
    unit: str = ""
    below: bool = False
    hold_s: float = 0.0

    def text(self) -> str:
        """The limits as text."""
        word = "below" if self.below else "above"
        hold = f" for {self.hold_s:g} s" if self.hold_s else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"warn {word} {self.warn:g}{unit}, fail {word} {self.fail:g}{unit}{hold}"


def verdict_of(checks: Sequence[FlightCheck]) -> str:
    """The worst verdict; NO VERDICT if the data are insufficient to judge the flight.

    A complete log or a link without losses says nothing about the flight.
    """
    worst = max((check.verdict for check in checks), key=RANK.__getitem__, default=NONE)
    # A log from the bench passes these checks without a flight.
    if worst == PASS and all(_formal(check) for check in checks if check.verdict == PASS):
        worst = NONE
    return "NO VERDICT" if worst == NONE else worst


def worst_first(checks: Sequence[FlightCheck]) -> list[FlightCheck]:
    """The checks that warn or fail, failures first."""
    bad = [check for check in checks if check.verdict in (WARN, FAIL)]
    return sorted(bad, key=lambda check: -RANK[check.verdict])


def _formal(check: FlightCheck) -> bool:
    return check.name in PASS_WITHOUT_FLIGHT or check.name.startswith("link from")


def lasting_windows(
    t_s: Vector, beyond: NDArray[np.bool_], hold_s: float
) -> list[tuple[float, float]]:
    """Windows of at least `hold_s` in which `beyond` (n,) is true at every sample.

    A sample is valid until the next one, but not across a gap in the data.
    """
    if len(t_s) == 0:
        return []
    # The last sample is valid for one median step.
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    windows = []
    for begin, end in true_runs(beyond):
        # Split at gaps: the value between distant samples is unknown.
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
    only: Windows | None,
) -> FlightCheck:
    """Check the curves of a panel against limits, within the windows `only` (None: everywhere)."""
    panel = signals[0].panel if signals else ""
    rows = [(s.name, *_inside(s, only)) for s in signals]
    # Too few samples are no evidence.
    rows = [row for row in rows if len(row[1]) >= MIN_SAMPLES]
    if not rows:
        reason = "no data" if not signals or only is None else "no data while armed"
        return FlightCheck(name, NONE, reason, limits.text(), panel=panel)
    verdict, beyond, worst = PASS, [], []
    for label, t_s, value in rows:
        # One comparison for upper and lower limits.
        sign = -1.0 if limits.below else 1.0
        failing = lasting_windows(t_s, sign * value > sign * limits.fail, limits.hold_s)
        # Values beyond the failure limit are beyond the warning limit too.
        warning = lasting_windows(t_s, sign * value > sign * limits.warn, limits.hold_s)
        found = FAIL if failing else WARN if warning else PASS
        # The worst curve decides.
        if RANK[found] > RANK[verdict]:
            verdict = found
        beyond.extend(warning)
        # Signed, so that the largest is the worst for upper and lower limits.
        worst.append((sign * value.max() if sign > 0 else -value.min(), label, t_s, value))
    _, label, t_s, value = max(worst, key=lambda row: row[0])
    evidence = _evidence(label, t_s, value, limits, len(rows) > 1)
    windows = merged_windows(beyond)
    evidence += _excess_text(windows, limits.hold_s) if windows else ""
    levels = limits.warn, limits.fail
    return FlightCheck(name, verdict, evidence, limits.text(), tuple(windows), panel, levels)


def restrict_to_classes(check: FlightCheck, vehicle: str, classes: Collection[str]) -> FlightCheck:
    """The check, not judged for a class of vehicle for which it does not hold (none: for all)."""
    if not vehicle or not classes or vehicle in classes:
        return check
    evidence = f"does not hold for a {vehicle}"
    return msgspec.structs.replace(check, verdict=NONE, evidence=evidence, windows=())


def _excess_text(windows: Sequence[tuple[float, float]], hold_s: float) -> str:
    if hold_s == 0:
        return f"; beyond the limit {len(windows)} time{'s' if len(windows) > 1 else ''}"
    return f"; beyond the limit for {sum(end - start for start, end in windows):.1f} s"


def _inside(signal: Signal, only: Windows | None) -> tuple[Vector, Vector]:
    keep = np.isfinite(signal.value) & inside_windows(signal.t_s, only)
    return signal.t_s[keep], signal.value[keep]


def _evidence(label: str, t_s: Vector, value: Vector, limits: CheckLimits, several: bool) -> str:
    at = int(value.argmin() if limits.below else value.argmax())
    word = "least" if limits.below else "peak"
    # The percentile shows whether the peak is a single outlier.
    percent = 1 if limits.below else 99
    unit = f" {limits.unit}" if limits.unit else ""
    who = f"{label}: " if several else ""
    return (
        f"{who}{word} {value[at]:.4g}{unit} at {t_s[at]:.1f} s, "
        f"{percent}{'st' if percent == 1 else 'th'} percentile {np.percentile(value, percent):.4g}"
    )


def chain_of(checks: Sequence[FlightCheck]) -> list[tuple[float, FlightCheck]]:
    """Times and checks of what went wrong in flight, in order of time, the first cause first.

    It begins `CAUSE_S` before the first failure: an earlier warning is another story.
    """
    found = [
        (check.windows[0][0], check)
        for check in checks
        if check.verdict in (WARN, FAIL) and check.windows and check.name != "before arming"
    ]
    found.sort(key=lambda row: row[0])
    first_s = next((t_s for t_s, check in found if check.verdict == FAIL), -np.inf)
    return [(t_s, check) for t_s, check in found if t_s >= first_s - CAUSE_S]


def chain_text(checks: Sequence[FlightCheck]) -> str:
    """The chain as a sentence; empty with fewer than two events."""
    chain = [f"{check.name} from {t_s:.1f} s" for t_s, check in chain_of(checks)]
    return ", then ".join(chain[:CHAIN_SHOWN]) if len(chain) > 1 else ""
