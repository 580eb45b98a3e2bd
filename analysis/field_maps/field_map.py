"""The form of a field map: a text with one line per quantity below the name of its message.

    VIBRATION
        vibration  {x,y,z}  vibration_{x,y,z}

A line has three columns, two spaces apart: a target, a name and an expression over the fields of
the message. Several words in braces stand for one line each. The target is a panel of the report
(`panels`) with the name of a curve; `track` (latitude and longitude in degrees, altitude in m); a
kind of flag (`FLAGS`) with its text; a lane of the timeline (`STATES`), whose values
are words; or, in capitals, a kind of sample (`analysis.samples.block`)
with a condition on its rows (`all`) and the sample's numbers. `#1` behind it is a redundant sensor.
A message with `first` behind its name gives the quantities of its first instance only.

An expression sees fields by their names, array fields with the element as the first axis (`C_` is
`C1`, `C2`, ...). A line whose fields are missing in a version of the autopilot gives nothing.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from types import CodeType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.autopilot_names import NAMES
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation import (
    euler_from_quat,
    matrix_from_quat,
    quat_from_euler,
    wrap_degrees,
)

Columns = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]

TRACK, ALL, STATE = "track", "all", "state"
STATES = {STATE: "mode", "state-flag": "flag", "state-warn": "warn"}  # kinds of their spans
FLAGS = ("flag", "warn", "rejected", "failsafe")
UNUSED = 65535  # of a 16-bit field in MAVLink and ArduPilot
UNKNOWN_M = 1e6  # u-blox reports an unknown accuracy as 2^32 mm
HIGH_V = 200.0  # above any battery: the log is old and gives hundredths
MOST_HECTOPASCAL = 2000.0  # twice sea level; in pascal every pressure is above
BRACES = re.compile(r"\{([^}]*)\}")
NOTHING: Mapping[str, float] = {}
# Standard deviations at which PX4 rejects a measurement, by its defaults.
GATES = {
    "EKF2_GPS_P_GATE": 5.0, "EKF2_GPS_V_GATE": 5.0, "EKF2_BARO_GATE": 5.0, "EKF2_HDG_GATE": 2.6,
    "EKF2_MAG_GATE": 3.0, "EKF2_TAS_GATE": 3.0,
}  # fmt: skip


class MapLine(NamedTuple):
    """One line: a quantity of a message, of its `first` instance only or of all."""

    message: str
    first: bool
    target: str
    name: str
    value: CodeType

    @property
    def is_curve(self) -> bool:
        """Whether the line gives a curve of the report."""
        others = (TRACK, *FLAGS, *STATES)
        return self.target not in others and not self.target[0].isupper()


FieldMap = Mapping[str, tuple[MapLine, ...]]


def read_map(text: str) -> FieldMap:
    """The lines of a table by message."""
    found: dict[str, list[MapLine]] = {}
    header = ""
    for row in text.replace("\\\n", " ").splitlines():
        if row.startswith("#"):
            continue
        if not row[0].isspace():
            header = row
            continue
        for line in _expanded(f"{header}  {row.strip()}"):
            message, target, name, value = re.split(" {2,}", line, maxsplit=3)
            message, _, first = message.partition(" ")
            code = compile(value.strip(), f"{message} {target} {name}", "eval")
            lines = found.setdefault(message, [])
            lines.append(MapLine(message, first == "first", target, name, code))
    return {name: tuple(lines) for name, lines in found.items()}


def _expanded(line: str) -> Iterator[str]:
    """The lines that the words in braces stand for."""
    groups = [_words(group) for group in BRACES.findall(line)]
    for i in range(max((len(group) for group in groups), default=1)):
        words = iter(groups)
        yield BRACES.sub(lambda _, i=i, words=words: next(words)[i], line)  # type: ignore[misc]


def _words(group: str) -> list[str]:
    begin, dots, end = group.partition("..")
    return [str(i) for i in range(int(begin), int(end) + 1)] if dots else group.split(",")


def values_of(
    line: MapLine, columns: Columns, constants: Mapping[str, float] = NOTHING
) -> Values | None:
    """The values (n,) of a curve or flag; None if a field is missing or has no value.

    `constants` are parameters, and values of fields that some versions lack.
    """
    found = evaluate(line.value, columns, constants)
    # A field that is never filled counts as missing, and so does a text, by a damaged format.
    if found is None or not _is_numeric(found) or not np.isfinite(found).any():
        return None
    return np.asarray(found, float)


def rows_of(
    line: MapLine, columns: Columns, constants: Mapping[str, float] = NOTHING
) -> Values | None:
    """The numbers (n, k) of a track or sample; None if a field is missing."""
    found = evaluate(line.value, columns, constants)
    if found is None:
        return None
    parts = found if isinstance(found, tuple) else (found,)
    if not all(map(_is_numeric, parts)):
        return None
    count = next(iter(columns.values())).shape[0]
    wide = [np.atleast_2d(np.broadcast_to(part, (*np.shape(part)[:-1], count))) for part in parts]
    return np.concatenate(wide).astype(float).T


def _is_numeric(found: Any) -> bool:
    return np.asarray(found).dtype.kind in "biuf"


def evaluate(value: CodeType, columns: Columns, constants: Mapping[str, float] = NOTHING) -> Any:
    """The value of an expression; None where a field is missing or of another type."""
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            return eval(value, FUNCTIONS, Fields(columns, constants))
    except (KeyError, NameError, IndexError, TypeError, ValueError, AttributeError):
        return None


@cache
def _condition(text: str) -> CodeType:
    return compile(text, text, "eval")


def chosen_rows(line: MapLine, columns: Columns) -> NDArray[np.int64] | None:
    """The rows (m,) of a message that a sample's condition selects; None for all of them."""
    return None if line.name == ALL else np.flatnonzero(evaluate(_condition(line.name), columns))


