"""Check that the autopilot's estimates are numbers."""

import numpy as np

from analysis.report.curves.recording import FlightData, Windows, inside_windows, merged_windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, FlightCheck, lasting_windows

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
    """Check the estimates within windows: an autopilot whose estimate is NaN flies blind."""
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
        evidence = "yes" if judged else "no position, velocity or attitude estimate in the log"
        return [FlightCheck(name, PASS if judged else NONE, evidence, limit)]
    merged = tuple(merged_windows(windows))
    total_s = sum(end - start for start, end in merged)
    evidence = f"{', '.join(lost)}: not a number for {total_s:.1f} s from {merged[0][0]:.1f} s on"
    return [FlightCheck(name, FAIL, evidence, limit, merged)]
