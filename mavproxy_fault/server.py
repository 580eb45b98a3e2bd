"""The proxy as a process: links, clock and files around the core, whose sends it carries out.

One thread waits on all links and for the next due time. Links are drained in batches; nothing ever
blocks on a slow one. Recordings are flushed each second.
"""

import argparse
import contextlib
import ctypes
import select
import signal
import socket
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mavproxy_fault.core import Core
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.ports import LinkRole, Send
from mavproxy_fault.record import Recorder
from mavproxy_fault.stats import Latencies, table
from mavproxy_fault.tape import Tape

TEND_S = 0.1  # how often links get a chance to reconnect
FLUSH_S = 1.0
PR_SET_TIMERSLACK = 29  # <linux/prctl.h>; the default of 50 us makes every wait that late


class Server:
    """The loop; `core.links` are the roles of `links`, in the same order."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        *,
        tape: Tape | None = None,
        recorder: Recorder | None = None,
        busy_poll: bool = False,
    ) -> None:
        self.links = list(links)
        self.core = core
        self.tape = tape
        self.recorder = recorder
        self.latencies = [Latencies() for _ in links]
        self._busy_poll = busy_poll
        self._base_ns = time.time_ns() - time.monotonic_ns()
        self._stopping = False
        self._by_fd = {link.fileno(): number for number, link in enumerate(links)}
        self._tend_s = self._flush_s = 0.0

    def now_us(self) -> int:
        """Wall time that never jumps: Unix time at the start plus the monotonic clock."""
        return (self._base_ns + time.monotonic_ns()) // 1000

    def stop(self) -> None:
        """Leave the loop at its next turn."""
        self._stopping = True

    def run(self, wake: socket.socket | None = None) -> None:
        """Forward until stopped; `wake` becomes readable when a signal came."""
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
        descriptors = [*self._by_fd, *([wake.fileno()] if wake else [])]
        try:
            while not self._stopping:
                ready, _, _ = select.select(descriptors, (), (), self._patience_s())
                for descriptor in ready:
                    number = self._by_fd.get(descriptor)
                    if number is not None:
                        self._serve(number)
                self._keep_time()
        finally:
            self._finish()

    def _patience_s(self) -> float:
        """How long the loop may sleep."""
        if self._busy_poll:
            return 0.0
        due_us = self.core.next_due_us
        if due_us is None:
            return TEND_S
        return min(max(due_us - self.now_us(), 0) * 1e-6, TEND_S)

    def _serve(self, number: int) -> None:
        """Pass on what one link has."""
        link, core = self.links[number], self.core
        started_ns = time.monotonic_ns()
        now_us = (self._base_ns + started_ns) // 1000
        count = 0
        for stream, data in link.read():
            count += 1
            self._carry_out(core.received(number, data, now_us, stream=stream))
        if count:
            self.latencies[number].add(time.monotonic_ns() - started_ns, count)

    def _carry_out(self, sends: Sequence[Send]) -> None:
        links = self.links
        for send in sends:
            links[send.link].write(send.data)

    def _keep_time(self) -> None:
        due_us = self.core.next_due_us
        if due_us is not None and due_us <= (now_us := self.now_us()):
            self._carry_out(self.core.due(now_us))
        now_s = time.monotonic()
        if now_s >= self._tend_s:
            self._tend_s = now_s + TEND_S
            for number in range(len(self.links)):
                self._serve(number)
        if now_s >= self._flush_s:
            self._flush_s = now_s + FLUSH_S
            self._record()

    def _record(self) -> None:
        if self.recorder is not None and self.tape is not None:
            self.recorder.write(self.tape, self.core.take_labels())

    def _finish(self) -> None:
        now_us = self.now_us()
        self._carry_out(self.core.finish(now_us))
        self._record()
        if self.recorder is not None:
            self.recorder.close(self.core.clock.t0_us, now_us)

    def stats(self) -> list[dict[str, Any]]:
        """Counters and latency percentiles of every endpoint."""
        found = []
        for number, link in enumerate(self.links):
            counters, state = link.counters, self.core.states[number]
            parsed = self.core.parsed(number)
            found.append(
                {
                    "name": link.name,
                    "direction": self.core.links[number].direction,
                    "peers": link.peer_count,
                    "frames_in": state.frames,
                    "junk_in": state.junk,
                    "crc_errors": parsed.crc_errors,
                    "unknown": parsed.unknown,
                    "gaps": state.gaps,
                    "bytes_in": counters.bytes_in,
                    "chunks_in": counters.chunks_in,
                    "bytes_out": counters.bytes_out,
                    "chunks_out": counters.chunks_out,
                    "faulted": state.faulted,
                    "loops": state.loops,
                    "bad_signatures": state.bad_signatures,
                    "drops": counters.drops,
                    "errors": counters.errors,
                    **self.latencies[number].summary(),
                }
            )
        return found


def open_links(master: str, outs: Sequence[str]) -> list[Link]:
    """The vehicle's link and the others'; all closed again if one cannot be opened."""
    links: list[Link] = []
    try:
        links.append(open_link(master, plain_udp="udpin"))
        links += [open_link(out, plain_udp="udpout") for out in outs]
    except ValueError:
        for link in links:
            link.close()
        raise
    return links


def roles(links: Sequence[Link]) -> list[LinkRole]:
    """The first link is the vehicle's."""
    return [
        LinkRole(link.name, "to-vehicle" if number else "from-vehicle", link.datagrams)
        for number, link in enumerate(links)
    ]


@contextlib.contextmanager
def signals(server: Server) -> Iterator[socket.socket]:
    """Let SIGINT and SIGTERM stop the server; gives the socket that wakes it."""
    wake, woken = socket.socketpair()
    woken.setblocking(False)
    names = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(name, lambda *_: server.stop()) for name in names]
    descriptor = signal.set_wakeup_fd(woken.fileno(), warn_on_full_buffer=False)
    try:
        yield wake
    finally:
        signal.set_wakeup_fd(descriptor)
        for name, action in zip(names, before, strict=True):
            signal.signal(name, action)
        wake.close()
        woken.close()


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault proxy`."""
    engine = None
    session: dict[str, Any] = {"seed": None, "schedule": None}
    if args.schedule:
        from mavproxy_fault.engine import Engine
        from mavproxy_fault.schedule import read_schedule

        engine = Engine(read_schedule(args.schedule))
        session = {"seed": engine.seed, "schedule": Path(args.schedule).read_text()}
    links = open_links(args.master, args.out)
    tape = Tape() if args.logdir else None
    core = Core(roles(links), engine, tape=tape)
    session["links"] = [{"name": role.name, "direction": role.direction} for role in core.links]
    recorder = Recorder(Path(args.logdir), session) if args.logdir else None
    server = Server(links, core, tape=tape, recorder=recorder, busy_poll=args.busy_poll)
    with signals(server) as wake:
        print(
            f"ready: {links[0].name} <-> {', '.join(link.name for link in links[1:])}", flush=True
        )
        server.run(wake)
    print(table(server.stats()), flush=True)
    for link in links:
        link.close()
    return 0
