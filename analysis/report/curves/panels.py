"""The plots of a report in order: section, title and unit."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot over time; signals refer to it by `key`; `log` means a logarithmic axis.

    It is shown if it has at least `least` curves.
    """

    key: str
    section: str
    title: str
    unit: str
    log: bool = False
    least: int = 1


TIMELINE = "Timeline"
CHECKS = "Checks"
DETECTION = "Fault detection"
FUSION = "Fused solution"
FAULT_EFFECTS = "Effects of the faults"
ATTITUDE = "Attitude"
POSITION = "Position and speed"
ESTIMATOR = "The autopilot's estimator"
GPS = "GPS"
SENSORS = "Sensors"
POWER = "Battery and power"
SYSTEM = "System"
LINK = "Link quality"
ACTUATORS = "Control"
SPECTRA = "Spectra"
FIELDS = "Any field"

PANELS = (
    Panel("fdi-statistic", DETECTION, "Chi-square statistic of the GNSS residuals", "", True),
    Panel("fdi-residual", DETECTION, "Residuals per satellite", "m"),
    Panel("fdi-normalised", DETECTION, "Residuals per satellite over their sigma", ""),
    Panel("fdi-sensor", DETECTION, "Sensor statistics over their thresholds", "", True),
    Panel("fdi-probability", DETECTION, "Probability of each hypothesis", ""),
    Panel("fused-north", FUSION, "Position error north, 3 sigma of the fused position", "m"),
    Panel("fused-east", FUSION, "Position error east, 3 sigma of the fused position", "m"),
    Panel("fused-down", FUSION, "Position error down, 3 sigma of the fused position", "m"),
    Panel("fused-sigma", FUSION, "Position sigma", "m"),
    Panel("fused-weight", FUSION, "Weights of the sources in use", ""),
    Panel("twin-position", FAULT_EFFECTS, "Position deviation from the reference flight", "m"),
    Panel("twin-speed", FAULT_EFFECTS, "Velocity deviation from the reference flight", "m/s"),
    Panel("twin-attitude", FAULT_EFFECTS, "Attitude deviation from the reference flight", "deg"),
    Panel("error-angle", ATTITUDE, "Attitude error: total angle", "deg"),
    Panel("error-roll", ATTITUDE, "Attitude error: roll", "deg"),
    Panel("error-pitch", ATTITUDE, "Attitude error: pitch", "deg"),
    Panel("error-yaw", ATTITUDE, "Attitude error: yaw", "deg"),
    Panel("roll", ATTITUDE, "Roll", "deg"),
    Panel("pitch", ATTITUDE, "Pitch", "deg"),
    Panel("yaw", ATTITUDE, "Yaw", "deg"),
    Panel("tilt", ATTITUDE, "Tilt", "deg"),
    Panel("altitude", POSITION, "Altitude above mean sea level", "m"),
    Panel("height", POSITION, "Height above home", "m"),
    Panel("speed", POSITION, "Ground speed and airspeed", "m/s"),
    Panel("climb", POSITION, "Climb rate", "m/s"),
    Panel("range", POSITION, "Distance to the ground", "m"),
    Panel("wind", POSITION, "Wind", "m/s"),
    Panel("position-error", POSITION, "Horizontal distance to the truth", "m"),
    Panel("control-error", ACTUATORS, "Attitude: actual minus desired", "deg"),
    Panel("rate-roll", ACTUATORS, "Roll rate", "deg/s"),
    Panel("rate-pitch", ACTUATORS, "Pitch rate", "deg/s"),
    Panel("rate-yaw", ACTUATORS, "Yaw rate", "deg/s"),
    Panel("velocity-north", ACTUATORS, "Velocity north", "m/s"),
    Panel("velocity-east", ACTUATORS, "Velocity east", "m/s"),
    Panel("velocity-down", ACTUATORS, "Velocity down", "m/s"),
    Panel("position-north", ACTUATORS, "Position north", "m"),
    Panel("position-east", ACTUATORS, "Position east", "m"),
    Panel("position-down", ACTUATORS, "Position down", "m"),
    Panel("throttle", ACTUATORS, "Throttle", "%"),
    Panel("torque", ACTUATORS, "Torque setpoint", ""),
    Panel("unallocated", ACTUATORS, "Unallocated torque", ""),
    Panel("actuators", ACTUATORS, "Motors", ""),
    Panel("balance", ACTUATORS, "Motors: deviation from their mean, 1 s average", ""),
    Panel("imbalance", ACTUATORS, "Propeller imbalance", ""),
    Panel("rpm", ACTUATORS, "Motor speed", "rev/min"),
    Panel("servos", ACTUATORS, "Servos", ""),
    Panel("outputs", ACTUATORS, "Outputs", "µs"),
    Panel("sticks", ACTUATORS, "Sticks", ""),
    Panel("rc", ACTUATORS, "RC channels", "µs"),
    Panel("ratio", ESTIMATOR, "Innovation test ratios (above 1: rejected)", ""),
    Panel("variance", ESTIMATOR, "EKF variances", ""),
    Panel("innovation-position", ESTIMATOR, "Innovations: position, with gates", "m"),
    Panel("innovation-velocity", ESTIMATOR, "Innovations: velocity, with gates", "m/s"),
    Panel("innovation-height", ESTIMATOR, "Innovations: height, with gates", "m"),
    Panel("innovation-heading", ESTIMATOR, "Innovations: heading, with gates", "deg"),
    Panel("innovation-mag", ESTIMATOR, "Innovations: magnetometer", ""),
    Panel("innovation-airspeed", ESTIMATOR, "Innovations: airspeed", "m/s"),
    Panel("divergence", ESTIMATOR, "Attitude of estimator instances, angle to the first", "deg"),
    Panel("instance-roll", ESTIMATOR, "Roll of each estimator instance", "deg", least=2),
    Panel("instance-pitch", ESTIMATOR, "Pitch of each estimator instance", "deg", least=2),
    Panel("instance-yaw", ESTIMATOR, "Yaw of each estimator instance", "deg", least=2),
    Panel("instance-down", ESTIMATOR, "Position down of each estimator instance", "m", least=2),
    Panel("gyro-bias", ESTIMATOR, "Estimated gyroscope bias", ""),
    Panel("accel-bias", ESTIMATOR, "Estimated accelerometer bias", "m/s²"),
    Panel("estimate-jump", ESTIMATOR, "Position step of the estimate beyond its speed", "m"),
    Panel("accuracy", ESTIMATOR, "Accuracy reported by the estimator", "m"),
    Panel("gps-satellites", GPS, "Satellites used", ""),
    Panel("gps-dilution", GPS, "Dilution of precision as reported (eph, epv / 100)", ""),
    Panel("gps-accuracy", GPS, "Accuracy reported by the receiver", "m"),
    Panel("gps-fix", GPS, "Fix type (3: 3D)", ""),
    Panel("gps-jump", GPS, "Position step between fixes beyond the speed", "m"),
    Panel("gps-cn0", GPS, "Carrier-to-noise density (C/N0)", "dB-Hz"),
    Panel("gps-gain", GPS, "Automatic gain control", ""),
    Panel("gps-noise", GPS, "Jamming and noise indicators", ""),
    Panel("accel", SENSORS, "Accelerometers", "m/s²"),
    Panel("gyro", SENSORS, "Gyroscopes", "rad/s"),
    # One IMU has three axes; comparing needs at least four curves.
    Panel("accel-instances", SENSORS, "Accelerometers of every IMU", "m/s²", least=4),
    Panel("gyro-instances", SENSORS, "Gyroscopes of every IMU", "rad/s", least=4),
    Panel("accel-disagreement", SENSORS, "Accelerometers, deviation from their mean", "m/s²"),
    Panel("gyro-disagreement", SENSORS, "Gyroscopes, deviation from their mean", "rad/s"),
    Panel("mag", SENSORS, "Magnetic field strength", "gauss"),
    Panel("baro", SENSORS, "Pressure", "hPa"),
    Panel("temperature", SENSORS, "Temperature", "°C"),
    Panel("vibration", SENSORS, "Vibration", "m/s²"),
    Panel("clipping", SENSORS, "Accelerometer clipping (count)", ""),
    Panel("battery-voltage", POWER, "Battery voltage", "V"),
    Panel("battery-cells", POWER, "Voltage of each cell", "V"),
    Panel("battery-current", POWER, "Battery current", "A"),
    Panel("battery-remaining", POWER, "Battery remaining", "%"),
    Panel("board-voltage", POWER, "Board voltage", "V"),
    Panel("load", SYSTEM, "Processor and memory load", "%"),
    Panel("memory", SYSTEM, "Free memory", "KiB"),
    Panel("scheduler", SYSTEM, "Overlong loops", "%"),
    Panel("loop-time", SYSTEM, "Longest loop", "ms"),
    Panel("interval", SYSTEM, "Interval between logged gyroscope samples", "ms"),
    Panel("link-lost", LINK, "Frames lost, by sequence numbers", "%"),
    Panel("link-drop", LINK, "Packets dropped, counted by the autopilot", "%"),
    Panel("radio", LINK, "Radio signal strength and noise", ""),
)
BY_KEY = {panel.key: panel for panel in PANELS}
