"""Read the sensor measurements of PX4 ULogs and ArduPilot dataflash logs as samples.

Detectors use the first sensor of each kind; redundant IMUs, magnetometers, barometers and receivers
are read for voting. The autopilot's attitude estimate is read too.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.dataflash import (
    HEAD,
    DataflashFile,
    is_dataflash,
    read_dataflash,
)
from analysis.recordings.flight_logs.log_condition import (
    CORRUPTED,
    LogCondition,
    dataflash_losses,
    ulog_losses,
)
from analysis.recordings.flight_logs.ulog import ULogFile, is_ulog, read_ulog
from analysis.samples.block import (
    AIRSPEED,
    ATTITUDE,
    BARO,
    COMMAND,
    COMMAND_SOURCE,
    FIX,
    FIX_TYPE,
    IMU,
    IMU_ID,
    MAG,
    OUTPUTS,
    RANGE,
    SOURCES,
    SPARE,
    SPARE_ID,
    SPARE_KIND,
    SPARE_NUMBERS,
    WIDTH,
    Block,
    BlockPart,
    join_parts,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler

Topic = Mapping[str, NDArray[Any]]
Columns = Callable[[Topic], list[NDArray[Any]]]
Topics = Mapping[tuple[str, int], Topic]
FIX_3D = 3
INSTANCES = 3
# Fields by which an ArduPilot driver reports that its measurement is new and healthy
HEALTH = {IMU: ("GH", "AH"), MAG: ("Health",), BARO: ("H", "Health")}
VOTERS = (IMU, MAG, BARO, FIX)  # kinds of which redundant sensors are read
SYSTEM = 1  # MAVLink system id of the attitude
MILLIGAUSS = 1e-3
PER_OUTPUT = 1e-3  # command units per microsecond of pulse width
MOST_HECTOPASCAL = 2000.0  # twice sea level; in pascal every pressure is above
GPS_SOURCE, ATTITUDE_SOURCE = SOURCES.index("GPS_RAW_INT"), SOURCES.index("ATTITUDE_QUATERNION")


def is_autopilot_log(path: Path) -> bool:
    """Whether a file is a ULog or a dataflash log."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return is_ulog(head) or is_dataflash(head)


def read_autopilot_log(path: Path, condition: LogCondition | None = None) -> Block:
    """Read the samples of a ULog or a dataflash log in order of time; notes lost parts in
    `condition`.

    Raises
    ------
    ConfigError
        If the log lacks IMU or GPS samples; the tests need both.
    """
    with path.open("rb") as file:
        ulog = is_ulog(file.read(HEAD))
    log = read_ulog(path) if ulog else read_dataflash(path, READ)
    if condition is not None:
        _add_losses(condition, log)
    topics = log.topics if ulog else _with_accuracy(log.topics)
    stamp = "timestamp" if ulog else "TimeUS"
    found = list(_parts(topics, ULOG if ulog else DATAFLASH, stamp))
    missing = [name for kind, name in ((IMU, "IMU"), (FIX, "GPS")) if not _has_kind(found, kind)]
    if missing:
        raise ConfigError(
            f"{path}: holds no samples of {' and '.join(missing)}; the monitor needs a log in "
            "which both are logged"
        )
    stamps = np.concatenate([t_us for _, t_us, _ in found])
    # One order over all topics; at equal timestamps in the order of the table.
    rank = np.empty(len(stamps), np.int64)
    rank[np.argsort(stamps, kind="stable")] = np.arange(len(stamps))
    ends = np.cumsum([len(t_us) for _, t_us, _ in found])
    orders = np.split(rank, ends[:-1])
    return join_parts(
        [BlockPart(k, o, t, v) for (k, t, v), o in zip(found, orders, strict=True)], ()
    )


def _add_losses(condition: LogCondition, log: ULogFile | DataflashFile) -> None:
    """Note in `condition` what a log has lost."""
    # An incomplete last message is normal: loggers are usually switched off while writing.
    condition.damage += [CORRUPTED] if log.corrupted else []
    if isinstance(log, ULogFile):
        condition.lost_us += ulog_losses(log.dropouts)
        return
    condition.lost_us += dataflash_losses(log.topics)