class Fields(dict[str, Any]):
    """The fields of a message as the names of an expression."""

    def __init__(self, columns: Columns, constants: Mapping[str, float]) -> None:
        self._columns, self._constants = columns, constants

    def __missing__(self, name: str) -> Any:
        if name in self._columns:
            found = self._columns[name]
            self[name] = found.T if found.ndim > 1 else found
            # Single precision would limit what is computed from it.
            self[name] = self[name].astype(float) if found.dtype == np.float32 else self[name]
        elif f"{name}[0]" in self._columns or name.endswith("_"):
            form = "{}{}" if name.endswith("_") else "{}[{}]"
            elements = (form.format(name.rstrip("_"), i) for i in range(len(self._columns) + 1))
            self[name] = np.array([self._columns[e] for e in elements if e in self._columns], float)
        elif any(key.startswith(f"{name}[") for key in self._columns):
            self[name] = _Structures(name, self._columns)
        else:
            self[name] = self._constants[name]
        return self[name]


class _Structures:
    """An array of structures, whose members are columns such as `esc[0].esc_rpm`."""

    def __init__(self, name: str, columns: Columns) -> None:
        self._name, self._columns = name, columns

    def __getitem__(self, i: int) -> "_Structures":
        return _Structures(f"{self._name}[{i}]", self._columns)

    def __getattr__(self, member: str) -> NDArray[Any]:
        return self._columns[f"{self._name}.{member}"]


def _known(raw: Values, unknown: float) -> Values:
    """Values of which one means unknown."""
    return np.where(raw == unknown, np.nan, raw)


def _used(raw: Values, scale: float = 1.0) -> Values:
    """Values of something that may not be connected: all NaN if always 0 or 65535."""
    raw = np.where(raw == UNUSED, np.nan, raw)
    return raw * scale if np.nan_to_num(raw).any() else np.full(len(raw), np.nan)


def _since(begun: Values, raw: Values) -> Values:
    """Values from the first row on at which something is true; zeros before it mean nothing."""
    return np.where(np.logical_or.accumulate(begun), raw, np.nan)


def _accuracy(metres: Values) -> Values:
    """An accuracy in m; NaN if zero or above 1000 km, as receivers without a fix report."""
    return np.where((metres > 0) & (metres < UNKNOWN_M), metres, np.nan)


def _euler(q: Values) -> Values:
    """Roll, pitch and yaw (3, n) in degrees of quaternions (4, n)."""
    return np.degrees(euler_from_quat(np.asarray(q, float).T)).T


def _rank(values: Values, place: int) -> Values:
    """The value of some rank among those (k, n) of each instant, 1 is the highest; NaN if none."""
    ranked = -np.sort(-np.asarray(values, float), axis=0)[place - 1]
    return np.where(ranked > 0, ranked, np.nan)


def _summed(cells: Values) -> Values:
    """Sum (n,) of voltages (k, n) in mV; NaN without any."""
    known = _known(cells, UNUSED)
    return np.where(np.isnan(known).all(axis=0), np.nan, np.nansum(known, axis=0) * 1e-3)


