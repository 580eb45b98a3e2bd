"""An ArduPilot dataflash log (.bin) to a `Recording`, read by pymavlink.

Messages and fields as ArduPilot's log reference names them; times from `TimeUS`.
"""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from analysis.report.modes import ARDUPILOT, mode_name
from analysis.report.recording import Event, Recording, Signal, Span, Track
from mavproxy_fault.errors import ConfigError

MAGIC = b"\xa3\x95"
ARMED, DISARMED = 10, 11  # EV.Id

# message, field, panel, name, scale
CURVES: tuple[tuple[str, str, str, str, float], ...] = (
    ("ATT", "Roll", "roll", "ATTITUDE", 1.0),
    ("ATT", "DesRoll", "roll", "desired", 1.0),
    ("ATT", "Pitch", "pitch", "ATTITUDE", 1.0),
    ("ATT", "DesPitch", "pitch", "desired", 1.0),
    ("ATT", "Yaw", "yaw", "ATTITUDE", 1.0),
    ("GPS", "Alt", "altitude", "GPS", 1.0),
    ("GPS", "Spd", "speed", "GPS", 1.0),
    ("GPS", "NSats", "gps-satellites", "GPS", 1.0),
    ("GPS", "Status", "gps-fix", "GPS", 1.0),
    ("GPS", "HDop", "gps-dilution", "hdop", 1.0),
    ("POS", "Alt", "altitude", "estimate", 1.0),
    ("POS", "RelHomeAlt", "height", "estimate", 1.0),
    ("VIBE", "VibeX", "vibration", "x", 1.0),
    ("VIBE", "VibeY", "vibration", "y", 1.0),
    ("VIBE", "VibeZ", "vibration", "z", 1.0),
    ("VIBE", "Clip", "clipping", "accelerometer", 1.0),
    ("VIBE", "Clip0", "clipping", "accelerometer 1", 1.0),
    ("IMU", "AccX", "accel", "x", 1.0),
    ("IMU", "AccY", "accel", "y", 1.0),
    ("IMU", "AccZ", "accel", "z", 1.0),
    ("IMU", "GyrX", "gyro", "x", 1.0),
    ("IMU", "GyrY", "gyro", "y", 1.0),
    ("IMU", "GyrZ", "gyro", "z", 1.0),
    ("BARO", "Press", "baro", "barometer", 0.01),
    ("BAT", "Volt", "battery-voltage", "battery", 1.0),
    ("BAT", "Curr", "battery-current", "battery", 1.0),
    ("BAT", "RemPct", "battery-remaining", "battery", 1.0),
    ("POWR", "Vcc", "board-voltage", "Vcc", 1.0),
    ("XKF4", "SV", "variance", "velocity", 1.0),
    ("XKF4", "SP", "variance", "horizontal position", 1.0),
    ("XKF4", "SH", "variance", "vertical position", 1.0),
    ("XKF4", "SM", "variance", "compass", 1.0),
    ("NKF4", "SV", "variance", "velocity", 1.0),
    ("NKF4", "SP", "variance", "horizontal position", 1.0),
    ("XKF3", "IVN", "innovation", "velocity north, m/s", 1.0),
    ("XKF3", "IPN", "innovation", "position north, m", 1.0),
    ("CTUN", "ThO", "throttle", "throttle", 100.0),
)
WANTED = {row[0] for row in CURVES} | {"MAG", "MODE", "MSG", "EV", "PARM", "ERR"}


