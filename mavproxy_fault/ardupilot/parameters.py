"""ArduPilot parameters for flying on the bridge's sensors; no I/O.

SITL's own GPS, barometers and compasses are removed, because they are computed from the truth and
bypass the faults. AHRS_EKF_TYPE 3 is EKF3; type 10 is an estimator that reads the truth. GPS
parameters are set under their names before and since 4.6; ArduPilot ignores unknown names.
"""

from collections.abc import Collection, Mapping
from typing import Literal

from mavproxy_fault.ardupilot.feeding.optical_flow import SCALER
from mavproxy_fault.documents.errors import ConfigError

VehicleKind = Literal["copter", "plane"]
VEHICLE_KINDS: tuple[VehicleKind, ...] = ("copter", "plane")
EAHRS_ALL = 15  # EAHRS_SENSORS: GPS, IMU, barometer, compass
# Of the full voltage: a lithium-polymer cell in hover with 7 and with 5 percent of its charge,
# at which PX4 returns and lands (BAT_CRIT_THR, BAT_EMERGEN_THR)
RETURN_SHARE, LAND_SHARE = 0.78, 0.75
LOOP_HZ = {"copter": 400, "plane": 100}  # highest SCHED_LOOP_RATE that the bridge sets

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
    # SITL has 0.001 and 1.001; before 4.6 offsets of a missing IMU prevent arming
    **{f"INS_ACC2OFFS_{axis}": 0 for axis in "XYZ"},
    **{f"INS_ACC2SCAL_{axis}": 1 for axis in "XYZ"},
    "SIM_IMU_COUNT": 0,
    "EK3_IMU_MASK": 1,
    "BATT_MONITOR": 0,
    "SIM_FLOAT_EXCEPT": 0,  # a NaN reaches the estimator, as on hardware, without a trap
    "FS_THR_ENABLE": 0,  # there is no RC transmitter
    "FS_GCS_ENABLE": 1,  # return, as PX4's NAV_DLL_ACT in a run
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
        # 45 degrees of output, the full throw, roll it at 144 and pitch it at 37 degrees a second
        "SCALING_SPEED": 25,
        "RLL_RATE_FF": 0.31,
        "RLL_RATE_I": 0.31,
        "PTCH_RATE_FF": 1.23,
        "PTCH_RATE_I": 1.23,
        "WP_LOITER_RAD": 150,
        "AUTOLAND_WP_DIST": 1000,  # a glide slope of 3 degrees, as PX4's approach in a run
        "SERVO1_FUNCTION": 4,
        "SERVO2_FUNCTION": 19,
        "SERVO3_FUNCTION": 70,
        "SERVO4_FUNCTION": 21,
        **{f"SERVO{output}_MIN": 1000 for output in range(1, 5)},
        **{f"SERVO{output}_MAX": 2000 for output in range(1, 5)},
        **{f"SERVO{output}_TRIM": 1500 for output in (1, 2, 4)},
    },
}
FIXED_PARAMETERS = {  # a user's parameter file must not change these
    "AHRS_EKF_TYPE": "3; other estimators do not use the sensors that faults act on",
    "EAHRS_TYPE": "1, the VectorNav that the bridge simulates",
    "EAHRS_SENSORS": f"{EAHRS_ALL}; a missing sensor would be taken from the truth",
    "SIM_BARO_COUNT": "0; SITL computes its barometer from the truth",
    "SIM_GPS1_ENABLE": "0; SITL computes its GPS from the truth",
}


SensorName = tuple[str, int]  # of a message and, where it has one, its id
# What a sensor on the HIL link beyond the required ones adds
SENSOR_PARAMETERS: dict[SensorName, dict[str, float]] = {
    ("HIL_SENSOR", 1): {"SIM_IMU_COUNT": 1, "EK3_IMU_MASK": 3},
    ("HIL_GPS", 1): {"GPS2_TYPE": 14, "GPS_TYPE2": 14},  # GPS_INPUT
    # facing down
    ("DISTANCE_SENSOR", 0): {"RNGFND1_TYPE": 10, "RNGFND1_ORIENT": 25, "RNGFND1_MAX_CM": 4000},
    ("HIL_OPTICAL_FLOW", 0): {"FLOW_TYPE": 5, "FLOW_FXSCALER": SCALER, "FLOW_FYSCALER": SCALER},
    # by MAVLink; the user selects what EKF3 uses (EK3_SRC1_*)
    ("ODOMETRY", 0): {"VISO_TYPE": 1},
    ("VISION_POSITION_ESTIMATE", 0): {"VISO_TYPE": 1},
    ("RC_CHANNELS", 0): {"FS_THR_ENABLE": 1},  # its loss means return
}


def bridge_parameters(
    kind: VehicleKind, rate_hz: float, sensors: Collection[SensorName], battery_v: float | None
) -> dict[str, float]:
    """Return every parameter that the bridge sets, by step rate, sensors and full battery."""
    values: dict[str, float] = {**SENSORS, **KIND_PARAMETERS[kind]}
    values["SIM_RATE_HZ"] = round(rate_hz)
    values["SCHED_LOOP_RATE"] = min(round(rate_hz), LOOP_HZ[kind])
    values["EAHRS_RATE"] = min(round(rate_hz), 400)
    for sensor, added in SENSOR_PARAMETERS.items():
        if sensor in sensors:
            values |= added
    if battery_v is not None:
        values |= {
            "BATT_MONITOR": 4,
            "BATT_LOW_VOLT": RETURN_SHARE * battery_v,
            "BATT_FS_LOW_ACT": 2,  # return
            "BATT_CRT_VOLT": LAND_SHARE * battery_v,
            "BATT_FS_CRT_ACT": 1,  # land
        }
    return values


def check_parameters(values: Mapping[str, float]) -> None:
    """Refuse a user's parameters that would let the truth reach the estimator.

    Raises
    ------
    ConfigError
        If a fixed parameter has another value.
    """
    for name in values.keys() & FIXED_PARAMETERS.keys():
        if values[name] != SENSORS[name]:
            raise ConfigError(
                f"--parameters: {name} = {values[name]:g} bypasses the bridge; "
                f"set it to {FIXED_PARAMETERS[name]}"
            )
