"""Names of errors and events, as the autopilots define them."""

# ArduPilot's LogErrorSubsystem and some of its LogEvent.
ERRORS = {
    1: "main", 2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe",
    7: "GPS failsafe", 8: "ground station failsafe", 9: "fence failsafe", 10: "flight mode",
    11: "GPS", 12: "crash check", 13: "flip", 15: "parachute", 16: "EKF check",
    17: "EKF failsafe", 18: "barometer", 19: "processor", 20: "ADS-B failsafe", 21: "terrain",
    22: "navigation", 23: "terrain failsafe", 24: "EKF primary", 25: "thrust loss check",
    26: "sensor failsafe", 27: "leak failsafe", 29: "vibration compensation", 30: "internal error",
    31: "dead reckoning failsafe",
}  # fmt: skip
# ArduPilot's ModeReason: why it changed the mode by itself, to protect the vehicle.
FAILSAFE_REASONS = {
    3: "radio failsafe", 4: "battery failsafe", 5: "ground station failsafe", 6: "EKF failsafe",
    7: "GPS glitch", 10: "fence breached", 11: "terrain failsafe", 14: "avoidance",
    17: "terminated", 19: "crash failsafe", 25: "failsafe", 29: "leak failsafe",
    50: "dead reckoning failsafe", 51: "failsafe in take-off",
}  # fmt: skip
EVENTS = {
    10: "armed", 11: "disarmed", 18: "landed", 19: "lost GPS", 28: "took off",
    54: "motors emergency stopped",
}  # fmt: skip
STATES = {5: "CRITICAL", 6: "EMERGENCY"}
