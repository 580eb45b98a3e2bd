"""Checks of the autopilot's own reports: flags, messages, estimator switches, system status."""

import numpy as np

from analysis.report.curves.recording import FlightData, Span, Windows, inside_windows
from analysis.report.judging.autopilot_texts import texts_check
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, FlightCheck
from analysis.scoring.vehicle_outcome import is_within

SWITCH_WINDOW_S = 10.0  # chosen: repeated switches within it show an unstable choice
CLEARED_S = 1.0  # chosen: an estimator that clears a flag at arming does so within it
LOG_START_S, STANDSTILL_MPS = 1.0, 1.0  # chosen: estimator start-up on the ground
# The flag of a sensor, by its panel.
FLAGS_OF = {"gps-fix": "GPS glitch", "mag": "compass timeout"}


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each kind of report."""
    return [
        _flags(recording, armed),
        _switches(recording, th, armed),
        texts_check(recording, armed),
        _status(recording, armed),
    ]


def _flags(recording: FlightData, armed: Windows | None) -> FlightCheck:
    """Check that the autopilot raised no flag while armed."""
    name = "flags of the autopilot"
    # An empty list means never armed; None means unknown.
    if armed == []:
        return FlightCheck(name, NONE, "never armed")
    # Without the sensor ArduPilot's estimator raises its flag from the beginning.
    absent = {text for panel, text in FLAGS_OF.items() if not recording.of(panel)}
    spans = [s for s in recording.spans if s.kind == "flag" and s.text not in absent]
    # Flags that were raised on the ground count too, if they do not end at arming.
    spans = [s for s in spans if _reaches(s, armed)]
    if armed is None:
        spans = [s for s in spans if not _starts(recording, s)]
    if not spans:
        known = recording.of("ratio") or recording.of("variance")
        evidence = "none raised while armed" if known else "no estimator status in the log"
        return FlightCheck(name, PASS if known else NONE, evidence)
    shown = ", ".join(f"{s.lane} at {s.start_s:.1f} to {s.end_s:.1f} s" for s in spans[:4])
    if len(spans) > 4:
        shown += f" and {len(spans) - 4} more"
    windows = tuple((s.start_s, s.end_s) for s in spans)
    return FlightCheck(name, WARN, shown, "warn: any", windows)


def _reaches(span: Span, armed: Windows | None) -> bool:
    """Whether a condition begins while armed, or lasts into it: its end is seen late."""
    last_s = max(span.start_s, span.end_s - CLEARED_S)
    return armed is None or any(span.start_s <= end and last_s >= start for start, end in armed)


def _starts(recording: FlightData, span: Span) -> bool:
    """Whether a flag is due to estimator start-up: raised at the start of the log while the
    receiver reports standstill."""
    speed = recording.curve("speed", "GPS")
    if span.start_s > LOG_START_S or speed is None:
        return False
    inside = speed.value[inside_windows(speed.t_s, [(span.start_s, span.end_s)])]
    return bool(len(inside) and np.nanmax(inside) < STANDSTILL_MPS)


def _switches(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Check how often the estimator in use changed: one switch is normal, many in seconds are
    not."""
    name, (warn, fail) = "estimator switches", th.estimator_switches
    limit = f"warn from {warn:g}, fail from {fail:g} within {SWITCH_WINDOW_S:g} s"
    spans = [s for s in recording.spans if s.lane == "estimator in use"]
    if not spans or armed == []:
        reason = "never armed" if spans else "no switch in the log"
        return FlightCheck(name, NONE, reason, limit)
    # The first span is the initial estimator.
    starts_s = np.sort([s.start_s for s in spans])[1:]
    starts_s = starts_s[[is_within(float(t_s), armed) for t_s in starts_s]]
    counts = np.arange(1, len(starts_s) + 1) - np.searchsorted(starts_s, starts_s - SWITCH_WINDOW_S)
    most = int(counts.max(initial=0))
    if most < warn:
        return FlightCheck(name, PASS, f"at most {most} within {SWITCH_WINDOW_S:g} s", limit)
    end_s = float(starts_s[counts.argmax()])
    text = f"{len(starts_s)} switches, {most} in the {SWITCH_WINDOW_S:g} s before {end_s:.1f} s"
    window = end_s - SWITCH_WINDOW_S, end_s
    return FlightCheck(name, FAIL if most >= fail else WARN, text, limit, (window,))


def _status(recording: FlightData, armed: Windows | None) -> FlightCheck:
    name = "system status of the autopilot"
    # The system status comes in heartbeats.
    if not any(span.lane.startswith("mode") for span in recording.spans):
        return FlightCheck(name, NONE, "no heartbeats in the log")
    if armed == []:
        return FlightCheck(name, NONE, "never armed")
    spans = [s for s in recording.spans if s.lane.startswith("system status")]
    spans = [s for s in spans if _reaches(s, armed)]
    limit = "warn: CRITICAL while armed; fail: EMERGENCY"
    if not spans:
        return FlightCheck(name, PASS, "never critical while armed", limit)
    worst = FAIL if any(s.text == "EMERGENCY" for s in spans) else WARN
    evidence = ", ".join(f"{s.text} at {s.start_s:.1f} to {s.end_s:.1f} s" for s in spans[:5])
    windows = tuple((s.start_s, s.end_s) for s in spans)
    return FlightCheck(name, worst, evidence, limit, windows)
