"""Which field of which dataflash message is which curve: one table."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.dataflash import Topic

Values = NDArray[np.float64]
Curve = tuple[str, str, str, Callable[[Topic], Values | None], bool]
HIGH_V = 200.0  # more than any battery has: the log is old and gives hundredths


def _field(name: str, scale: float = 1.0) -> Callable[[Topic], Values | None]:
    return lambda topic: topic[name].astype(float) * scale if name in topic else None


def _heading(name: str) -> Callable[[Topic], Values | None]:
    """A heading in degrees, wrapped to (-180, 180]."""
    return lambda topic: 180 - (180 - topic[name].astype(float)) % 360 if name in topic else None


def _throttle(topic: Topic) -> Values | None:
    """Percent; a share in new logs, thousandths in old ones."""
    if "ThO" in topic:
        return topic["ThO"].astype(float) * 100
    return topic["ThrOut"].astype(float) * 0.1 if "ThrOut" in topic else None


def _hundredths(name: str) -> Callable[[Topic], Values | None]:
    """Volts or amperes, which old logs give in hundredths."""

    def values(topic: Topic) -> Values | None:
        if name not in topic:
            return None
        found = topic[name].astype(float)
        return found * 0.01 if np.nanmedian(topic["Volt"].astype(float)) > HIGH_V else found

    return values


def _millivolts(topic: Topic) -> Values | None:
    return topic["Vcc"].astype(float) * 1e-3 if "Vcc" in topic else None


def _strength(topic: Topic) -> Values | None:
    """Magnetic field strength, gauss, of components in milligauss."""
    if "MagX" not in topic:
        return None
    parts = [topic[name].astype(float) for name in ("MagX", "MagY", "MagZ")]
    return np.asarray(np.linalg.norm(parts, axis=0) * 1e-3)


def _estimator(letter: str) -> tuple[Curve, ...]:
    """Status and innovations of one generation of the estimator (EKF1 to EKF3), its first core."""
    variances = (
        ("SV", "velocity"), ("SP", "horizontal position"), ("SH", "vertical position"),
        ("SM", "compass"),
    )  # fmt: skip
    innovations = (
        ("IVN", "velocity north, m/s"), ("IVE", "velocity east, m/s"),
        ("IVD", "velocity down, m/s"), ("IPN", "position north, m"),
        ("IPE", "position east, m"), ("IPD", "position down, m"), ("IYAW", "heading, deg"),
    )  # fmt: skip
    return (
        *((f"{letter}4", "variance", label, _field(name), False) for name, label in variances),
        *((f"{letter}3", "innovation", label, _field(name), False) for name, label in innovations),
    )


# message, panel, name, values, whether of every instance
CURVES: tuple[Curve, ...] = (
    ("ATT", "roll", "ATTITUDE", _field("Roll"), False),
    ("ATT", "roll", "desired", _field("DesRoll"), False),
    ("ATT", "pitch", "ATTITUDE", _field("Pitch"), False),
    ("ATT", "pitch", "desired", _field("DesPitch"), False),
    ("ATT", "yaw", "ATTITUDE", _heading("Yaw"), False),
    ("ATT", "yaw", "desired", _heading("DesYaw"), False),
    ("GPS", "altitude", "GPS", _field("Alt"), True),
    ("POS", "altitude", "estimate", _field("Alt"), False),
    ("POS", "height", "estimate", _field("RelHomeAlt"), False),
    ("GPS", "speed", "GPS", _field("Spd"), True),
    ("ARSP", "speed", "air", _field("Airspeed"), False),
    ("CTUN", "climb", "CTUN", _field("CRt", 0.01), False),
    ("GPS", "gps-satellites", "GPS", _field("NSats"), True),
    ("GPS", "gps-fix", "GPS", _field("Status"), True),
    ("GPS", "gps-dilution", "hdop", _field("HDop"), True),
    ("GPA", "gps-dilution", "vdop", _field("VDop"), True),
    ("GPA", "gps-accuracy", "horizontal", _field("HAcc"), True),
    ("GPA", "gps-accuracy", "vertical", _field("VAcc"), True),
    ("UBX1", "gps-noise", "jamming indicator", _field("jamInd"), False),
    ("UBX1", "gps-noise", "noise per ms", _field("noisePerMS"), False),
    ("VIBE", "vibration", "x", _field("VibeX"), True),
    ("VIBE", "vibration", "y", _field("VibeY"), True),
    ("VIBE", "vibration", "z", _field("VibeZ"), True),
    ("VIBE", "clipping", "accelerometer", _field("Clip"), True),
    ("VIBE", "clipping", "accelerometer 1", _field("Clip0"), False),
    ("VIBE", "clipping", "accelerometer 2", _field("Clip1"), False),
    ("VIBE", "clipping", "accelerometer 3", _field("Clip2"), False),
    ("IMU", "accel", "x", _field("AccX"), False),
    ("IMU", "accel", "y", _field("AccY"), False),
    ("IMU", "accel", "z", _field("AccZ"), False),
    ("IMU", "gyro", "x", _field("GyrX"), False),
    ("IMU", "gyro", "y", _field("GyrY"), False),
    ("IMU", "gyro", "z", _field("GyrZ"), False),
    ("MAG", "mag", "compass", _strength, True),
    ("BARO", "baro", "barometer", _field("Press", 0.01), True),
    ("BARO", "temperature", "barometer", _field("Temp"), True),
    ("BAT", "battery-voltage", "battery", _field("Volt"), True),
    ("BAT", "battery-current", "battery", _field("Curr"), True),
    ("BAT", "battery-remaining", "battery", _field("RemPct"), True),
    ("CURR", "battery-voltage", "battery", _hundredths("Volt"), True),
    ("CURR", "battery-current", "battery", _hundredths("Curr"), True),
    ("CURR", "board-voltage", "Vcc", _millivolts, False),
    ("POWR", "board-voltage", "Vcc", _field("Vcc"), False),
    ("PM", "load", "processor", _field("Load", 0.1), False),
    ("RAD", "radio", "signal", _field("RSSI"), False),
    ("RAD", "radio", "remote signal", _field("RemRSSI"), False),
    ("RAD", "radio", "noise", _field("Noise"), False),
    ("RAD", "radio", "remote noise", _field("RemNoise"), False),
    ("CTUN", "throttle", "throttle", _throttle, False),
    *(("RCOU", "actuators", f"output {i}, µs", _field(f"C{i}"), False) for i in range(1, 9)),
    *_estimator("XKF"),
    *_estimator("NKF"),
    *_estimator("EKF"),
)
