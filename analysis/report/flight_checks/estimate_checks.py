"""Checks of the autopilot's estimator: its own test ratios, and its errors against the truth."""

import numpy as np

from analysis.report.curves.recording import FlightData, Signal
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import CheckLimits, FlightCheck, Windows, check_level


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each quantity of the estimator."""
    of, hold = recording.of, th.hold_s
    ratio = CheckLimits(*th.innovation_ratio, hold_s=hold)
    variance = CheckLimits(*th.ekf_variance, hold_s=hold)
    step = CheckLimits(*th.estimate_step_m, "m")
    far = CheckLimits(*th.position_error_m, "m", hold_s=hold)
    high = CheckLimits(*th.height_error_m, "m", hold_s=hold)
    tilted = CheckLimits(*th.attitude_error_deg, "deg", hold_s=hold)
    # Only estimates of the vehicle position.
    positions = [s for s in of("position-error") if s.name in ("estimate", "fused")]
    return [
        check_level("innovation test ratios", of("ratio"), ratio, armed),
        check_level("EKF variances", of("variance"), variance, armed),
        check_level("estimate steps", of("estimate-jump"), step, armed),
        check_level("position against the truth", positions, far, armed),
        check_level("height against the truth", _height_errors(recording), high, armed),
        check_level("attitude against the truth", _tilt_errors(recording), tilted, armed),
    ]


def _height_errors(recording: FlightData) -> list[Signal]:
    """Absolute errors of the estimated altitudes, m."""
    tracks = {track.name: track for track in recording.tracks}
    truth = tracks.get("truth")
    found = []
    for name in ("estimate", "fused"):
        own = tracks.get(name)
        if truth is not None and own is not None:
            # The truth is not extrapolated.
            inside = (own.t_s >= truth.t_s[0]) & (own.t_s <= truth.t_s[-1])
            there = np.interp(own.t_s[inside], truth.t_s, truth.alt_m)
            off = np.abs(own.alt_m[inside] - there)
            found.append(Signal("altitude", name, own.t_s[inside], off))
    return found


def _tilt_errors(recording: FlightData) -> list[Signal]:
    found = []
    for panel in ("error-roll", "error-pitch", "error-yaw"):
        for signal in recording.of(panel):
            if signal.name == "autopilot":
                name = panel.removeprefix("error-")
                found.append(Signal(panel, name, signal.t_s, np.abs(signal.value)))
    return found
