"""Vibration, control, compass and power."""

import numpy as np

from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import CheckLimits, FlightCheck, Windows, check_level
from analysis.report.recordings.recording import FlightData, Signal

CONTROL_HOLD_S = 0.3  # out of control, a vehicle swings: no error stays large for long
POWERED_V = 2.0  # that a rail had once, or it is not connected


def checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """One check a quantity."""
    of, hold = recording.of, th.hold_s
    shaking = th.vibration_px4_mps2 if recording.autopilot == "px4" else th.vibration_ardupilot_mps2
    control = CheckLimits(*th.attitude_control_deg, "deg", hold_s=CONTROL_HOLD_S)
    tilt = [signal for signal in of("control-error") if signal.name == "tilt"]
    compass = CheckLimits(*th.compass_change_percent, "% off its median", hold_s=hold)
    remaining = CheckLimits(*th.battery_remaining_percent, "%", below=True, hold_s=hold)
    # A rail that was never powered has no limit: it shows some hundredths of a volt.
    powered = [s for s in of("board-voltage") if s.value.max(initial=0) > POWERED_V]
    voltage = CheckLimits(*th.board_voltage_v, "V", below=True)
    return [
        check_level(
            "vibration", of("vibration"), CheckLimits(*shaking, "m/s²", hold_s=hold), armed
        ),
        _clipping(recording, th, armed),
        check_level("attitude control", tilt, control, armed),
        check_level("compass field strength", _compass(recording), compass, armed),
        check_level("battery remaining", of("battery-remaining"), remaining, armed),
        check_level("board voltage", powered, voltage, armed),
    ]


def _clipping(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Counts since the first one of the log, or since arming."""
    grown = []
    for signal in recording.of("clipping"):
        # Steps only: the counter may begin anywhere, and a restart counts nothing.
        steps = np.maximum(np.diff(signal.value, prepend=signal.value[:1]), 0)
        if armed is not None:
            inside = np.zeros(len(steps), bool)
            for start, end in armed:
                inside |= (signal.t_s >= start) & (signal.t_s <= end)
            steps = np.where(inside, steps, 0)
        grown.append(Signal("clipping", signal.name, signal.t_s, np.cumsum(steps)))
    return check_level("accelerometer clipping", grown, CheckLimits(*th.clipping_count), armed)


def _compass(recording: FlightData) -> list[Signal]:
    """How far each compass' field strength is off its own median, percent."""
    found = []
    for signal in recording.of("mag"):
        # Its own median: the field's strength differs from place to place.
        middle = float(np.nanmedian(signal.value)) if len(signal.value) else 0.0
        if middle > 0:
            change = 100 * np.abs(signal.value / middle - 1)
            found.append(Signal("mag", signal.name, signal.t_s, change))
    return found
