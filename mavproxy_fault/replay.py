"""Replay: a tlog through the proxy's core, to another tlog or in real time to a link.

A `received.tlog` of the proxy lies beside its index and `session.json`; with them, the same
schedule and the same seed, the replay writes `sent.tlog` again byte for byte. In any other tlog
the direction of a frame is told by its sender: ground stations (systems from 240 on, components
190 to 194), simulators (component 51, and whoever sends HIL sensors) talk to the vehicle,
everything else comes from it.
"""

import argparse
import json
import select
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mavproxy_fault.core import Core
from mavproxy_fault.engine import Engine
from mavproxy_fault.errors import ConfigError
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.ports import LinkRole, Send
from mavproxy_fault.record import INDEX, RECEIVED, SESSION, encoded
from mavproxy_fault.schedule import read_schedule
from mavproxy_fault.tape import INDEX as INDEX_RECORD
from mavproxy_fault.tape import STAMP, Tape
from mavproxy_fault.wire.dialect import Layout

VEHICLE, OTHERS = 0, 1
ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("others", "to-vehicle"))
FIRST_STATION = 240  # systems; MAVSDK is 245, QGroundControl and MAVProxy are 255
STATION_COMPONENTS = range(190, 195)  # MAV_COMP_ID_MISSIONPLANNER and its neighbours
SIMULATOR_COMPONENT = 51
FROM_AUTOPILOT = ("HIL_ACTUATOR_CONTROLS", "HIL_CONTROLS")
FLUSH_BYTES = 1 << 20
TEND_S = 0.1


class Record(NamedTuple):
    """One record of a log: when and on which link it came."""

    t_us: int
    link: int
    raw: bytes


class Source(NamedTuple):
    """A log as the core needs it; `end_us` is when the session ended, if that was recorded."""

    roles: tuple[LinkRole, ...]
    records: Iterator[Record]
    end_us: int | None


def open_log(path: Path) -> Source:
    """A log with its session, or one from elsewhere with directions guessed.

    Raises
    ------
    ConfigError
        If there is no such file.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: is not a file; allowed: a tlog")
    session, index = path.with_name(SESSION), path.with_name(INDEX)
    if path.name == RECEIVED and session.is_file() and index.is_file():
        said: dict[str, Any] = json.loads(session.read_text())
        roles = tuple(LinkRole(link["name"], link["direction"]) for link in said["links"])
        return Source(roles, _indexed(path, index), said.get("end_us"))
    return Source(ROLES, _foreign(path), None)


def _indexed(path: Path, index: Path) -> Iterator[Record]:
    with path.open("rb") as log, index.open("rb") as entries:
        while len(entry := entries.read(INDEX_RECORD.size)) == INDEX_RECORD.size:
            link, length = INDEX_RECORD.unpack(entry)
            data = log.read(STAMP.size + length)
            if len(data) < STAMP.size + length:
                return
            yield Record(STAMP.unpack_from(data)[0], link, data[STAMP.size :])


def _foreign(path: Path) -> Iterator[Record]:
    from mavproxy_fault.wire.tlog import read_records

    simulators: set[bytes] = set()
    for t_us, raw, layout in read_records(path):
        yield Record(t_us, _link_of(raw, layout, simulators), raw)


def _link_of(raw: bytes, layout: Layout | None, simulators: set[bytes]) -> int:
    source = raw[5:7] if raw[0] == 0xFD else raw[3:5]
    if layout is not None and layout.name.startswith("HIL_") and layout.name not in FROM_AUTOPILOT:
        simulators.add(source)
    to_vehicle = (
        source in simulators
        or source[0] >= FIRST_STATION
        or source[1] in STATION_COMPONENTS
        or source[1] == SIMULATOR_COMPONENT
    )
    return OTHERS if to_vehicle else VEHICLE


def play(source: Source, engine: Engine, tape: Tape) -> Iterator[tuple[Core, list[Send]]]:
    """Push a log through a core, a step per record, then let everything delayed leave."""
    core = Core(source.roles, engine, tape=tape)
    newest_us = 0
    for record in source.records:
        newest_us = max(newest_us, record.t_us)
        yield core, core.received(record.link, record.raw, record.t_us)
    if source.end_us is None:
        while core.next_due_us is not None:
            newest_us = max(newest_us, core.next_due_us)
            yield core, core.due(newest_us)
    yield core, core.finish(source.end_us or newest_us)


def to_log(source: Source, engine: Engine, out: Path) -> Path:
    """Write what is sent to a tlog and the labels beside it, as `NAME.labels.jsonl`."""
    tape = Tape()
    labels_path = out.with_suffix(".labels.jsonl")
    with out.open("wb") as log, labels_path.open("wb") as labels:
        for core, _ in play(source, engine, tape):
            if len(tape.sent) >= FLUSH_BYTES:
                log.write(tape.take()[1])
            labels.write(encoded(core.take_labels()))
        log.write(tape.take()[1])
    return labels_path


def to_link(
    source: Source,
    engine: Engine,
    link: Link,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send at the pace of the log; gives the number of frames or datagrams sent.

    A server waits for its first peer.
    """
    while not link.peer_count:
        _pause(link, TEND_S)
    core = Core(source.roles, engine)
    start_s, first_us, sent = clock(), -1, 0

    def wait_for(t_us: int) -> None:
        while (rest_s := start_s + (t_us - first_us) * 1e-6 - clock()) > 0:
            _pause(link, min(rest_s, TEND_S))

    def write(sends: list[Send]) -> int:
        for send in sends:
            wait_for(send.due_us)
            link.write(send.data)
        return len(sends)

    for record in source.records:
        first_us = record.t_us if first_us < 0 else first_us
        while (due_us := core.next_due_us) is not None and due_us <= record.t_us:
            sent += write(core.due(due_us))
        wait_for(record.t_us)
        sent += write(core.received(record.link, record.raw, record.t_us))
    while (due_us := core.next_due_us) is not None:
        sent += write(core.due(due_us))
    return sent


def _pause(link: Link, wait_s: float) -> None:
    """Wait, and drain what the peer sends meanwhile."""
    select.select([link], (), (), wait_s)
    link.read()


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault replay`."""
    engine = Engine(read_schedule(args.schedule))
    path = Path(args.log)
    source = open_log(path)
    if args.out:
        out = Path(args.out)
        if out.exists() and out.samefile(path):
            raise ConfigError(f"{out}: is the log that is replayed; allowed: another file")
        labels = to_log(source, engine, out)
        print(f"{out}\n{labels}")
        return 0
    link = open_link(args.link, plain_udp="udpout")
    try:
        print(f"{to_link(source, engine, link)} sent to {link.name}")
    finally:
        link.close()
    return 0
