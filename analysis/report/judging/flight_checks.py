"""What is checked in a flight: one line per check, and the texts the autopilot sent.

Nothing here needs labels: GPS glitches, EKF variance, vibration, battery and compass are found in
any log that carries them.
"""

import re

import numpy as np

from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import (
    FAIL,
    NONE,
    PASS,
    WARN,
    Check,
    Limits,
    Windows,
    armed_windows,
    level,
    within,
)
from analysis.report.judging.flight_end import end_checks
from analysis.report.judging.hardware_checks import hardware_checks
from analysis.report.judging.texts import texts_check
from analysis.report.recordings.recording import Recording, Signal

FIX_2D = 2
CONTROL_HOLD_S = 0.3  # out of control, a vehicle swings: no error stays large for long
DAMAGE = re.compile("damaged|not read")
BENCH_S = 2.0  # before arming
MOST_LOST = 0.9  # beyond, the sequence numbers of several links stand in one log
FEWEST_FRAMES = 500  # of a sender, for its losses to be judged


def flight_checks(recording: Recording, thresholds: Thresholds) -> list[Check]:
    """Every check on one flight, judged or not."""
    armed = armed_windows(recording)
    checks = [
        _whole(recording, thresholds),
        *_links(recording, thresholds),
        *_body(recording, thresholds, armed),
        *_gps(recording, thresholds, armed),
        *_estimate(recording, thresholds, armed),
        *hardware_checks(recording, thresholds, armed),
        *end_checks(recording, thresholds, armed),
        _flags(recording, armed),
        texts_check(recording, armed),
        _status(recording, armed),
    ]
    return [*checks, _before_arming(recording, thresholds, armed)]


def _body(recording: Recording, th: Thresholds, armed: Windows | None) -> list[Check]:
    """Vibration, control, compass and power."""
    of, hold = recording.of, th.hold_s
    shaking = th.vibration_px4_mps2 if recording.autopilot == "px4" else th.vibration_ardupilot_mps2
    control = Limits(*th.attitude_control_deg, "deg", hold_s=CONTROL_HOLD_S)
    tilt = [signal for signal in of("control-error") if signal.name == "tilt"]
    compass = Limits(*th.compass_change_percent, "% off its median", hold_s=hold)
    remaining = Limits(*th.battery_remaining_percent, "%", below=True, hold_s=hold)
    powered = [s for s in of("board-voltage") if s.value.max(initial=0) > 0]
    voltage = Limits(*th.board_voltage_v, "V", below=True)
    return [
        level("vibration", of("vibration"), Limits(*shaking, "m/s²", hold_s=hold), armed),
        _clipping(recording, th, armed),
        level("attitude control", tilt, control, armed),
        level("compass field strength", _compass(recording), compass, armed),
        level("battery remaining", of("battery-remaining"), remaining, armed),
        level("board voltage", powered, voltage, armed),
    ]


def _gps(recording: Recording, th: Thresholds, armed: Windows | None) -> list[Check]:
    of, hold = recording.of, th.hold_s
    used = of("gps-satellites") if _has_fix(recording) else []
    satellites = Limits(*th.gps_satellites, below=True, hold_s=hold)
    dilution = Limits(*th.gps_dilution, hold_s=hold)
    jamming = Limits(*th.gps_jamming, hold_s=hold)
    return [
        _fix(recording, th, armed),
        level("GPS satellites", used, satellites, armed),
        level("GPS dilution of precision", of("gps-dilution"), dilution, armed),
        level("GPS jumps", of("gps-jump"), Limits(*th.gps_step_m, "m"), armed),
        level("GPS jamming indicator", _jamming(recording), jamming, None),
    ]


def _estimate(recording: Recording, th: Thresholds, armed: Windows | None) -> list[Check]:
    """The autopilot's estimator, by its own account and against the truth."""
    of, hold = recording.of, th.hold_s
    ratio = Limits(*th.innovation_ratio, hold_s=hold)
    variance = Limits(*th.ekf_variance, hold_s=hold)
    step = Limits(*th.estimate_step_m, "m")
    far = Limits(*th.position_error_m, "m", hold_s=hold)
    high = Limits(*th.height_error_m, "m", hold_s=hold)
    tilted = Limits(*th.attitude_error_deg, "deg", hold_s=hold)
    positions = [s for s in of("position-error") if s.name in ("estimate", "fused")]
    return [
        level("innovation test ratios", of("ratio"), ratio, armed),
        level("EKF variances", of("variance"), variance, armed),
        level("estimate steps", of("estimate-jump"), step, armed),
        level("position against the truth", positions, far, armed),
        level("height against the truth", _height_errors(recording), high, armed),
        level("attitude against the truth", _tilt_errors(recording), tilted, armed),
    ]


