"""Names of flight modes, estimator flags, errors and events, as the autopilots define them.

PX4: `px4_custom_mode.h`. ArduPilot: the mode enumerations of each vehicle. Flags: MAVLink's
ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS.
"""

PX4_MAIN = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED",
    8: "RATTITUDE", 9: "SIMPLE", 10: "TERMINATION", 11: "ALTITUDE CRUISE",
}  # fmt: skip
PX4_AUTO = {
    1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW",
    9: "PRECLAND", 10: "VTOL TAKEOFF",
}  # fmt: skip
COPTER = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL",
    7: "CIRCLE", 9: "LAND", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD",
    17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL",
    22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL",
}  # fmt: skip
PLANE = {
    0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB",
    7: "CRUISE", 8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF",
    14: "AVOID_ADSB", 15: "GUIDED", 17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND",
    21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO", 24: "THERMAL",
}  # fmt: skip
ROVER = {
    0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE",
    10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED",
}  # fmt: skip
# ArduPilot's LogErrorSubsystem and some of its LogEvent.
ERRORS = {
    1: "main", 2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe",
    7: "GPS failsafe", 8: "ground station failsafe", 9: "fence failsafe", 10: "flight mode",
    11: "GPS", 12: "crash check", 13: "flip", 15: "parachute", 16: "EKF check",
    17: "EKF failsafe", 18: "barometer", 19: "processor", 20: "ADS-B failsafe", 21: "terrain",
    22: "navigation", 23: "terrain failsafe", 24: "EKF primary", 25: "thrust loss check",
    26: "sensor failsafe", 27: "leak failsafe", 29: "vibration failsafe", 30: "internal error",
    31: "dead reckoning failsafe",
}  # fmt: skip
EVENTS = {
    10: "armed", 11: "disarmed", 18: "landed", 19: "lost GPS", 28: "took off",
    54: "motors emergency stopped",
}  # fmt: skip
ARDUPILOT, PX4 = 3, 12
FIXED_WING, ROVERS = 1, (10, 11)
VTOLS = range(19, 26)
STATES = {5: "CRITICAL", 6: "EMERGENCY"}

# Bits of ESTIMATOR_STATUS_FLAGS.
ESTIMATOR_FLAGS = {10: "GPS glitch", 11: "accelerometer error"}
EKF_ARDUPILOT_GLITCH = 15  # bit of EKF_STATUS_FLAGS: EKF_GPS_GLITCHING


def mode_name(autopilot: int, vehicle_type: int, custom_mode: int) -> str:
    """Name of a HEARTBEAT's custom mode, as ground stations show it."""
    if autopilot == PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        # Main mode 4 is AUTO.
        if main == 4 and sub in PX4_AUTO:
            return PX4_AUTO[sub]
        return PX4_MAIN.get(main, f"mode {custom_mode}")
    # Other autopilots define their own numbers.
    if autopilot != ARDUPILOT:
        return f"mode {custom_mode}"
    table = COPTER
    if vehicle_type == FIXED_WING or vehicle_type in VTOLS:
        table = PLANE
    elif vehicle_type in ROVERS:
        table = ROVER
    return table.get(custom_mode, f"mode {custom_mode}")
