"""Checks of vibration, attitude control, compass and power."""

import numpy as np

from analysis.report.curves.recording import FlightData, Signal, Windows, inside_windows
from analysis.report.curves.vehicle_phase import flying_windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import CheckLimits, FlightCheck, check_level
from analysis.report.judging.lanes_in_use import check_in_use, imu_windows

CONTROL_HOLD_S = 0.3  # chosen: out of control a vehicle oscillates, so large errors are brief
POWERED_V = 2.0  # chosen: a rail that never exceeds it is not connected


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each quantity."""
    of, hold = recording.of, th.hold_s
    shaking = th.vibration_px4_mps2 if recording.autopilot == "px4" else th.vibration_ardupilot_mps2
    control = CheckLimits(*th.attitude_control_deg, "deg", hold_s=CONTROL_HOLD_S)
    imus = imu_windows(recording)
    tilt = [signal for signal in of("control-error") if signal.name == "tilt"]
    compass = CheckLimits(*th.compass_change_percent, "% off its median", hold_s=hold)
    remaining = CheckLimits(*th.battery_remaining_percent, "%", below=True, hold_s=hold)
    # A rail that is not connected reads some hundredths of a volt; servos may always have less.
    powered = [
        s
        for s in of("board-voltage")
        if s.value.max(initial=0) > POWERED_V
        and (s.name != "servo rail" or np.nanquantile(s.value, 0.9) > th.board_voltage_v[0])
    ]
    voltage = CheckLimits(*th.board_voltage_v, "V", below=True)
    return [
        check_in_use(
            "vibration", of("vibration"), CheckLimits(*shaking, "m/s²", hold_s=hold), armed, imus
        ),
        _clipping(recording, th, armed),
        check_level("attitude control", tilt, control, flying_windows(recording)),
        check_level("compass field strength", _compass(recording), compass, armed),
        check_level("battery remaining", of("battery-remaining"), remaining, armed),
        check_level("board voltage", powered, voltage, armed),
    ]


def _clipping(recording: FlightData, th: Thresholds, armed: Windows | None) -> FlightCheck:
    """Check the clipping count since the start of the log, or while armed."""
    grown = []
    for signal in recording.of("clipping"):
        # Increments only: the counter may start at any value and restart at zero.
        steps = np.maximum(np.diff(signal.value, prepend=signal.value[:1]), 0)
        steps = np.where(inside_windows(signal.t_s, armed), steps, 0)
        grown.append(Signal("clipping", signal.name, signal.t_s, np.cumsum(steps)))
    limits, imus = CheckLimits(*th.clipping_count), imu_windows(recording)
    return check_in_use("accelerometer clipping", grown, limits, armed, imus)


def _compass(recording: FlightData) -> list[Signal]:
    """Deviation of each compass's field strength from its median, percent."""
    found = []
    for signal in recording.of("mag"):
        # Relative to its own median, as the field strength depends on the location.
        middle = float(np.nanmedian(signal.value)) if len(signal.value) else 0.0
        if middle > 0:
            change = 100 * np.abs(signal.value / middle - 1)
            found.append(Signal("mag", signal.name, signal.t_s, change))
    return found