def is_dataflash(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a dataflash log."""
    return head.startswith(MAGIC)


def recording_of_dataflash(path: Path, name: str, t0_us: int | None = None) -> Recording:
    """Everything of a dataflash log that a report shows.

    Raises
    ------
    ConfigError
        If nothing in the file can be read.
    """
    rows = _rows(path)
    stamped = [row["TimeUS"] for some in rows.values() for row in some if "TimeUS" in row]
    if not stamped:
        raise ConfigError(f"{path}: the dataflash log holds no message a report can show")
    start_us = min(stamped) if t0_us is None else t0_us
    return _recording(name, rows, start_us, (max(stamped) - start_us) * 1e-6)


def _rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Every message wanted, by kind."""
    from pymavlink.DFReader import DFReader_binary

    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    reader = DFReader_binary.__new__(DFReader_binary)  # apart, to close its file if it fails
    try:
        reader.__init__(str(path), zero_time_base=True)
        while (message := reader.recv_match(type=WANTED)) is not None:
            rows[message.get_type()].append(message.to_dict())
    except Exception as error:  # pymavlink raises whatever its struct and index code does
        if not rows:
            raise ConfigError(f"{path}: not a readable dataflash log ({error})") from error
    finally:
        reader.filehandle.close()
    return rows


def _recording(
    name: str, rows: dict[str, list[dict[str, Any]]], start_us: int, duration_s: float
) -> Recording:
    found = Recording(name, "ardupilot", start_us, duration_s)
    for kind, field, panel, label, scale in CURVES:
        some = [row for row in rows.get(kind, ()) if row.get("I", row.get("C", 0)) == 0]
        if some and field in some[0]:
            t_s = np.array([(row["TimeUS"] - start_us) * 1e-6 for row in some])
            value = np.array([float(row[field]) * scale for row in some])
            found.signals.append(Signal(panel, label, t_s, value))
    _add_compass(found, rows.get("MAG", []), start_us)
    for kind, label in (("GPS", "GPS"), ("POS", "estimate")):
        some = [r for r in rows.get(kind, ()) if r["Lat"] != 0 and r.get("I", 0) == 0]
        if len(some) > 1:
            t_s = np.array([(row["TimeUS"] - start_us) * 1e-6 for row in some])
            columns = [np.array([float(row[key]) for row in some]) for key in ("Lat", "Lng", "Alt")]
            found.tracks.append(Track(label, t_s, *columns))
    _add_events(found, rows, start_us)
    return found


def _add_compass(found: Recording, rows: list[dict[str, Any]], start_us: int) -> None:
    for instance in sorted({row.get("I", 0) for row in rows}):
        some = [row for row in rows if row.get("I", 0) == instance]
        t_s = np.array([(row["TimeUS"] - start_us) * 1e-6 for row in some])
        field = np.array([[row["MagX"], row["MagY"], row["MagZ"]] for row in some], float)
        strength = np.linalg.norm(field, axis=1) * 1e-3
        found.signals.append(Signal("mag", f"compass {instance + 1}", t_s, strength))


def _add_events(found: Recording, rows: dict[str, list[dict[str, Any]]], start_us: int) -> None:
    def seconds(row: dict[str, Any]) -> float:
        return float(row["TimeUS"] - start_us) * 1e-6

    vehicle = 1 if any("ArduPlane" in str(row["Message"]) for row in rows.get("MSG", ())) else 2
    modes = rows.get("MODE", [])
    for row, after in zip(modes, [*modes[1:], None], strict=True):
        text = mode_name(ARDUPILOT, vehicle, int(row.get("ModeNum", 0)))
        end = found.duration_s if after is None else seconds(after)
        found.spans.append(Span("mode", seconds(row), end, text, "mode"))
        found.events.append(Event(seconds(row), "mode", f"mode {text}"))
    armed_s: float | None = None
    for row in rows.get("EV", []):
        if row["Id"] == ARMED:
            armed_s = seconds(row)
        if row["Id"] == DISARMED and armed_s is not None:
            found.spans.append(Span("armed", armed_s, seconds(row), "armed", "mode"))
            armed_s = None
    if armed_s is not None:
        found.spans.append(Span("armed", armed_s, found.duration_s, "armed", "mode"))
    for row in rows.get("MSG", []):
        found.events.append(Event(seconds(row), "text", str(row["Message"])))
    for row in rows.get("ERR", []):
        text = f"error of subsystem {row['Subsys']}, code {row['ECode']}"
        found.events.append(Event(seconds(row), "error", text, 3))
    for row in rows.get("PARM", []):
        history = found.parameters.setdefault(str(row["Name"]), [])
        if not history or history[-1][1] != float(row["Value"]):
            history.append((seconds(row), float(row["Value"])))
    found.events.sort(key=lambda event: event.t_s)