def _with_accuracy(topics: Topics) -> Topics:
    """Add each receiver's accuracy, which ArduPilot logs in GPA, to its GPS topic."""
    found = dict(topics)
    for number in range(INSTANCES):
        fixes, said = topics.get(("GPS", number)), topics.get(("GPA", number))
        if fixes is None or said is None or not {"HAcc", "VAcc"} <= said.keys():
            continue
        # GPS and GPA share timestamps; where one is missing, the newest GPA counts.
        newest = np.maximum(np.searchsorted(said["TimeUS"], fixes["TimeUS"], "right") - 1, 0)
        found["GPS", number] = {**fixes, **{name: said[name][newest] for name in ("HAcc", "VAcc")}}
    return found


def _has_kind(found: Iterable[tuple[int, Any, Any]], kind: int) -> bool:
    return any(number == kind for number, _, _ in found)


def _parts(
    topics: Topics, table: Iterable[tuple[str, int, Columns]], stamp: str
) -> Iterable[tuple[int, NDArray[np.int64], NDArray[np.float64]]]:
    """Kind, timestamps and values of the logged topics; the first topic of a kind is used."""
    done: set[int] = set()
    for name, kind, columns in table:
        if kind in done:
            continue
        for number in range(INSTANCES if kind in VOTERS else 1):
            topic = topics.get((name, number))
            if topic is None or not len((topic := _healthy(topic, kind))[stamp]):
                continue
            try:
                values = np.column_stack(columns(topic)).astype(float)
            except KeyError:  # another version of the autopilot; a later row may match it
                continue
            if kind == IMU:
                values[:, IMU_ID] = number
            elif number:
                yield SPARE, *_spare(kind, number, topic[stamp].astype(np.int64), values)
                continue
            done.add(kind)
            # Detectors use the IMU of the first sample; start with instance 0.
            spoken = topic[stamp] >= topics.get((name, 0), topic)[stamp][0]
            yield kind, topic[stamp][spoken].astype(np.int64), values[spoken, :WIDTH]


def _healthy(topic: Topic, kind: int) -> Topic:
    """Remove the messages that the driver marks as unhealthy."""
    says = [topic[name] for name in HEALTH.get(kind, ()) if name in topic]
    if not says:
        return topic
    sound = np.all(np.array(says) != 0, axis=0)
    return topic if sound.all() else {name: values[sound] for name, values in topic.items()}


