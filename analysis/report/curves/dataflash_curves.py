"""Table of curves: which field of which dataflash message gives which curve.

Fields are named as in ArduPilot's log reference, those of old logs as in its old versions.
"""

import numpy as np

from analysis.report.curves.field_values import (
    Columns,
    LogCurve,
    Reader,
    Values,
    accuracy_field,
    column,
    field,
    heading_field,
    norm,
    used_field,
)

HIGH_V = 200.0  # above any battery: the log is old and gives hundredths
CHANNELS, CELLS = 8, 12  # shown at most


def _throttle(topic: Columns) -> Values:
    """Throttle in percent; a fraction in new logs, thousandths in old ones."""
    if "ThO" in topic:
        return column(topic, "ThO") * 100
    return column(topic, "ThrOut") * 0.1


def _hundredths(name: str) -> Reader:
    """Volts or amperes; old logs give hundredths."""

    def values(topic: Columns) -> Values:
        # The median voltage shows the units of both voltage and current.
        old = np.nanmedian(column(topic, "Volt")) > HIGH_V
        return column(topic, name) * (0.01 if old else 1.0)

    return values


def _millivolts(topic: Columns) -> Values:
    """Board voltage in V; this message gives millivolts."""
    return column(topic, "Vcc") * 1e-3


def _long_loops(topic: Columns) -> Values:
    """Percentage of overlong loops."""
    return 100.0 * column(topic, "NLon") / np.maximum(column(topic, "NLoop"), 1.0)


def _estimator(status: str, innovations: str, state: str, core: str) -> tuple[LogCurve, ...]:
    """Curves of one estimator core: states, test ratios, innovations; `core` is their suffix.

    EKF3 messages carry the core number instead, and all cores share one message name.
    """
    ratios = (
        ("SV", "velocity"), ("SP", "horizontal position"), ("SH", "vertical position"),
        ("SM", "compass"),
    )  # fmt: skip
    parts = (
        ("innovation-velocity", "IVN", "north"), ("innovation-velocity", "IVE", "east"),
        ("innovation-velocity", "IVD", "down"), ("innovation-position", "IPN", "north"),
        ("innovation-position", "IPE", "east"), ("innovation-height", "IPD", "height"),
        ("innovation-heading", "IYAW", "heading"), ("innovation-mag", "IMX", "x"),
        ("innovation-mag", "IMY", "y"), ("innovation-mag", "IMZ", "z"),
        ("innovation-airspeed", "IVT", "airspeed"),
    )  # fmt: skip
    states = (
        ("instance-roll", "Roll", field), ("instance-pitch", "Pitch", field),
        ("instance-yaw", "Yaw", heading_field), ("instance-down", "PD", field),
    )  # fmt: skip
    return (
        *(LogCurve(status, "variance", label + core, field(name)) for name, label in ratios),
        *(LogCurve(innovations, panel, axis + core, field(name)) for panel, name, axis in parts),
        *(
            LogCurve(state, panel, f"core{core}", reader(name, 1.0))
            for panel, name, reader in states
        ),
        # The last letter of a field is its axis.
        *(LogCurve(state, "gyro-bias", f"{axis[-1].lower()}{core}", field(axis, 1.0)) for axis in
          ("GX", "GY", "GZ")),
    )  # fmt: skip


def _controller(message: str, axis: str, letter: str, up: float) -> tuple[LogCurve, ...]:
    """Estimated and desired position and velocity of PSCN, PSCE, PSCD."""
    return tuple(
        LogCurve(message, f"{kind}-{axis}", name, field(f"{prefix}{quantity}{letter}", up))
        for kind, quantity in (("position", "P"), ("velocity", "V"))
        for name, prefix in (("estimate", ""), ("desired", "T"))
    )


