"""Checks of hardware: motors, redundant sensors and estimators, battery cells, scheduler."""

import numpy as np

from analysis.report.curves.motor_outputs import motor_outputs
from analysis.report.curves.recording import FlightData, Signal, Windows
from analysis.report.curves.vehicle_phase import flying_windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import CheckLimits, FlightCheck, check_level

FLYING_OUTPUT = 0.15  # chosen: mean output above which a multirotor is taken to fly
MEAN_S = 2.0  # averaging time; chosen to suppress manoeuvres and vibration
SIMULATED = "SIM_SPEEDUP"  # a parameter of ArduPilot's own simulator
LEAST_CELL_V = 1.0  # chosen: below it a cell is not connected
FULL_OUTPUT = 0.99  # share of the range, below 1 for rounding


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check each part."""
    of, hold = recording.of, th.hold_s
    motors, flying = motor_outputs(recording), flying_windows(recording)
    gyros = [_mean(signal) for signal in of("gyro-disagreement")]
    accelerometers = [_mean(signal) for signal in of("accel-disagreement")]
    # Unconnected cells read about zero.
    cells = [s for s in of("battery-cells") if np.nanmax(s.value, initial=0.0) > LEAST_CELL_V]
    # The loop times of a simulated autopilot depend on its simulator.
    loops = [] if SIMULATED in recording.parameters else of("scheduler")
    return [
        check_level(
            "motor balance", _off_mean(motors), CheckLimits(*th.motor_balance, hold_s=hold), flying
        ),
        check_level(
            "motors at their limit", _full(motors), CheckLimits(*th.motor_limit_s, "s"), flying
        ),
        check_level(
            "gyroscopes agree", gyros, CheckLimits(*th.gyro_apart_rps, "rad/s", hold_s=hold), armed
        ),
        check_level(
            "accelerometers agree",
            accelerometers,
            CheckLimits(*th.accel_apart_mps2, "m/s²", hold_s=hold),
            armed,
        ),
        check_level(
            "estimators agree",
            of("divergence"),
            CheckLimits(*th.estimators_apart_deg, "deg", hold_s=hold),
            armed,
        ),
        check_level(
            "cell voltage", cells, CheckLimits(*th.cell_v, "V", below=True, hold_s=hold), armed
        ),
        check_level("scheduler", loops, CheckLimits(*th.long_loops_percent, "%"), armed),
    ]


def _mean(signal: Signal) -> Signal:
    """Absolute value of a curve's running mean."""
    count = len(signal.t_s)
    span_s = float(np.ptp(signal.t_s)) if count > 1 else 0.0
    samples = max(1, round(MEAN_S * count / span_s)) if span_s > 0 else 1
    # Too short for averaging.
    if count < 2 * samples:
        return Signal(signal.panel, signal.name, signal.t_s[:0], signal.value[:0])
    smooth = np.convolve(np.nan_to_num(signal.value), np.full(samples, 1 / samples), "same")
    return Signal(signal.panel, signal.name, signal.t_s, np.abs(smooth))


def _off_mean(motors: list[Signal]) -> list[Signal]:
    """Deviation of each motor's output from the mean of all motors in flight."""
    if not motors:
        return []
    mean = np.nanmean([signal.value for signal in motors], axis=0)
    # On the ground uneven idling is harmless.
    flies = mean > FLYING_OUTPUT
    off = (Signal("balance", s.name, s.t_s[flies], (s.value - mean)[flies]) for s in motors)
    return [_mean(signal) for signal in off]


def _full(motors: list[Signal]) -> list[Signal]:
    """The time that each motor has been at full output."""
    found = []
    for signal in motors:
        full = signal.value >= FULL_OUTPUT
        # Time of the last sample below full output.
        begin = np.maximum.accumulate(np.where(full, signal.t_s[0], signal.t_s))
        for_s = np.where(full, signal.t_s - begin, 0.0)
        found.append(Signal("actuators", signal.name, signal.t_s, for_s))
    return found