def _whole(recording: Recording, th: Thresholds) -> Check:
    limits = Limits(*th.broken_bytes_percent, "%")
    damage = [note for note in recording.notes if DAMAGE.search(note)]
    if damage:
        return Check(name="log is whole", verdict=WARN, evidence="; ".join(damage))
    if recording.size == 0:
        return Check(name="log is whole", verdict=PASS, evidence="no part is damaged or missing")
    percent = 100 * recording.junk_bytes / recording.size
    verdict = FAIL if percent > limits.fail else WARN if percent > limits.warn else PASS
    evidence = f"{recording.junk_bytes} of {recording.size} bytes ({percent:.2g} %) are no frame"
    return Check(name="log is whole", verdict=verdict, evidence=evidence, limit=limits.text())


def _links(recording: Recording, th: Thresholds) -> list[Check]:
    """Losses and silences of the vehicles' senders that sent enough to tell."""
    vehicles = set(recording.systems)
    lost, silent = Limits(*th.frames_lost_percent, "%"), Limits(*th.silence_s, "s")
    checks = []
    for link in recording.links:
        if link.frames < FEWEST_FRAMES or link.system not in vehicles:
            continue
        share = link.lost / (link.frames + link.lost)
        percent = 100 * share
        bad = percent > lost.fail or link.longest_gap_s > silent.fail
        doubtful = percent > lost.warn or link.longest_gap_s > silent.warn
        mixed = share > MOST_LOST
        name = f"link from {link.system}/{link.component}"
        checks.append(
            Check(
                name=f"{name} in {link.log}" if link.log else name,
                verdict=NONE if mixed else FAIL if bad else WARN if doubtful else PASS,
                evidence="sequence numbers of several links in one log, losses cannot be counted"
                if mixed
                else f"{link.lost} of {link.frames + link.lost} frames lost ({percent:.2g} %), "
                f"longest silence {link.longest_gap_s:.1f} s",
                limit=f"{lost.text()}; silence: {silent.text()}",
                panel="link-lost",
            )
        )
    return checks


def _has_fix(recording: Recording) -> bool:
    return any(signal.value.max(initial=0) >= FIX_2D for signal in recording.of("gps-fix"))


def _fix(recording: Recording, th: Thresholds, armed: Windows | None) -> Check:
    """A receiver without any fix may be one nobody relies on: that is a warning, no failure."""
    fixes = recording.of("gps-fix")
    limits = Limits(*th.gps_fix_type, below=True, hold_s=th.hold_s)
    if not fixes or _has_fix(recording):
        return level("GPS fix", fixes, limits, armed)
    evidence = "the receiver reports, but has no fix in the whole log"
    return Check(
        name="GPS fix", verdict=WARN, evidence=evidence, limit=limits.text(), panel="gps-fix"
    )


def _clipping(recording: Recording, th: Thresholds, armed: Windows | None) -> Check:
    """Counts since the first one of the log, or since arming."""
    grown = []
    for signal in recording.of("clipping"):
        steps = np.maximum(np.diff(signal.value, prepend=signal.value[:1]), 0)
        if armed is not None:
            inside = np.zeros(len(steps), bool)
            for start, end in armed:
                inside |= (signal.t_s >= start) & (signal.t_s <= end)
            steps = np.where(inside, steps, 0)
        grown.append(Signal("clipping", signal.name, signal.t_s, np.cumsum(steps)))
    return level("accelerometer clipping", grown, Limits(*th.clipping_count), armed)


def _jamming(recording: Recording) -> list[Signal]:
    return [s for s in recording.of("gps-noise") if s.name.startswith("jamming indicator")]


def _compass(recording: Recording) -> list[Signal]:
    """How far each compass' field strength is off its own median, percent."""
    found = []
    for signal in recording.of("mag"):
        middle = float(np.nanmedian(signal.value)) if len(signal.value) else 0.0
        if middle > 0:
            change = 100 * np.abs(signal.value / middle - 1)
            found.append(Signal("mag", signal.name, signal.t_s, change))
    return found