# Curve names match those of other log formats: the page colours and pairs curves by name.
CURVES: tuple[LogCurve, ...] = (
    LogCurve("ATT", "roll", "ATTITUDE", field("Roll"), False),
    # ArduPilot's simulator logs its truth.
    *(LogCurve("SIM", part, "truth", field(part.title()), False) for part in ("roll", "pitch")),
    LogCurve("SIM", "yaw", "truth", heading_field("Yaw", 1.0), False),
    LogCurve("SIM", "altitude", "truth", field("Alt"), False),
    LogCurve("SIM2", "climb", "truth", field("VD", -1.0), False),
    LogCurve("ATT", "roll", "desired", field("DesRoll"), False),
    LogCurve("ATT", "pitch", "ATTITUDE", field("Pitch"), False),
    LogCurve("ATT", "pitch", "desired", field("DesPitch"), False),
    LogCurve("ATT", "yaw", "ATTITUDE", heading_field("Yaw", 1.0), False),
    LogCurve("ATT", "yaw", "desired", heading_field("DesYaw", 1.0), False),
    *(
        LogCurve("RATE", f"rate-{axis}", name, field(f"{axis[0].upper()}{suffix}"), False)
        for axis in ("roll", "pitch", "yaw")
        for name, suffix in (("actual", ""), ("desired", "Des"))
    ),
    *_controller("PSCN", "north", "N", 1.0),
    *_controller("PSCE", "east", "E", 1.0),
    *_controller("PSCD", "down", "D", 1.0),
    LogCurve("GPS", "altitude", "GPS", field("Alt")),
    LogCurve("POS", "altitude", "estimate", field("Alt"), False),
    LogCurve("POS", "height", "estimate", field("RelHomeAlt"), False),
    LogCurve("CTUN", "height", "desired", field("DAlt"), False),
    LogCurve("CTUN", "height", "controller", field("Alt"), False),
    LogCurve("CTUN", "height", "barometer", field("BAlt"), False),
    LogCurve("GPS", "speed", "GPS", field("Spd")),
    LogCurve("ARSP", "speed", "air", field("Airspeed"), False),
    # CTUN gives climb rates in centimetres per second.
    LogCurve("CTUN", "climb", "CTUN", field("CRt", 0.01), False),
    LogCurve("CTUN", "climb", "desired", field("DCRt", 0.01), False),
    LogCurve("GPS", "gps-satellites", "GPS", field("NSats")),
    LogCurve("GPS", "gps-fix", "GPS", field("Status")),
    LogCurve("GPS", "gps-dilution", "hdop", field("HDop")),
    LogCurve("GPA", "gps-dilution", "vdop", field("VDop")),
    LogCurve("GPA", "gps-accuracy", "horizontal", accuracy_field("HAcc")),
    LogCurve("GPA", "gps-accuracy", "vertical", accuracy_field("VAcc")),
    LogCurve("GPA", "gps-accuracy", "speed, m/s", field("SAcc")),
    LogCurve("UBX1", "gps-noise", "jamming indicator", field("jamInd"), False),
    LogCurve("UBX1", "gps-noise", "noise per ms", field("noisePerMS"), False),
    LogCurve("UBX1", "gps-gain", "automatic gain control", field("agcCnt"), False),
    *(LogCurve("VIBE", "vibration", axis, field(f"Vibe{axis.upper()}")) for axis in "xyz"),
    LogCurve("VIBE", "clipping", "accelerometer", field("Clip")),
    *(
        LogCurve("VIBE", "clipping", f"accelerometer {i + 1}", field(f"Clip{i}"), False)
        for i in range(3)
    ),
    *(
        LogCurve("IMU", kind, axis, field(f"{word}{axis.upper()}"), "-" in kind)
        for kind, word in (
            ("accel", "Acc"),
            ("gyro", "Gyr"),
            ("accel-instances", "Acc"),
            ("gyro-instances", "Gyr"),
        )
        for axis in "xyz"
    ),
    # Milligauss to gauss.
    LogCurve("MAG", "mag", "compass", norm("MagX", "MagY", "MagZ", scale=1e-3)),
    # Pascal to hectopascal.
    LogCurve("BARO", "baro", "barometer", field("Press", 0.01)),
    LogCurve("BARO", "temperature", "barometer", field("Temp")),
    LogCurve("IMU", "temperature", "IMU", field("T")),
    LogCurve("BAT", "battery-voltage", "battery", field("Volt")),
    LogCurve("BAT", "battery-current", "battery", field("Curr")),
    LogCurve("BAT", "battery-remaining", "battery", field("RemPct")),
    LogCurve("CURR", "battery-voltage", "battery", _hundredths("Volt")),
    LogCurve("CURR", "battery-current", "battery", _hundredths("Curr")),
    LogCurve("CURR", "board-voltage", "Vcc", _millivolts, False),
    *(
        LogCurve("BCL", "battery-cells", f"cell {i}", used_field(f"V{i}", 1e-3))
        for i in range(1, CELLS + 1)
    ),
    LogCurve("POWR", "board-voltage", "Vcc", field("Vcc"), False),
    LogCurve("POWR", "board-voltage", "servo rail", used_field("VServo"), False),
    LogCurve("POWR", "temperature", "processor", used_field("MTemp"), False),
    # PM gives the load in tenths of a percent, the longest loop in microseconds.
    LogCurve("PM", "load", "processor", field("Load", 0.1), False),
    LogCurve("PM", "scheduler", "long loops", _long_loops, False),
    LogCurve("PM", "loop-time", "longest loop", field("MaxT", 1e-3), False),
    LogCurve("PM", "memory", "free", field("Mem", 1 / 1024), False),
    LogCurve("RAD", "radio", "signal", field("RSSI"), False),
    LogCurve("RAD", "radio", "remote signal", field("RemRSSI"), False),
    LogCurve("RAD", "radio", "noise", field("Noise"), False),
    LogCurve("RAD", "radio", "remote noise", field("RemNoise"), False),
    LogCurve("CTUN", "throttle", "throttle", _throttle, False),
    *(
        LogCurve("RCOU", "outputs", f"output {i}", used_field(f"C{i}"), False)
        # A channel that is never driven has no curve.
        for i in range(1, CHANNELS + 1)
    ),
    *(
        LogCurve("RCIN", "rc", f"channel {i}", used_field(f"C{i}"), False)
        for i in range(1, CHANNELS + 1)
    ),
    LogCurve("ESC", "rpm", "motor", used_field("RPM")),
    LogCurve("RFND", "range", "distance sensor", field("Dist")),
    *_estimator("XKF4", "XKF3", "XKF1", ""),
    *_estimator("NKF4", "NKF3", "NKF1", ""),
    *_estimator("NKF9", "NKF8", "NKF6", " 2"),
    *_estimator("EKF4", "EKF3", "EKF1", ""),
)
