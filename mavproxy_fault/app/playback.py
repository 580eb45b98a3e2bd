"""Logs as the core needs them: every record with its stamp and the link it came on.

A `received.tlog` of the proxy lies beside its index and `session.json`, which say it all. In any
other tlog the direction of a frame is told by its sender: ground stations (systems from 240 on,
components 190 to 194) and simulators (component 51, and whoever sends HIL sensors) talk to the
vehicle, everything else comes from it. Bytes that are no frame belong to the record before them.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mavproxy_fault.app.recorder import EDITS, INDEX, RECEIVED, RECEIVED_OTHER, SESSION
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.edit_log import Edit, read_edits
from mavproxy_fault.proxy.capture_buffer import INDEX as INDEX_RECORD
from mavproxy_fault.proxy.capture_buffer import LENGTH, STAMP
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.sender_rules import MAX_STAMP_US
from mavproxy_fault.wire.dialect import find_layout
from mavproxy_fault.wire.frame import STX_V1, STX_V2
from mavproxy_fault.wire.parser import frame_span

VEHICLE, OTHERS = 0, 1
ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("others", "to-vehicle"))
FIRST_STATION = 240  # systems; MAVSDK is 245, QGroundControl and MAVProxy are 255
STATION_COMPONENTS = range(190, 195)  # MAV_COMP_ID_MISSIONPLANNER and its neighbours
SIMULATOR_COMPONENT = 51
FROM_AUTOPILOT = ("HIL_ACTUATOR_CONTROLS", "HIL_CONTROLS")
NEAR_US = 86_400_000_000  # neighbours in a log lie within a day


class LogRecord(NamedTuple):
    """One record of a log: when and on which link it came."""

    t_us: int
    link: int
    raw: bytes


class LogSource(NamedTuple):
    """A log to play; `session` is what was recorded about it, `edits` what was asked live."""

    roles: tuple[LinkRole, ...]
    records: Iterator[LogRecord]
    session: dict[str, Any]
    edits: tuple[Edit, ...] = ()

    @property
    def end_us(self) -> int | None:
        """When the session ended, if that was recorded."""
        return self.session.get("end_us")


def open_log(path: Path) -> LogSource:
    """A log with its session, or one from elsewhere with directions guessed.

    Raises
    ------
    ConfigError
        If there is no such file, or it holds no record.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: is not a file; allowed: a tlog")
    session, index = path.with_name(SESSION), path.with_name(INDEX)
    # All three belong together: without index or session the log is any other tlog.
    if path.name == RECEIVED and session.is_file() and index.is_file():
        recorded: dict[str, Any] = json.loads(session.read_text())
        roles = tuple(LinkRole(link["name"], link["direction"]) for link in recorded["links"])
        edits = read_edits(path.with_name(EDITS))
        return LogSource(roles, _indexed(path, index), recorded, tuple(edits))
    data = path.read_bytes()
    if _find(data, 0, None) is None:
        raise ConfigError(f"{path}: holds no MAVLink record; allowed: a tlog")
    return LogSource(ROLES, _foreign(data), {})


def _indexed(path: Path, index: Path) -> Iterator[LogRecord]:
    with (
        path.open("rb") as log,
        path.with_name(RECEIVED_OTHER).open("rb") as other,
        index.open("rb") as entries,
    ):
        # A record cut short ends the session: nothing behind it can be placed.
        while len(entry := entries.read(INDEX_RECORD.size)) == INDEX_RECORD.size:
            link, elsewhere, length = INDEX_RECORD.unpack(entry)
            # A stamp stands before every record, whichever of the two files it lies in.
            stamp = (other if elsewhere else log).read(STAMP.size)
            raw = other.read(LENGTH.size + length)[LENGTH.size :] if elsewhere else log.read(length)
            # The process was killed while it wrote, or the file was damaged since.
            if len(raw) < length or (t_us := STAMP.unpack(stamp)[0]) >= MAX_STAMP_US:
                return
            yield LogRecord(t_us, link, raw)


def _foreign(data: bytes) -> Iterator[LogRecord]:
    simulators: set[bytes] = set()
    for t_us, raw in split_records(data):
        yield LogRecord(t_us, _link_of(raw, simulators), raw)


def split_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Stamp and bytes of each record; no byte behind the first stamp is lost, but a cut stamp."""
    at = _find(data, 0, None)
    while at is not None and len(data) - at > STAMP.size:
        t_us = STAMP.unpack_from(data, at)[0]
        body = at + STAMP.size
        end = _end(data, body)
        after = _find(data, end, t_us)
        # Behind the last record that is found nothing can be a stamp: it is all bytes.
        stop = len(data) if after is None else after
        yield t_us, data[body : min(end, stop)]
        if stop > end:
            yield t_us, data[end:stop]
        at = after


def _end(data: bytes, at: int) -> int:
    found = frame_span(data, at) if data[at] in (STX_V1, STX_V2) else None
    # Without a length that can be trusted the record reaches to the end.
    return len(data) if found is None else min(at + found[0], len(data))


def _find(data: bytes, start: int, t_us: int | None) -> int | None:
    """The next place from `start` on that looks like the start of a record."""
    for at in range(start, len(data) - STAMP.size):
        if data[at + STAMP.size] not in (STX_V1, STX_V2):
            # Most places are ruled out by one byte.
            continue
        (stamp,) = struct.unpack_from(">Q", data, at)
        if stamp >= MAX_STAMP_US or (t_us is not None and abs(stamp - t_us) > NEAR_US):
            # A stamp out of the blue is a chance pattern in the payload.
            continue
        end = _end(data, at + STAMP.size)
        # A start byte may stand anywhere: the next record must begin where this one ends,
        # but for the last, which has none behind it.
        if end + STAMP.size >= len(data) or data[end + STAMP.size] in (STX_V1, STX_V2):
            return at
        # The place where the record before ends: trusted even if what follows is damaged.
        if at == start and t_us is not None:
            return at
    return None


def _link_of(raw: bytes, simulators: set[bytes]) -> int:
    # Less than a header of ten bytes tells neither sender nor message.
    if raw[0] == STX_V2 and len(raw) > 9:
        # System and component; then the message id, three bytes.
        source, known = raw[5:7], find_layout(int.from_bytes(raw[7:10], "little"))
    elif raw[0] == STX_V1 and len(raw) > 5:
        source, known = raw[3:5], find_layout(raw[5])
    else:
        return VEHICLE
    # An autopilot sends HIL controls; whoever sends other HIL messages simulates.
    if known is not None and known.name.startswith("HIL_") and known.name not in FROM_AUTOPILOT:
        simulators.add(source)
    to_vehicle = (
        source in simulators
        or source[0] >= FIRST_STATION
        or source[1] in STATION_COMPONENTS
        or source[1] == SIMULATOR_COMPONENT
    )
    return OTHERS if to_vehicle else VEHICLE