def _old_hundredths(raw: Values, volt: Values) -> Values:
    """Volts or amperes, which old logs give in hundredths, as the median voltage shows."""
    return raw * (0.01 if np.nanmedian(volt) > HIGH_V else 1.0)


def _pascal(pressure: Values) -> Values:
    """A pressure in Pa, which PX4 before 1.14 gives in hPa; the median is robust to outliers."""
    return pressure * (100.0 if np.nanmedian(pressure) < MOST_HECTOPASCAL else 1.0)


def _twelve(outputs: Values) -> Values:
    """The first twelve outputs (12, n); 0 where one is off or does not exist."""
    some = np.where(np.isfinite(outputs), outputs, 0.0)[:12]
    return np.pad(some, ((0, 12 - len(some)), (0, 0)))


def _course(speed: Values, degrees: Values) -> Values:
    """Velocity north and east (2, n) from speed and course."""
    return np.array([speed * np.cos(np.radians(degrees)), speed * np.sin(np.radians(degrees))])


def _quat(roll: Values, pitch: Values, yaw: Values) -> Values:
    """Quaternions (4, n) of angles in rad."""
    return quat_from_euler(*(np.asarray(angle, float) for angle in (roll, pitch, yaw))).T


def _named(names: Mapping[int, str], numbers: NDArray[Any], other: str = "mode {}") -> NDArray[Any]:
    """Names (n,) of numbers."""
    every, which = np.unique(numbers, return_inverse=True)
    return np.array([names.get(int(n), other.format(n)) for n in every])[which]


def _numbered(word: str, numbers: NDArray[Any]) -> NDArray[Any]:
    """Names (n,) of instances, which count from 0 in logs and from 1 in reports."""
    return np.array([f"{word} {int(n) + 1}" for n in numbers])


def _unit(q: Values) -> Values:
    """Quaternions (4, n) of length one; an all-zero one is no attitude."""
    with np.errstate(invalid="ignore"):
        return np.asarray(q / np.linalg.norm(q, axis=0))


def _to_ned(q: Values, body: NDArray[np.bool_], v: Values) -> Values:
    """Velocities (3, n) in NED; those in `body` axes (n,) are turned by their attitude."""
    turned = np.einsum("nij,jn->in", matrix_from_quat(_unit(q).T), v)
    ned = np.where(body, turned, v)
    # A velocity with an unknown component is unknown.
    return np.where(np.isfinite(ned).all(axis=0), ned, np.nan)


FUNCTIONS: dict[str, Any] = {
    "__builtins__": {}, "DEG": 180 / np.pi, "GRAVITY": STANDARD_GRAVITY_MPS2, "nan": np.nan,
    "stack": lambda *parts: np.array(parts, float), "where": np.where, "sqrt": np.sqrt,
    "known": _known, "used": _used, "since": _since, "accuracy": _accuracy, "euler": _euler,
    "rank": _rank, "summed": _summed, "old_hundredths": _old_hundredths, "pascal": _pascal,
    "course": _course, "quat": _quat, "unit": _unit, "to_ned": _to_ned, "wrapped": wrap_degrees,
    "norm": lambda *parts: np.sqrt(sum(np.asarray(p, float) ** 2 for p in parts)),
    "most": lambda *parts: np.max(np.abs(np.array(parts, float)), axis=0),
    "above_0": lambda raw: np.where(raw > 0, raw, np.nan), "twelve": _twelve,
    "bit": lambda flags, i: np.asarray(flags).astype(np.int64) >> i & 1 == 1,
    "at_least": np.maximum, "named": _named, "numbered": _numbered,
    "NAV_STATES": NAMES["PX4 navigation state"], "JAMMING": {2: "warning", 3: "critical"},
    "SPOOFING": {2: "indicated", 3: "multiple indications"},
    "LANDED": {1: "landed", 2: "flying", 3: "flying", 4: "flying"},  # MAV_LANDED_STATE
    # Places in `block.SOURCES` of the messages that a sample may be of.
    "HIL_GPS": 0, "GPS_RAW_INT": 1, "ATTITUDE": 2, "ATTITUDE_QUATERNION": 3,
    "HIL_ACTUATOR_CONTROLS": 4, "OUTPUTS": 5,
}  # fmt: skip


def _table(name: str) -> FieldMap:
    return read_map((files(__package__) / name).read_text(encoding="utf-8"))


TLOG, ULOG, DATAFLASH = _table("tlog.map"), _table("ulog.map"), _table("dataflash.map")
