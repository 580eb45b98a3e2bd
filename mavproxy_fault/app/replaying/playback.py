"""Reads logs for a replay: every record with its timestamp and the link it arrived on.

The links of the proxy's own `received.tlog` are in its index and `session.json`. In any other tlog
the sender gives the direction: ground stations (systems from 240 on, components 190 to 194) and
simulators (component 51, and senders of HIL sensors) send to the vehicle, all others are the
vehicle. Bytes that are not a frame belong to the record before them.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mavproxy_fault.app.recorder import EDITS, INDEX, RECEIVED, RECEIVED_OTHER, SESSION
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.control import FIRST_STATION
from mavproxy_fault.live.edit_log import Edit, read_edits
from mavproxy_fault.proxy.capture_buffer import INDEX as INDEX_RECORD
from mavproxy_fault.proxy.capture_buffer import LENGTH, STAMP
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.sender_rules import MAX_STAMP_US
from mavproxy_fault.wire.dialect import find_layout
from mavproxy_fault.wire.frame import HEADER_V2, STX_V1, STX_V2, frame_header

VEHICLE, OTHERS = 0, 1
ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("others", "to-vehicle"))
STATION_COMPONENTS = range(190, 195)  # MAV_COMP_ID_MISSIONPLANNER and its neighbours
SIMULATOR_COMPONENT = 51
FROM_AUTOPILOT = ("HIL_ACTUATOR_CONTROLS", "HIL_CONTROLS")
NEAR_US = 86_400_000_000  # chosen: consecutive records lie within a day


class LogRecord(NamedTuple):
    """One record of a log, with arrival time and link."""

    t_us: int
    link: int
    raw: bytes


class LogSource(NamedTuple):
    """A log to replay, with its recorded session and live edits (empty for a foreign log)."""

    roles: tuple[LinkRole, ...]
    records: Iterator[LogRecord]
    session: dict[str, Any]
    edits: tuple[Edit, ...] = ()

    @property
    def end_us(self) -> int | None:
        """Wall time [us] at the end of the session; None if not recorded."""
        return self.session.get("end_us")


def open_log(path: Path) -> LogSource:
    """Open a log with its session, or a foreign log with inferred directions.

    Raises
    ------
    ConfigError
        If the file does not exist or contains no record.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: is not a file; give a tlog")
    session, index = path.with_name(SESSION), path.with_name(INDEX)
    # Without index or session the log is treated as foreign.
    if path.name == RECEIVED and session.is_file() and index.is_file():
        session_data: dict[str, Any] = json.loads(session.read_text())
        roles = tuple(LinkRole(link["name"], link["direction"]) for link in session_data["links"])
        edits = read_edits(path.with_name(EDITS))
        return LogSource(roles, _indexed_records(path, index), session_data, tuple(edits))
    data = path.read_bytes()
    if _find_record(data, 0, None) is None:
        raise ConfigError(f"{path}: contains no MAVLink record; give a tlog")
    return LogSource(ROLES, _foreign_records(data), {})


def _indexed_records(path: Path, index: Path) -> Iterator[LogRecord]:
    with (
        path.open("rb") as log,
        path.with_name(RECEIVED_OTHER).open("rb") as other,
        index.open("rb") as entries,
    ):
        # A truncated index entry ends the session.
        while len(entry := entries.read(INDEX_RECORD.size)) == INDEX_RECORD.size:
            link, is_other, length = INDEX_RECORD.unpack(entry)
            # A timestamp precedes every record in both files.
            stamp = (other if is_other else log).read(STAMP.size)
            raw = other.read(LENGTH.size + length)[LENGTH.size :] if is_other else log.read(length)
            # The process was killed while writing, or the file is corrupted.
            if len(raw) < length or (t_us := STAMP.unpack(stamp)[0]) >= MAX_STAMP_US:
                return
            yield LogRecord(t_us, link, raw)


def _foreign_records(data: bytes) -> Iterator[LogRecord]:
    simulators: set[bytes] = set()
    for t_us, raw in split_records(data):
        yield LogRecord(t_us, _link_of(raw, simulators), raw)


def split_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield timestamp and bytes of each record; all bytes after the first timestamp are kept."""
    at = _find_record(data, 0, None)
    while at is not None and len(data) - at > STAMP.size:
        t_us = STAMP.unpack_from(data, at)[0]
        body = at + STAMP.size
        end = _record_end(data, body)
        after = _find_record(data, end, t_us)
        # All that follows the last record found is taken as bytes.
        stop = len(data) if after is None else after
        yield t_us, data[body : min(end, stop)]
        if stop > end:
            yield t_us, data[end:stop]
        at = after


def _record_end(data: bytes, at: int) -> int:
    _, _, end = frame_header(data, at, len(data))
    # Without a valid header the record extends to the end of the file.
    return min(end, len(data)) or len(data)


def _find_record(data: bytes, start: int, t_us: int | None) -> int | None:
    """Return the next offset from `start` on that looks like a record."""
    for at in range(start, len(data) - STAMP.size):
        if data[at + STAMP.size] not in (STX_V1, STX_V2):
            # One byte rules out most offsets.
            continue
        (stamp,) = struct.unpack_from(">Q", data, at)
        if stamp >= MAX_STAMP_US or (t_us is not None and abs(stamp - t_us) > NEAR_US):
            # An implausible timestamp is a chance pattern in a payload.
            continue
        end = _record_end(data, at + STAMP.size)
        # A start byte may occur anywhere, so the next record must begin where this one ends;
        # the last record has no successor.
        if end + STAMP.size >= len(data) or data[end + STAMP.size] in (STX_V1, STX_V2):
            return at
        # Directly after the previous record: accepted even if what follows is corrupted.
        if at == start and t_us is not None:
            return at
    return None


def _link_of(raw: bytes, simulators: set[bytes]) -> int:
    head, number, _ = frame_header(raw, 0, len(raw))
    if head == 0:  # without a complete header, sender and message are unknown
        return VEHICLE
    place = 5 if head == HEADER_V2 else 3
    source, known = raw[place : place + 2], find_layout(number)
    # An autopilot sends HIL controls; a sender of other HIL messages is a simulator.
    if known is not None and known.name.startswith("HIL_") and known.name not in FROM_AUTOPILOT:
        simulators.add(source)
    to_vehicle = (
        source in simulators
        or source[0] >= FIRST_STATION
        or source[1] in STATION_COMPONENTS
        or source[1] == SIMULATOR_COMPONENT
    )
    return OTHERS if to_vehicle else VEHICLE
