"""The plots of a report, in their order: which section, what title, which unit, which limits."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Panel:
    """One plot over time; `key` is what signals name it by, `log` asks for a logarithmic axis."""

    key: str
    section: str
    title: str
    unit: str
    log: bool = False


TIMELINE = "Timeline"
CHECKS = "Checks"
DETECTION = "Fault detection"
FUSION = "Fused solution"
ATTITUDE = "Attitude"
POSITION = "Position and speed"
ESTIMATOR = "The autopilot's estimator"
GPS = "GPS"
SENSORS = "Sensors"
POWER = "Battery and power"
LINK = "Link quality"
ACTUATORS = "Control"

PANELS = (
    Panel("fdi-statistic", DETECTION, "Chi-square statistic of the GNSS residuals", "", True),
    Panel("fdi-residual", DETECTION, "Residuals per satellite", "m"),
    Panel("fdi-normalised", DETECTION, "Residuals per satellite over their sigma", ""),
    Panel("fdi-sensor", DETECTION, "Sensor statistics over their thresholds", "", True),
    Panel("fdi-probability", DETECTION, "Probability of each hypothesis", ""),
    Panel("fused-north", FUSION, "Position error north with three sigmas of the fused", "m"),
    Panel("fused-east", FUSION, "Position error east with three sigmas of the fused", "m"),
    Panel("fused-down", FUSION, "Position error down with three sigmas of the fused", "m"),
    Panel("fused-sigma", FUSION, "Position sigma", "m"),
    Panel("fused-weight", FUSION, "Weights of the sources in use", ""),
    Panel("error-angle", ATTITUDE, "Attitude error: total angle", "deg"),
    Panel("error-roll", ATTITUDE, "Attitude error: roll", "deg"),
    Panel("error-pitch", ATTITUDE, "Attitude error: pitch", "deg"),
    Panel("error-yaw", ATTITUDE, "Attitude error: yaw", "deg"),
    Panel("roll", ATTITUDE, "Roll", "deg"),
    Panel("pitch", ATTITUDE, "Pitch", "deg"),
    Panel("yaw", ATTITUDE, "Yaw", "deg"),
    Panel("altitude", POSITION, "Altitude above mean sea level", "m"),
    Panel("height", POSITION, "Height above home", "m"),
    Panel("speed", POSITION, "Ground speed and airspeed", "m/s"),
    Panel("climb", POSITION, "Climb rate", "m/s"),
    Panel("position-error", POSITION, "Horizontal distance to the truth", "m"),
    Panel("ratio", ESTIMATOR, "Innovation test ratios (above 1: refused)", ""),
    Panel("variance", ESTIMATOR, "EKF variances", ""),
    Panel("innovation", ESTIMATOR, "Innovations", ""),
    Panel("estimate-jump", ESTIMATOR, "Step of the estimate beyond what the speed explains", "m"),
    Panel("accuracy", ESTIMATOR, "Accuracy as the estimator sees it", "m"),
    Panel("gps-satellites", GPS, "Satellites used", ""),
    Panel("gps-dilution", GPS, "Dilution of precision as reported (eph, epv / 100)", ""),
    Panel("gps-accuracy", GPS, "Accuracy as the receiver sees it", "m"),
    Panel("gps-fix", GPS, "Type of fix (3 = three-dimensional)", ""),
    Panel("gps-jump", GPS, "Step between fixes beyond what the velocity explains", "m"),
    Panel("gps-noise", GPS, "Jamming and noise indicators", ""),
    Panel("accel", SENSORS, "Accelerometers", "m/s²"),
    Panel("gyro", SENSORS, "Gyroscopes", "rad/s"),
    Panel("mag", SENSORS, "Magnetic field strength", "gauss"),
    Panel("baro", SENSORS, "Pressure", "hPa"),
    Panel("temperature", SENSORS, "Temperature", "°C"),
    Panel("vibration", SENSORS, "Vibration", "m/s²"),
    Panel("clipping", SENSORS, "Accelerometer clipping (count)", ""),
    Panel("battery-voltage", POWER, "Battery voltage", "V"),
    Panel("battery-current", POWER, "Battery current", "A"),
    Panel("battery-remaining", POWER, "Battery remaining", "%"),
    Panel("board-voltage", POWER, "Board voltage", "V"),
    Panel("load", POWER, "Processor load", "%"),
    Panel("link-lost", LINK, "Frames lost, by sequence numbers", "%"),
    Panel("radio", LINK, "Radio signal strength and noise", ""),
    Panel("control-error", ACTUATORS, "Attitude: actual minus desired", "deg"),
    Panel("throttle", ACTUATORS, "Throttle", "%"),
    Panel("actuators", ACTUATORS, "Actuator outputs", ""),
)
BY_KEY = {panel.key: panel for panel in PANELS}
