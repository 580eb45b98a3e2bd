"""Read the sensor measurements of PX4 ULogs and ArduPilot dataflash logs as samples.

Detectors use the first sensor of each kind; redundant IMUs, magnetometers, barometers and receivers
are read for voting. The autopilot's attitude estimate is read too.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.field_map import DATAFLASH, ULOG, MapLine, rows_of
from analysis.recordings.flight_logs.autopilot_log import CORRUPTED, AutopilotLog
from analysis.recordings.flight_logs.dataflash import HEAD, is_dataflash, read_dataflash
from analysis.recordings.flight_logs.log_condition import (
    LogCondition,
    dataflash_losses,
    ulog_losses,
)
from analysis.recordings.flight_logs.ulog import is_ulog, read_ulog
from analysis.samples import block
from analysis.samples.block import (
    FIX,
    FIX_TYPE,
    IMU,
    IMU_ID,
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

Rows = NDArray[np.void]
Topic = Mapping[str, NDArray[Any]]
Topics = Mapping[tuple[str, int], Topic]
FIX_3D = 3
INSTANCES = 3
# Fields by which an ArduPilot driver reports that its measurement is new and healthy
HEALTH = {"IMU": ("GH", "AH"), "MAG": ("Health",), "BARO": ("H", "Health")}
VOTERS = ("IMU", "MAG", "BARO", "FIX")  # kinds of which redundant sensors are read
NO_ACCURACY = {"HAcc": np.nan, "VAcc": np.nan}  # of a receiver, where the log has none
# The order of samples with equal stamps.
KINDS = ("IMU", "MAG", "BARO", "AIRSPEED", "RANGE", "FIX", "ATTITUDE", "COMMAND")
ULOG_SAMPLES, DATAFLASH_SAMPLES = (
    sorted(
        (line for lines in table.values() for line in lines if line.target in KINDS),
        key=lambda line: KINDS.index(line.target),
    )
    for table in (ULOG, DATAFLASH)
)
# Messages to read of a dataflash log.
READ = {*(line.message for line in DATAFLASH_SAMPLES), "GPA", "DSF"}


def is_autopilot_log(path: Path) -> bool:
    """Whether a file is a ULog or a dataflash log."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return is_ulog(head) or is_dataflash(head)


def read_topics(
    path: Path,
    only: Collection[str] | None = None,
    thin: Callable[[Rows], Rows] = lambda rows: rows,
    progress: Callable[[float], None] = lambda _: None,
) -> AutopilotLog:
    """Read a ULog or a dataflash log (`read_ulog`, `read_dataflash`)."""
    with path.open("rb") as file:
        ulog = is_ulog(file.read(HEAD))
    return read_ulog(path, progress, thin) if ulog else read_dataflash(path, only, thin)


def read_autopilot_log(path: Path, condition: LogCondition | None = None) -> Block:
    """Read the samples of a ULog or a dataflash log in order of time; notes lost parts in
    `condition`.

    Raises
    ------
    ConfigError
        If the log lacks IMU or GPS samples; the tests need both.
    """
    log = read_topics(path, READ)
    if condition is not None:
        # An incomplete last message is normal: loggers are usually switched off while writing.
        condition.damage += [CORRUPTED] if log.corrupted else []
        condition.lost_us += ulog_losses(log.dropouts) + dataflash_losses(log.topics)
    px4 = log.autopilot == "px4"
    topics = log.topics if px4 else _with_accuracy(log.topics)
    found = list(_parts(topics, ULOG_SAMPLES if px4 else DATAFLASH_SAMPLES, log.stamp))
    kinds = {kind for kind, _, _ in found}
    missing = [name for kind, name in ((IMU, "IMU"), (FIX, "GPS")) if kind not in kinds]
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


def _parts(
    topics: Topics, lines: Iterable[MapLine], stamp: str
) -> Iterable[tuple[int, NDArray[np.int64], NDArray[np.float64]]]:
    """Kind, timestamps and values of the logged topics; the first topic of a kind is used."""
    done: set[str] = set()
    for line in lines:
        if line.target in done:
            continue
        for number in range(INSTANCES if line.target in VOTERS else 1):
            topic = topics.get((line.message, number))
            if topic is None or not len((topic := _healthy(topic, line.target))[stamp]):
                continue
            values = rows_of(line, topic, NO_ACCURACY)
            if values is None:  # another version of the autopilot; a later line may match it
                continue
            t_us = topic[stamp].astype(np.int64)
            if line.target == "IMU":
                values[:, IMU_ID] = number
            elif number:
                yield SPARE, *_spare(getattr(block, line.target), number, t_us, values)
                continue
            done.add(line.target)
            # Detectors use the IMU of the first sample; start with instance 0.
            spoken = t_us >= int(topics.get((line.message, 0), topic)[stamp][0])
            yield getattr(block, line.target), t_us[spoken], values[spoken, :WIDTH]


def _healthy(topic: Topic, kind: str) -> Topic:
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