def _spare(
    kind: int, number: int, t_us: NDArray[np.int64], values: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Timestamps and rows of a redundant sensor; of a receiver those with a 3D fix."""
    keep = values[:, FIX_TYPE] >= FIX_3D if kind == FIX else np.ones(len(t_us), bool)
    found = np.zeros((int(keep.sum()), SPARE_NUMBERS + 3))
    found[:, SPARE_KIND], found[:, SPARE_ID] = kind, number
    numbers = values[keep, :3]
    found[:, SPARE_NUMBERS : SPARE_NUMBERS + numbers.shape[1]] = numbers
    return t_us[keep], found


def _each(*names: str, scale: float = 1.0) -> Columns:
    return lambda topic: [topic[name] * scale for name in names]


def _filled(topic: Topic, value: float) -> NDArray[np.float64]:
    return np.full(len(next(iter(topic.values()))), value)


def _pressure(name: str) -> Columns:
    return lambda topic: [topic[name], _filled(topic, np.nan)]


def _sensor_pressure(topic: Topic) -> list[NDArray[Any]]:
    """Pressure of `sensor_baro`: pascal since PX4 1.14, hectopascal before."""
    pressure = topic["pressure"].astype(float)
    # Decided by magnitude, since the field name is the same; the median is robust to outliers.
    scale = 100.0 if np.nanmedian(pressure) < MOST_HECTOPASCAL else 1.0
    return [pressure * scale, _filled(topic, np.nan)]


def _px4_fix(topic: Topic) -> list[NDArray[Any]]:
    names = ("latitude_deg", "longitude_deg", "altitude_msl_m", "vel_n_m_s", "vel_e_m_s")
    more = ("vel_d_m_s", "fix_type", "satellites_used", "eph", "epv")
    return [*(topic[name] for name in (*names, *more)), _filled(topic, GPS_SOURCE)]


def _ardupilot_fix(topic: Topic) -> list[NDArray[Any]]:
    course = np.radians(topic["GCrs"])
    v_ned = [topic["Spd"] * np.cos(course), topic["Spd"] * np.sin(course), topic["VZ"]]
    place = [topic[name] for name in ("Lat", "Lng", "Alt")]
    unknown = _filled(topic, np.nan)
    accuracy = [topic.get(name, unknown) for name in ("HAcc", "VAcc")]
    state = [topic["Status"], topic["NSats"], *accuracy]
    return [*place, *v_ned, *state, _filled(topic, GPS_SOURCE)]


def _px4_attitude(topic: Topic) -> list[NDArray[Any]]:
    q_nb = [topic[f"q[{i}]"] for i in range(4)]
    return [*q_nb, _filled(topic, SYSTEM), _filled(topic, ATTITUDE_SOURCE)]


def _ardupilot_attitude(topic: Topic) -> list[NDArray[Any]]:
    angles = (np.radians(topic[name].astype(float)) for name in ("Roll", "Pitch", "Yaw"))
    q_nb = list(quat_from_euler(*angles).T)
    return [*q_nb, _filled(topic, SYSTEM), _filled(topic, ATTITUDE_SOURCE)]


def _outputs(first: str, *others: str, scale: float = PER_OUTPUT) -> Columns:
    """The first outputs, in thousands of microseconds or as a share of full output; missing outputs
    are 0."""

    def columns(topic: Topic) -> list[NDArray[Any]]:
        none = _filled(topic, 0.0)
        found = [topic[first], *(topic.get(name, none) for name in others)]
        return [*(np.nan_to_num(output) * scale for output in found), none + OUTPUTS]

    return columns


_AXES = range(3)
ULOG: tuple[tuple[str, int, Columns], ...] = (
    (
        "sensor_combined",
        IMU,
        lambda topic: [
            *(topic[f"gyro_rad[{i}]"] for i in _AXES),
            *(topic[f"accelerometer_m_s2[{i}]"] for i in _AXES),
            _filled(topic, 0),
        ],
    ),
    ("vehicle_magnetometer", MAG, _each(*(f"magnetometer_ga[{i}]" for i in _AXES))),
    ("sensor_mag", MAG, _each("x", "y", "z")),
    ("sensor_combined", MAG, _each(*(f"magnetometer_ga[{i}]" for i in _AXES))),
    ("vehicle_air_data", BARO, _pressure("baro_pressure_pa")),
    ("sensor_baro", BARO, _sensor_pressure),
    ("differential_pressure", AIRSPEED, _each("differential_pressure_pa")),
    ("differential_pressure", AIRSPEED, _each("differential_pressure_filtered_pa")),
    ("distance_sensor", RANGE, _each("current_distance")),
    ("vehicle_gps_position", FIX, _px4_fix),
    ("sensor_gps", FIX, _px4_fix),
    ("vehicle_attitude", ATTITUDE, _px4_attitude),
    ("actuator_outputs", COMMAND, _outputs(*(f"output[{i}]" for i in range(COMMAND_SOURCE)))),
    # Commands of the control allocation, since PX4 1.13.
    (
        "actuator_motors",
        COMMAND,
        _outputs(*(f"control[{i}]" for i in range(COMMAND_SOURCE)), scale=1.0),
    ),
)
DATAFLASH: tuple[tuple[str, int, Columns], ...] = (
    (
        "IMU",
        IMU,
        lambda topic: [
            *(topic[name] for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")),
            _filled(topic, 0),
        ],
    ),
    ("MAG", MAG, _each("MagX", "MagY", "MagZ", scale=MILLIGAUSS)),
    ("BARO", BARO, _pressure("Press")),
    ("ARSP", AIRSPEED, _each("DiffPress")),
    ("RFND", RANGE, _each("Dist")),
    ("GPS", FIX, _ardupilot_fix),
    ("ATT", ATTITUDE, _ardupilot_attitude),
    ("RCOU", COMMAND, _outputs(*(f"C{i + 1}" for i in range(COMMAND_SOURCE)))),
    ("RCOU", COMMAND, _outputs(*(f"Ch{i + 1}" for i in range(COMMAND_SOURCE)))),
)
READ = {*(name for name, _, _ in DATAFLASH), "GPA", "DSF"}  # of a dataflash log
