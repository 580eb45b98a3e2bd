"""PX4 parameters for a scenario's vehicle; no I/O."""

from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.multirotor.multirotor import Multirotor

AIRFRAMES = {"multirotor": "none_iris", "fixedwing": "gazebo-classic_plane"}
MOTOR_FUNCTION = 101  # PWM_MAIN_FUNC of the first motor
RC_DISABLED = 4  # COM_RC_IN_MODE
REMOTE_CONTROL = {  # sticks on the first four channels; their loss means return (NAV_RCL_ACT)
    "COM_RC_IN_MODE": 0,
    "RC_CHAN_CNT": 8,
    "RC_MAP_ROLL": 1,
    "RC_MAP_PITCH": 2,
    "RC_MAP_THROTTLE": 3,
    "RC_MAP_YAW": 4,
}
PLANE_PARAMETERS = {  # for a plane that is faster than PX4's default airframe
    "FW_AIRSPD_MIN": 18,
    "FW_AIRSPD_TRIM": 25,
    "FW_AIRSPD_MAX": 35,
    "FW_AIRSPD_STALL": 14,
    "FW_THR_MAX": 1,
    "TRIM_PITCH": 0,
    "RWTO_ROT_AIRSPD": 22,
    "NAV_LOITER_RAD": 150,
    # Without a range finder the height may be wrong by 2 m at the end of a flight: from the default
    # flare of 0.5 m PX4 would be on the ground before it closes the throttle.
    "FW_LND_USETER": 0,
    "FW_LND_FLALT": 2.5,
    "FW_LND_FL_SINK": 0.6,  # ends the flare before the plane is slow
    "FW_LND_FL_PMIN": 7,  # above the pitch of the approach: PX4's height control is slower
}
# The messages that PX4 sends in a run, and how often.
STREAMS_HZ = {
    "HEARTBEAT": 10,  # a mode may last for less than its usual second
    "SYS_STATUS": 2,
    "EXTENDED_SYS_STATE": 2,
    "ESTIMATOR_STATUS": 2,
    "GPS_RAW_INT": 2,
    "BATTERY_STATUS": 1,
    "HOME_POSITION": 1,
    "ALTITUDE": 2,
    "VFR_HUD": 5,
    "GLOBAL_POSITION_INT": 10,
    "LOCAL_POSITION_NED": 20,
    "ATTITUDE": 20,
}
MIN_OFFSET_PA = 1e-3
ACCEPTANCE_RADIUS_M = 2.0  # as ArduCopter's WPNAV_RADIUS


def run_parameters(simulation: Simulation, height_m: float) -> dict[str, float]:
    """Return all parameters that a run sets; a take-off ends at `height_m`."""
    values: dict[str, float] = {
        "MAV_SYS_ID": 1,
        "COM_RC_IN_MODE": RC_DISABLED,
        "NAV_DLL_ACT": 2,  # without a ground station it returns, as ArduPilot does
        "MIS_TAKEOFF_ALT": height_m,
    }
    if simulation.scenario.sensors.remote_control is not None:
        values |= REMOTE_CONTROL
    if simulation.scenario.sensors.battery is not None:
        values["SIM_BAT_DRAIN"] = 0  # not PX4's own simulated battery
    offset_pa = simulation.pitot_offset_pa()
    if offset_pa is not None:
        # The calibration of an operator: PX4 would take a plane with an offset for flying, and
        # loiter at once. For PX4, zero means not calibrated.
        values["SENS_DPRES_OFF"] = offset_pa or MIN_OFFSET_PA
    vehicle = simulation.vehicle
    if isinstance(vehicle, FixedWing):
        # Without a valid airspeed PX4 flies by this throttle: with less, too slowly to flare.
        speed_mps = PLANE_PARAMETERS["FW_AIRSPD_TRIM"]
        trim = vehicle.trim(speed_mps, SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2)
        return values | PLANE_PARAMETERS | {"FW_THR_TRIM": trim.throttle}
    assert isinstance(vehicle, Multirotor)
    # The default radius of 10 m would cut the corners of small shapes.
    return values | {"NAV_ACC_RAD": ACCEPTANCE_RADIUS_M} | rotor_parameters(vehicle)


def rotor_parameters(vehicle: Multirotor) -> dict[str, float]:
    """Return positions and spin directions of the rotors, in the simulator's order."""
    motor = vehicle.parameters.motor
    values: dict[str, float] = {"CA_ROTOR_COUNT": len(vehicle.parameters.rotors)}
    for number, rotor in enumerate(vehicle.parameters.rotors):
        values[f"CA_ROTOR{number}_PX"] = rotor.x_m
        values[f"CA_ROTOR{number}_PY"] = rotor.y_m
        moment_ratio = (
            motor.torque_per_thrust_m if rotor.turns == "ccw" else -motor.torque_per_thrust_m
        )
        values[f"CA_ROTOR{number}_KM"] = moment_ratio
        values[f"PWM_MAIN_FUNC{number + 1}"] = MOTOR_FUNCTION + number
    return values
