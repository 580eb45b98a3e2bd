"""Replay: run a tlog through the proxy's core to another tlog, or in real time to a link.

A `received.tlog` of the proxy with its index, session and edit log reproduces `sent.tlog` byte for
byte with the session's schedule, which is the default. With another schedule the edits are ignored.
"""

import argparse
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import msgspec

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.proxy_command import read_signing
from mavproxy_fault.app.recorder import encode_lines
from mavproxy_fault.app.replaying.playback import LogRecord, LogSource, open_log
from mavproxy_fault.app.replaying.rinex_faults import is_rinex, replay_rinex
from mavproxy_fault.documents.atomic_file import replace_file, write_all
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.faults.plant_fault import SimulatorFault
from mavproxy_fault.links.descriptors import wait_until_readable
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.edit_log import RFLYSIM, apply_edit
from mavproxy_fault.live.rflysim import DEFAULT_MAP, read_map
from mavproxy_fault.proxy.capture_buffer import KEY_MESSAGE, CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.schedule.entries import Schedule, parse_schedule, read_schedule
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.signing import Signing

FLUSH_BYTES = 1 << 20
PAUSE_S = 0.1


class LogReplay:
    """The core that processes a log, and the recorded edits still to be applied."""

    def __init__(
        self,
        source: LogSource,
        schedule: Schedule,
        tape: CaptureBuffer | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.source = source
        self.repeats = _recorded_with(source, schedule)
        self._edits = deque(source.edits if self.repeats else ())
        engine = Engine(schedule)
        # A session without a schedule had no engine until live control was attached.
        starts_late = bool(self._edits) and source.session["schedule"] is None
        self.core = Core(source.roles, None if starts_late else engine, signing=signing, tape=tape)
        rflysim = None
        if any(edit.what == RFLYSIM for edit in self._edits):
            rflysim = read_map(source.session.get("rflysim_map", DEFAULT_MAP))
        # Sessions without the key allowed live faults.
        allowed = source.session.get("inject", True)
        self._control = LiveControl(engine, allowed=allowed, rflysim=rflysim, folders=None)
        self._count = self._newest_us = 0

    def push(self, record: LogRecord) -> list[Send]:
        """Process one record after the edits before it; return what is sent."""
        sends = self._apply_due_edits()
        self._count += 1
        # The clocks of a merged log may go back; the end is the newest time.
        self._newest_us = max(self._newest_us, record.t_us)
        return sends + self.core.received(record.link, record.raw, record.t_us)

    def _apply_due_edits(self) -> list[Send]:
        """Apply the edits that precede the next record."""
        sends = []
        while self._edits and self._edits[0].at <= self._count:
            edit = self._edits.popleft()
            # Frames due before the edit are sent first, as in the session.
            sends += self.core.due(edit.now_us)
            apply_edit(edit, self.core, self._control)
        return sends

    def rest(self) -> Iterator[list[Send]]:
        """Yield what is sent after the last record, up to the recorded end if there is one."""
        yield self._apply_due_edits()
        end_us = self.source.end_us
        # Without a recorded end, until the last delayed frame has been sent.
        while end_us is None and (due_us := self.core.next_due_us) is not None:
            self._newest_us = max(self._newest_us, due_us)
            yield self.core.due(self._newest_us)
        # A recorded end flushes delayed frames as the session's end did.
        yield self.core.finish(end_us or self._newest_us)


def _recorded_with(source: LogSource, schedule: Schedule) -> bool:
    """Whether a session was recorded with this schedule, whatever its notation."""
    if "schedule" not in source.session:
        return False
    return _without_notation(recorded_schedule(source)) == _without_notation(schedule)


def _without_notation(schedule: Schedule) -> Schedule:
    # Comments and the order of keys do not matter.
    entries = tuple(msgspec.structs.replace(entry, written={}) for entry in schedule.faults)
    return msgspec.structs.replace(schedule, faults=entries)


def recorded_schedule(source: LogSource) -> Schedule:
    """Return the schedule that a session was recorded with.

    Raises
    ------
    ConfigError
        If the log has no session.
    """
    if "schedule" not in source.session:
        raise ConfigError("replay: there is no session.json beside the log; give --schedule FILE")
    return parse_schedule(source.session["schedule"] or {}, "session.json")


def replay_to_log(playing: LogReplay, tape: CaptureBuffer, out: Path) -> Path:
    """Write the sent frames to a tlog, and the labels to `NAME.labels.jsonl` beside it."""
    labels_path = out.with_suffix(".labels.jsonl")
    with replace_file(out) as log, replace_file(labels_path) as labels:
        for record in playing.source.records:
            playing.push(record)
            write_all(labels, encode_lines(_labels(playing)))
            # In portions, since a log of hours may not fit in memory twice.
            if len(tape.sent) >= FLUSH_BYTES:
                write_all(log, tape.drain().sent)
        for _ in playing.rest():
            pass
        write_all(labels, encode_lines(_labels(playing)))
        write_all(log, tape.drain().sent)
    return labels_path


def _labels(playing: LogReplay) -> list[Label]:
    """Return the labels since the last call.

    They are marked as applied to a recording, in which the vehicle could not react to the faults,
    unless the replay repeats the session with its own schedule.
    """
    labels = playing.core.drain_labels()
    if playing.repeats:
        return labels
    return [msgspec.structs.replace(label, recorded=True) for label in labels]


def replay_to_link(playing: LogReplay, link: Link) -> int:
    """Send at the pace of the log and return the number of frames or datagrams sent.

    A server link first waits for its first peer.
    """
    # Without a peer, the replay would be lost.
    while not link.peer_count:
        _pause(link, PAUSE_S)
    core = playing.core
    start_s, first_us, sent = time.monotonic(), -1, 0

    def wait_for(t_us: int) -> None:
        # In slices, to read the peer's bytes meanwhile.
        while (rest_s := start_s + (t_us - first_us) * 1e-6 - time.monotonic()) > 0:
            _pause(link, min(rest_s, PAUSE_S))

    def write(sends: list[Send]) -> int:
        for send in sends:
            wait_for(send.due_us)
            # Its key is zeros in a log, which would turn signing off.
            if send.data[7:10] != KEY_MESSAGE:
                link.write(send.data)
        return len(sends)

    for record in playing.source.records:
        first_us = record.t_us if first_us < 0 else first_us
        # Delayed frames are due between records.
        while (due_us := core.next_due_us) is not None and due_us <= record.t_us:
            sent += write(core.due(due_us))
        wait_for(record.t_us)
        sent += write(playing.push(record))
    return sent + sum(write(sends) for sends in playing.rest())


def _pause(link: Link, wait_s: float) -> None:
    """Wait, and discard what the peer sends meanwhile."""
    # Unread bytes would fill the kernel's buffer.
    wait_until_readable([link], wait_s)
    link.read()


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault replay`."""
    path = Path(args.log)
    if is_rinex(path):
        return replay_rinex(args)
    source = open_log(path)
    schedule = read_schedule(args.schedule) if args.schedule else recorded_schedule(source)
    tape = CaptureBuffer() if args.out else None
    playing = LogReplay(source, schedule, tape, read_signing(args))
    for entry in () if playing.repeats else schedule.faults:
        if isinstance(entry.fault, SimulatorFault):
            print(
                f"replay: {entry.name} on {', '.join(entry.targets)} changes nothing in a log, "
                "as only the simulator can apply it; use run, or target the field of a message",
                file=sys.stderr,
            )
    if tape is not None:
        out = Path(args.out)
        # By file identity, since a link may have another name.
        if out.exists() and out.samefile(path):
            raise ConfigError(f"{out}: is the replayed log itself; give another file")
        with users_path(f"--out {out}", "give a file that can be written"):
            out.parent.mkdir(parents=True, exist_ok=True)
            labels = replay_to_log(playing, tape, out)
        print_result(args, {"log": out, "labels": labels}, f"{out}\n{labels}")
        return 0
    link = open_link(args.link, bare_udp="udpout")
    try:
        count = replay_to_link(playing, link)
        print_result(args, {"frames": count, "link": link.name}, f"{count} sent to {link.name}")
    finally:
        link.close()
    return 0