def _height_errors(recording: Recording) -> list[Signal]:
    """How far the estimated altitude is off the true one, m."""
    tracks = {track.name: track for track in recording.tracks}
    truth = tracks.get("truth")
    found = []
    for name in ("estimate", "fused"):
        own = tracks.get(name)
        if truth is not None and own is not None:
            inside = (own.t_s >= truth.t_s[0]) & (own.t_s <= truth.t_s[-1])
            there = np.interp(own.t_s[inside], truth.t_s, truth.alt_m)
            off = np.abs(own.alt_m[inside] - there)
            found.append(Signal("altitude", name, own.t_s[inside], off))
    return found


def _before_arming(recording: Recording, th: Thresholds, armed: Windows | None) -> Check:
    """What the checks of GPS and estimator find before the first arming: a warning, no failure."""
    name = "before arming"
    if not armed or armed[0][0] < BENCH_S:
        return Check(name=name, verdict=NONE, evidence="the log holds nothing of it")
    bench = [(0.0, armed[0][0])]
    checks = [*_gps(recording, th, bench), *_estimate(recording, th, bench)]
    last_s = armed[0][0] - BENCH_S  # only what lasts until then: a receiver takes time to start
    bad = [c for c in checks if c.verdict in (WARN, FAIL) and any(e > last_s for _, e in c.windows)]
    if not bad:
        return Check(name=name, verdict=PASS, evidence="nothing that lasted until arming")
    evidence = "; ".join(f"{check.name}: {check.evidence}" for check in bad)
    windows = tuple(window for check in bad for window in check.windows)
    return Check(name=name, verdict=WARN, evidence=evidence, windows=windows)


def _tilt_errors(recording: Recording) -> list[Signal]:
    found = []
    for panel in ("error-roll", "error-pitch", "error-yaw"):
        for signal in recording.of(panel):
            if signal.name == "autopilot":
                name = panel.removeprefix("error-")
                found.append(Signal(panel, name, signal.t_s, np.abs(signal.value)))
    return found


def _flags(recording: Recording, armed: Windows | None) -> Check:
    """Flags by which the autopilot itself says that something is wrong."""
    name = "flags of the autopilot"
    if armed == []:
        return Check(name=name, verdict=NONE, evidence="never armed")
    spans = [s for s in recording.spans if s.kind == "flag"]
    spans = [s for s in spans if within(s.start_s, armed) or within(s.end_s, armed)]
    if not spans:
        known = recording.of("ratio") or recording.of("variance")
        evidence = "none raised while armed" if known else "no estimator status in the log"
        return Check(name=name, verdict=PASS if known else NONE, evidence=evidence)
    shown = ", ".join(f"{s.lane} at {s.start_s:.1f} to {s.end_s:.1f} s" for s in spans[:4])
    if len(spans) > 4:
        shown += f" and {len(spans) - 4} more"
    windows = tuple((s.start_s, s.end_s) for s in spans)
    return Check(name=name, verdict=WARN, evidence=shown, limit="warn: any", windows=windows)


def _status(recording: Recording, armed: Windows | None) -> Check:
    name = "system status of the autopilot"
    if not any(span.lane.startswith("mode") for span in recording.spans):
        return Check(name=name, verdict=NONE, evidence="no heartbeats in the log")
    if armed == []:
        return Check(name=name, verdict=NONE, evidence="never armed")
    spans = [s for s in recording.spans if s.lane.startswith("system status")]
    spans = [s for s in spans if within(s.start_s, armed) or within(s.end_s, armed)]
    limit = "warn: CRITICAL while armed; fail: EMERGENCY"
    if not spans:
        return Check(name=name, verdict=PASS, evidence="never critical while armed", limit=limit)
    worst = FAIL if any(s.text == "EMERGENCY" for s in spans) else WARN
    evidence = ", ".join(f"{s.text} at {s.start_s:.1f} to {s.end_s:.1f} s" for s in spans[:5])
    windows = tuple((s.start_s, s.end_s) for s in spans)
    return Check(name=name, verdict=worst, evidence=evidence, limit=limit, windows=windows)
