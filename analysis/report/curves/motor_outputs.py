"""The outputs of a multirotor's motors, from 0 to 1, whatever autopilot logged them."""

import numpy as np

from analysis.report.curves.recording import FlightData, Signal, running_mean

FIRST_MOTOR, MOTORS = 33, 8  # SERVOn_FUNCTION of ArduPilot's motors 1 to 8
PWM_US = (1000.0, 2000.0)  # ArduPilot's defaults of MOT_PWM_MIN and MOT_PWM_MAX
FEWEST_MOTORS = 3  # with fewer the mean says too little about one motor
FLYING_OUTPUT = 0.15  # chosen: mean output above which a multirotor is taken to fly
BALANCE_S = 2.0  # averaging time; chosen to suppress manoeuvres


def motor_outputs(recording: FlightData) -> list[Signal]:
    """The motor outputs of a multirotor from 0 to 1 on one time axis; empty for other vehicles."""
    motors = [s for s in recording.of("actuators") if s.name.startswith("motor")]
    if not motors:
        motors = outputs_by_function(recording)
    # Outputs that stay at zero are not connected.
    motors = [s for s in motors if np.isfinite(s.value).any() and np.nanmax(s.value) > 0.0]
    same = all(len(s.t_s) == len(motors[0].t_s) for s in motors)
    # Negative outputs belong to control surfaces or reversible motors.
    surfaces = any(np.nanmin(s.value) < 0.0 for s in motors)
    return motors if len(motors) >= FEWEST_MOTORS and same and not surfaces else []


def outputs_by_function(recording: FlightData) -> list[Signal]:
    """ArduPilot's motor outputs, identified by the parameters SERVOn_FUNCTION."""
    parameters = {name: values[-1][1] for name, values in recording.parameters.items()}
    # Zero means that the parameter is not set.
    low = parameters.get("MOT_PWM_MIN", 0.0) or PWM_US[0]
    high = parameters.get("MOT_PWM_MAX", 0.0) or PWM_US[1]
    found = []
    for signal in recording.of("outputs"):
        function = parameters.get(f"SERVO{signal.name.split()[-1]}_FUNCTION", 0.0)
        # Functions 33 to 40 are motors 1 to 8.
        if FIRST_MOTOR <= function < FIRST_MOTOR + MOTORS and high > low:
            share = np.clip((signal.value - low) / (high - low), 0.0, 1.0)
            name = f"motor {int(function) - FIRST_MOTOR + 1}"
            found.append(Signal("actuators", name, signal.t_s, share))
    return found


def balance_curves(recording: FlightData) -> list[Signal]:
    """Smoothed deviation of each motor's output from the mean of all in flight: a weak motor gets
    higher commands."""
    motors = motor_outputs(recording)
    if not motors:
        return []
    # Relative to the mean at the same time, so that climbs cancel.
    mean = np.nanmean([signal.value for signal in motors], axis=0)
    # On the ground uneven idling is harmless.
    flies = mean > FLYING_OUTPUT
    off = (Signal("balance", s.name, s.t_s[flies], (s.value - mean)[flies]) for s in motors)
    curves = [running_mean(signal, BALANCE_S) for signal in off]
    return [curve for curve in curves if len(curve.t_s)]
