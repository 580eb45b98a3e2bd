"""Checks of the autopilot's estimator: its own test ratios, and its errors against the truth."""

import numpy as np

from analysis.report.curves.fused_curves import error_ned_m
from analysis.report.curves.recording import (
    FlightData,
    Signal,
    Windows,
    inside_windows,
    merged_windows,
)
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import (
    FAIL,
    NONE,
    PASS,
    CheckLimits,
    FlightCheck,
    check_level,
    lasting_windows,
)
from analysis.report.judging.lanes_in_use import check_in_use, estimator_windows

_EKF_VARIANCES = (
    "velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance",
)  # fmt: skip
# Fields that are always numbers while the estimator works, by the beginning of a message's name.
ESTIMATES = {
    "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4"),
    "ATTITUDE_TARGET": (),
    "ATTITUDE": ("roll", "pitch", "yaw"),
    "LOCAL_POSITION_NED": ("x", "y", "z", "vx", "vy", "vz"),
    "EKF_STATUS_REPORT": _EKF_VARIANCES,
    "vehicle_attitude_": (),
    "vehicle_attitude": tuple(f"q[{i}]" for i in range(4)),
    "vehicle_local_position_": (),
    "vehicle_local_position": ("x", "y", "z", "vx", "vy", "vz"),
    "ATT": ("Roll", "Pitch", "Yaw"),
    "XKF1": ("Roll", "Pitch", "Yaw", "VN", "VE", "VD"),
    "XKF4": ("SV", "SP", "SH", "SM"),
    "NKF1": ("Roll", "Pitch", "Yaw", "VN", "VE", "VD"),
    "NKF4": ("SV", "SP", "SH", "SM"),
}


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each quantity of the estimator."""
    of, hold = recording.of, th.hold_s
    ratio = CheckLimits(*th.innovation_ratio, hold_s=hold)
    variance = CheckLimits(*th.ekf_variance, hold_s=hold)
    step = CheckLimits(*th.estimate_step_m, "m")
    far = CheckLimits(*th.position_error_m, "m", hold_s=hold)
    high = CheckLimits(*th.height_error_m, "m", hold_s=hold)
    tilted = CheckLimits(*th.attitude_error_deg, "deg", hold_s=hold)
    cores = estimator_windows(recording)
    # Only estimates of the vehicle position.
    positions = [s for s in of("position-error") if s.name in ("estimate", "fused")]
    return [
        _numbers(recording, th, armed),
        check_in_use("innovation test ratios", of("ratio"), ratio, armed, cores),
        check_in_use("EKF variances", of("variance"), variance, armed, cores),
        check_level("estimate steps", of("estimate-jump"), step, armed),
        check_level("position against the truth", positions, far, armed),
        check_level("height against the truth", _height_errors(recording), high, armed),
        check_level("attitude against the truth", _tilt_errors(recording), tilted, armed),
    ]


def _numbers(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Check that the estimates are numbers: an autopilot whose estimate is NaN flies blind."""
    name, limit = "estimates are numbers", f"fail: not a number for {th.hold_s:g} s"
    windows, lost, judged = [], [], False
    for title, message in recording.messages.items():
        fields = next((f for word, f in ESTIMATES.items() if title.startswith(word)), ())
        columns = [message.columns[key] for key in fields if key in message.columns]
        inside = inside_windows(message.t_s, armed)
        if not columns or not inside.any():
            continue
        judged = True
        wrong = ~np.isfinite(np.column_stack(columns).astype(float)).all(axis=1)
        found = lasting_windows(message.t_s, wrong & inside, th.hold_s)
        windows += found
        lost += [title] if found else []
    if not windows:
        evidence = "yes" if judged else "no estimate in the log"
        return FlightCheck(
            name=name, verdict=PASS if judged else NONE, evidence=evidence, limit=limit
        )
    merged = tuple(merged_windows(windows))
    total_s = sum(end - start for start, end in merged)
    evidence = f"{', '.join(lost)}: not a number for {total_s:.1f} s from {merged[0][0]:.1f} s on"
    return FlightCheck(name=name, verdict=FAIL, evidence=evidence, limit=limit, windows=merged)


def _height_errors(recording: FlightData) -> list[Signal]:
    """Absolute errors of the estimated altitudes, m."""
    tracks = {track.name: track for track in recording.tracks}
    if "truth" not in tracks:
        return []
    names = [name for name in ("estimate", "fused") if name in tracks]
    errors = [(name, *error_ned_m(tracks[name], tracks["truth"])) for name in names]
    return [Signal("altitude", name, t_s, np.abs(error[:, 2])) for name, t_s, error in errors]


def _tilt_errors(recording: FlightData) -> list[Signal]:
    found = []
    for panel in ("error-roll", "error-pitch", "error-yaw"):
        for signal in recording.of(panel):
            if signal.name == "autopilot":
                name = panel.removeprefix("error-")
                found.append(Signal(panel, name, signal.t_s, np.abs(signal.value)))
    return found
