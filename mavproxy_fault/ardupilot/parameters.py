"""The parameters with which ArduPilot flies on the bridge's sensors; no I/O.

SITL's own GPS, barometers and compasses are removed, since they are made from the truth, which no
fault touches. AHRS_EKF_TYPE 3 is EKF3; type 10 would be an estimator that reads the truth.
GPS parameters stand under their names before 4.6 too; ArduPilot ignores what it does not know.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from mavproxy_fault.ardupilot.feeding.optical_flow import SCALER
from mavproxy_fault.documents.errors import ConfigError

VehicleKind = Literal["copter", "plane"]
VEHICLE_KINDS: tuple[VehicleKind, ...] = ("copter", "plane")
EAHRS_ALL = 15  # EAHRS_SENSORS: GPS, IMU, barometer, compass
LOOP_HZ = {"copter": 400, "plane": 100}

SENSORS = {
    "AHRS_EKF_TYPE": 3,
    "EK3_ENABLE": 1,
    "EAHRS_TYPE": 1,
    "EAHRS_SENSORS": EAHRS_ALL,
    "SERIAL6_PROTOCOL": 36,  # external AHRS
    "GPS1_TYPE": 21,
    "GPS_TYPE": 21,
    "SIM_GPS1_ENABLE": 0,
    "SIM_GPS_DISABLE": 1,
    "SIM_BARO_COUNT": 0,
    **{f"SIM_MAG{number}_DEVID": 0 for number in range(1, 7)},
    "COMPASS_OFS_X": 0,
    "COMPASS_OFS_Y": 0,
    "COMPASS_OFS_Z": 0,
    "INS_GYR_CAL": 1,
    # SITL's are 0.001 and 1.001; before 4.6 offsets of an IMU that is not there forbid arming
    **{f"INS_ACC2OFFS_{axis}": 0 for axis in "XYZ"},
    **{f"INS_ACC2SCAL_{axis}": 1 for axis in "XYZ"},
    "BATT_MONITOR": 0,
    "SIM_FLOAT_EXCEPT": 0,  # a NaN reaches the estimator, as on hardware, and traps nobody
    "FS_THR_ENABLE": 0,  # nobody holds a radio
    "FS_GCS_ENABLE": 0,
    "LOG_DISARMED": 1,
    # streams of the first serial device, Hz: estimates for the recordings and the reports
    "SR0_EXTRA1": 20,
    "SR0_POSITION": 10,
    "SR0_EXT_STAT": 2,
    "SR0_EXTRA3": 2,
}
KIND_PARAMETERS: dict[VehicleKind, dict[str, float]] = {
    "copter": {
        "FRAME_CLASS": 1,
        "FRAME_TYPE": 1,  # X
        "MOT_PWM_MIN": 1000,
        "MOT_PWM_MAX": 2000,
        "MOT_THST_EXPO": 0.85,  # of the simulator's iris
        "MOT_THST_HOVER": 0.5,
        "ATC_RAT_YAW_P": 0.3,
        "ATC_RAT_YAW_I": 0.02,
    },
    "plane": {
        "ARSPD_TYPE": 2,  # analog, which SITL makes from the line's airspeed
        "ARSPD_PIN": 1,
        "ARSPD_USE": 1,
        # the simulator's aerosonde, m/s and percent
        "AIRSPEED_MIN": 18,
        "AIRSPEED_CRUISE": 25,
        "AIRSPEED_MAX": 35,
        "TRIM_THROTTLE": 40,
        "THR_MAX": 100,
        "TKOFF_ROTATE_SPD": 22,
        "WP_LOITER_RAD": 150,
        "SERVO1_FUNCTION": 4,
        "SERVO2_FUNCTION": 19,
        "SERVO3_FUNCTION": 70,
        "SERVO4_FUNCTION": 21,
        **{f"SERVO{output}_MIN": 1000 for output in range(1, 5)},
        **{f"SERVO{output}_MAX": 2000 for output in range(1, 5)},
        **{f"SERVO{output}_TRIM": 1500 for output in (1, 2, 4)},
    },
}
FIXED_PARAMETERS = {  # a file of the user's must not change these
    "AHRS_EKF_TYPE": "3; others do not estimate from the sensors that faults act on",
    "EAHRS_TYPE": "1, the VectorNav that the bridge is",
    "EAHRS_SENSORS": f"{EAHRS_ALL}; what is missing would come from the truth",
    "SIM_BARO_COUNT": "0; SITL's barometer is made from the truth",
    "SIM_GPS1_ENABLE": "0; SITL's GPS is made from the truth",
}


@dataclass(frozen=True, slots=True)
class AvailableSensors:
    """What the HIL link showed: sensors beyond the first, and the rate of steps."""

    rate_hz: float
    second_imu: bool
    second_gps: bool
    rangefinder: bool
    flow: bool = False
    vision: bool = False


def bridge_parameters(kind: VehicleKind, fitted: AvailableSensors) -> dict[str, float]:
    """Every parameter that the bridge sets."""
    found: dict[str, float] = {**SENSORS, **KIND_PARAMETERS[kind]}
    found["SIM_RATE_HZ"] = round(fitted.rate_hz)
    found["SCHED_LOOP_RATE"] = min(round(fitted.rate_hz), LOOP_HZ[kind])
    found["EAHRS_RATE"] = min(round(fitted.rate_hz), 400)
    found["SIM_IMU_COUNT"] = 1 if fitted.second_imu else 0
    found["EK3_IMU_MASK"] = 3 if fitted.second_imu else 1
    if fitted.second_gps:
        found |= {"GPS2_TYPE": 14, "GPS_TYPE2": 14}  # GPS_INPUT
    if fitted.rangefinder:  # DISTANCE_SENSOR, looking down
        found |= {"RNGFND1_TYPE": 10, "RNGFND1_ORIENT": 25, "RNGFND1_MAX_CM": 4000}
    if fitted.flow:  # OPTICAL_FLOW
        found |= {"FLOW_TYPE": 5, "FLOW_FXSCALER": SCALER, "FLOW_FYSCALER": SCALER}
    if fitted.vision:  # by MAVLink; which of it EKF3 uses is the user's choice, EK3_SRC1_
        found["VISO_TYPE"] = 1
    return found


def parameter_file_text(values: dict[str, float]) -> str:
    """A parameter file."""
    return "".join(f"{name} {value:g}\n" for name, value in values.items())


def check_parameter_file(lines: Iterable[str], where: str) -> None:
    """Refuse a user's parameter file that would let the truth reach the estimator.

    Raises
    ------
    ConfigError
        If a line sets a fixed parameter to another value.
    """
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if len(words) < 2 or words[0] not in FIXED_PARAMETERS:
            continue
        name, text = words[:2]
        if text not in (str(SENSORS[name]), f"{SENSORS[name]}.0"):
            raise ConfigError(
                f"{where}:{number}: {name} = {text} is not for the bridge; "
                f"it must be {FIXED_PARAMETERS[name]}"
            )
