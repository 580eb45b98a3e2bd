"""Read the sensor measurements of PX4 ULogs and ArduPilot dataflash logs as samples.

Detectors use the first sensor of each kind; redundant IMUs, magnetometers, barometers and receivers
are read for voting. The autopilot's attitude estimate is read too.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.field_map import DATAFLASH, ULOG, MapLine, rows_of
from analysis.recordings.flight_logs.autopilot_log import CORRUPTED, AutopilotLog
from analysis.recordings.flight_logs.dataflash import HEAD, is_dataflash, read_dataflash
from analysis.recordings.flight_logs.log_condition import LogCondition, dataflash_losses
from analysis.recordings.flight_logs.log_time import FARTHEST_BEHIND_US
from analysis.recordings.flight_logs.logged_rows import (
    BLOCK_BYTES,
    BlockRows,
    Rows,
    Thin,
    Topic,
    join_rows,
)
from analysis.recordings.flight_logs.ulog import is_ulog, read_ulog
from analysis.samples import block
from analysis.samples.block import (
    FIX,
    FIX_TYPE,
    IMU,
    IMU_ID,
    NEVER_US,
    SPARE,
    SPARE_ID,
    SPARE_KIND,
    SPARE_NUMBERS,
    WIDTH,
    Block,
    BlockPart,
    Stamps,
    join_parts,
)
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.written import written_bytes

Topics = Mapping[tuple[str, int], Topic]
FIX_3D = 3
INSTANCES = 3
MOST_SAMPLES = 1 << 15  # in a block: their results need more memory than they
FEW_BYTES = 16_384  # of a message in a block: all rows of GPS and the like are fewer
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
    thin: Thin | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> AutopilotLog:
    """Read a ULog or a dataflash log (`read_ulog`, `read_dataflash`).

    `thin` chooses the rows (k,) to keep of those (n,) of one message in a block.
    """
    with path.open("rb") as file:
        ulog = is_ulog(file.read(HEAD))
    return read_ulog(path, progress, thin) if ulog else read_dataflash(path, only, thin)


def read_autopilot_log(path: Path, condition: LogCondition) -> Iterator[Block]:
    """Read the samples of a ULog or a dataflash log in order of time, block by block; notes lost
    parts in `condition`.

    Raises
    ------
    ConfigError
        If the log lacks IMU or GPS samples; the tests need both.
    """
    # Few rows of a large log show its clock and what it holds.
    log = read_topics(path, READ, _few_rows if written_bytes(path) > BLOCK_BYTES else None)
    # A dropout is stamped with the record before it.
    condition.lost_us += [(t_us, t_us + round(lost_s * 1e6)) for t_us, lost_s in log.dropouts]
    condition.lost_us += dataflash_losses(log.topics)
    px4 = log.autopilot == "px4"
    begins_us = {name: int(topic[log.stamp][0]) for (name, n), topic in log.topics.items() if not n}
    lines = ULOG_SAMPLES if px4 else DATAFLASH_SAMPLES
    found = list(_samples(log.topics, lines, log.stamp, begins_us))
    used, kinds = dict.fromkeys(line for line, *_ in found), {kind for _, kind, *_ in found}
    missing = [name for kind, name in ((IMU, "IMU"), (FIX, "GPS")) if kind not in kinds]
    if missing:
        raise ConfigError(
            f"{path}: holds no samples of {' and '.join(missing)}; the monitor needs a log in "
            "which both are logged"
        )
    for topics in _topic_blocks(log):
        known = topics if px4 else _with_accuracy(topics)
        samples = _block(list(_samples(known, used, log.stamp, begins_us)))
        for begin in range(0, len(samples.kind), MOST_SAMPLES):
            yield samples.between(begin, min(begin + MOST_SAMPLES, len(samples.kind)))
    # An incomplete last message is normal: loggers are usually switched off while writing.
    condition.damage += [CORRUPTED] if log.corrupted or log.times.misdated else []


def _few_rows(rows: Rows) -> Rows:
    # A copy: a view would keep all rows in memory.
    return rows[:: -(-rows.nbytes // FEW_BYTES) or 1].copy()


def _topic_blocks(log: AutopilotLog) -> Iterator[Topics]:
    """The topics of a log in order of time, block by block; in one block if they are complete."""
    if not log.thinned:
        yield log.topics
        return
    rest: BlockRows = []
    until_us = NEVER_US
    for rows in log.rows.blocks():
        begin_us, placed = until_us, []
        for key, some in join_rows([rows]).items():
            t_us, keep = log.times.place(key, log.rows.stamps(key, some))
            if key in log.times.even and keep.any():
                until_us = max(until_us, int(t_us[keep].max()) - FARTHEST_BEHIND_US)
            # From here on the time of a row counts, no longer its place in the file.
            some["at"] = t_us
            placed.append((key, some[keep & (t_us >= begin_us)]))
        every = join_rows([rest, placed])
        yield _columns(log, ((key, some[some["at"] < until_us]) for key, some in every.items()))
        rest = [(key, some[some["at"] >= until_us]) for key, some in every.items()]
    yield _columns(log, rest)


def _columns(log: AutopilotLog, rows: Iterable[tuple[Any, Rows]]) -> dict[tuple[str, int], Topic]:
    """The topics of rows whose times stand for their places."""
    topics = (log.rows.topics(key, some, some["at"]) for key, some in rows if len(some))
    return {name: topic for several in topics for name, topic in several}


def _samples(
    topics: Topics, lines: Iterable[MapLine], stamp: str, begins_us: Mapping[str, int]
) -> Iterator[tuple[MapLine, int, Stamps, NDArray[np.float64]]]:
    """Line, kind, timestamps and values of topics; of each kind the first message that has any.

    Detectors use the IMU of the first sample: each message counts from `begins_us` on.
    """
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
            t_us, kind = topic[stamp].astype(np.int64), getattr(block, line.target)
            if number and kind != IMU:
                yield line, SPARE, *_spare(kind, number, t_us, values)
                continue
            if kind == IMU:
                values[:, IMU_ID] = number
            done.add(line.target)
            begun = t_us >= begins_us.get(line.message, NEVER_US)
            yield line, kind, t_us[begun], values[begun, :WIDTH]


def _block(parts: Sequence[tuple[MapLine, int, Stamps, NDArray[np.float64]]]) -> Block:
    """One block of samples."""
    # One order over all topics; at equal timestamps in the order of the table.
    stamps = np.concatenate([np.empty(0, np.int64), *(t_us for _, _, t_us, _ in parts)])
    rank = np.empty(len(stamps), np.int64)
    rank[np.argsort(stamps, kind="stable")] = np.arange(len(stamps))
    ends = np.cumsum([len(t_us) for _, _, t_us, _ in parts], dtype=int)
    orders = np.split(rank, ends[:-1])
    return join_parts(
        [BlockPart(k, o, t, v) for (_, k, t, v), o in zip(parts, orders, strict=False)], ()
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


def _healthy(topic: Topic, kind: str) -> Topic:
    """Remove the messages that the driver marks as unhealthy."""
    says = [topic[name] for name in HEALTH.get(kind, ()) if name in topic]
    if not says:
        return topic
    sound = np.all(np.array(says) != 0, axis=0)
    return topic if sound.all() else {name: values[sound] for name, values in topic.items()}


def _spare(
    kind: int, number: int, t_us: Stamps, values: NDArray[np.float64]
) -> tuple[Stamps, NDArray[np.float64]]:
    """Timestamps and rows of a redundant sensor; of a receiver those with a 3D fix."""
    keep = values[:, FIX_TYPE] >= FIX_3D if kind == FIX else np.ones(len(t_us), bool)
    found = np.zeros((int(keep.sum()), SPARE_NUMBERS + 3))
    found[:, SPARE_KIND], found[:, SPARE_ID] = kind, number
    numbers = values[keep, :3]
    found[:, SPARE_NUMBERS : SPARE_NUMBERS + numbers.shape[1]] = numbers
    return t_us[keep], found
