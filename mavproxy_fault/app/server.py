"""The proxy as a process: links, clock and files around the core, whose sends it carries out.

One thread waits on all links and for the next due time. Links are drained in batches; nothing ever
blocks on a slow one. Recordings are flushed each second. Most goes the compiled way
(`compiled.forwarder`), once its machine code is there.
"""

import ctypes
import gc
import logging
import select
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import datagram_batch
from mavproxy_fault.links.link import Link
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.proxy.statistics import LatencyHistogram, link_statistics

if TYPE_CHECKING:
    from concurrent.futures import Future

    from mavproxy_fault.compiled.forwarder import Forwarder
    from mavproxy_fault.live.session import LiveSession

LOG = logging.getLogger(__name__)
RECONNECT_S = 0.1  # how often links get a chance to reconnect
FLUSH_S = 1.0
RESERVE_BYTES = 8 << 20  # bytes given back to the system when it has no more for us
AHEAD_US = 300  # so long before a frame is due the loop does nothing but prepare to send it
EARLY_US = 250  # a sleep may end so late; the loop stays awake so long before that
BATCH_NS = 200_000  # what came together may wait so long to leave together, where peers are many
PR_SET_TIMERSLACK = 29  # <linux/prctl.h>; the default of 50 us makes every wait that late


class Server:
    """The loop; `core.links` are the roles of `links`, in the same order."""

    def __init__(
        self,
        links: Sequence[Link],
        core: Core,
        *,
        tape: CaptureBuffer | None = None,
        recorder: Recorder | None = None,
        busy_poll: bool = False,
    ) -> None:
        self.links = list(links)
        self.core = core
        self.tape = tape
        self.recorder = recorder
        self.latencies = [LatencyHistogram() for _ in links]
        # What is to leave by links that write several chunks to many peers at once (`write_all`).
        self._held: dict[int, list[bytes]] = {
            number: [] for number, link in enumerate(links) if hasattr(link, "write_all")
        }
        self._held_ns = 0  # since when; 0 if nothing is held
        self._busy_poll = busy_poll
        # One offset for the whole session: setting the system's clock moves no stamp.
        self._base_ns = time.time_ns() - time.monotonic_ns()
        self._stopping = False
        self._tend_s = self._flush_s = 0.0
        self._compiler: subprocess.Popen[bytes] | None = None
        self._forwarder: Forwarder | None = None
        self._wake: int | None = None
        self.live: LiveSession | None = None
        self.opening_live: Future[LiveSession] | None = (
            None  # live control that is still being opened
        )
        self.memory_shortages = 0  # how often the system gave no more memory
        self._reserve: bytearray | None = bytearray(RESERVE_BYTES)

    def now_us(self) -> int:
        """Wall time that never jumps: Unix time at the start plus the monotonic clock."""
        return (self._base_ns + time.monotonic_ns()) // 1000

    def stop(self) -> None:
        """Leave the loop at its next turn."""
        self._stopping = True

    def run(self, wake: socket.socket | None = None) -> None:
        """Forward until stopped; `wake` becomes readable when a signal came."""
        # Or every timed wait of this thread ends up to 50 us late.
        with suppress(AttributeError, TypeError):  # macOS, Windows
            ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
        self._wake = None if wake is None else wake.fileno()
        try:
            while not self._stopping:
                try:
                    self._step()
                except MemoryError:
                    self._shed()
        finally:
            self._reserve = None  # the end needs some memory, too
            self._finish()

    def _step(self) -> None:
        """Wait for whatever comes next, pass it on, and do what the clock asks for."""
        if self._forwarder is not None:
            self._step_compiled(self._forwarder)
        else:
            self._step_interpreted()
        self._keep_time()

    def _shed(self) -> None:
        """Go on with less where the system gives no more memory: without recording, at first.

        What was in hand at that moment is lost.
        """
        self._reserve = None
        if not self.memory_shortages:
            LOG.warning("no memory: what was in hand is lost, forwarding goes on")
        self.memory_shortages += 1
        self._give_up_tape("no memory")

    def _give_up_tape(self, why: str) -> None:
        """Let go of what waits to be recorded, and count it."""
        more = 0 if self._forwarder is None else self._forwarder.drop_tape()
        if self.recorder is not None and self.tape is not None:
            self.recorder.skip(self.tape, why, more)

    def _has_memory(self) -> bool:
        """Whether the reserve is there, or could be had again."""
        if self._reserve is None:
            with suppress(MemoryError):
                self._reserve = bytearray(RESERVE_BYTES)
        return self._reserve is not None

    def _waited(self) -> list[int]:
        """Descriptors to wait on besides the links."""
        wake = [] if self._wake is None else [self._wake]
        return wake + ([] if self.live is None else self.live.filenos())

    def _step_interpreted(self) -> None:
        """Wait for whatever comes next and pass it on."""
        # Asked each time, as live control and a link's connections may come and go.
        by_fd = {fd: number for number, link in enumerate(self.links) for fd in link.filenos()}
        ready, _, _ = select.select([*by_fd, *self._waited()], (), (), self._patience_s())
        # A link with several descriptors is read once.
        for number in dict.fromkeys(by_fd[fd] for fd in ready if fd in by_fd):
            self._serve(number)
        if self.live is not None and not by_fd.keys() >= set(ready):
            self.live.serve()

    def _step_compiled(self, forwarder: "Forwarder") -> None:
        """Let the compiled form forward until something is left to do here."""
        tend_ns, due_us = round(self._tend_s * 1e9), self.core.next_due_us
        # Frames that are due come first; else the next time to look after the links.
        due_ns = tend_ns if due_us is None else (due_us - AHEAD_US) * 1000 - self._base_ns
        if self._held_ns:  # the rest of the batch first, without a sleep behind it
            tend_ns = min(tend_ns, time.monotonic_ns() + BATCH_NS)
        # To the microsecond for frames that are due, not for housekeeping.
        forwarder.forward(min(tend_ns, due_ns), spin=self._busy_poll, precise=due_ns < tend_ns)
        if forwarder.pending:
            number, data, came_ns = forwarder.handed_over()
            if data:
                # It may have waited behind another of its batch while delayed frames left.
                now_us = max((self._base_ns + came_ns) // 1000, self.core.last_due_us)
                sends = self.core.received(number, data, now_us)
                self._carry_out(sends, hold=forwarder.pending)
                self.latencies[number].add(time.monotonic_ns() - came_ns)
        if not forwarder.pending:
            self._let_go()
        for number in forwarder.ready():
            self._serve(number)
        if self.live is not None and forwarder.wakes_ready:
            self.live.serve()

    def prepare(self) -> None:
        """Take the compiled form, or have it made by another process if this is the first time."""
        # Streams go through the interpreter anyway: loading machine code would gain nothing.
        if not any(link.datagrams for link in self.links) or not datagram_batch.HAS_RECVMMSG:
            return
        try:
            from mavproxy_fault.compiled import object_file as machine

            made = machine.load() is not None
        except (OSError, MemoryError) as error:  # as where `ulimit -v` is low
            _warn_interpreted(error)
            return
        if made:
            self.use_compiled()
        elif self._compiler is None:
            LOG.warning(
                "first start: machine code is being made, once, while all goes a slower way"
            )
            quiet = subprocess.DEVNULL  # it may outlive us: nobody must wait for its output to end
            self._compiler = subprocess.Popen(
                [sys.executable, "-m", machine.__name__],
                stdin=quiet, stdout=quiet, stderr=quiet,
                start_new_session=True,  # Ctrl-C ends us, not what the next start will need
            )  # fmt: skip

    def join(self, live: "LiveSession") -> None:
        """Let live control take part."""
        from mavproxy_fault.live.edit_log import JOIN, join_live_control

        self.live = live
        if live.edit_log is not None:
            live.edit_log.note(JOIN, b"", self.edit_time())
        join_live_control(self.core, live.control)
        gc.freeze()  # all that is loaded by now stays; to look it through would hold frames up
        # Not while frames that were handed over wait inside.
        if self._forwarder is not None and not self._forwarder.pending:
            self._forwarder.count()
            self.use_compiled()

    def _opened_live(self) -> "LiveSession | None":
        """Live control that was being opened; None, and a word, where the system refused it."""
        assert self.opening_live is not None
        coming, self.opening_live = self.opening_live, None
        error = coming.exception()
        if error is None:
            return coming.result()
        if isinstance(error, ConfigError):
            raise error
        # No descriptors, threads or memory, say: what passes must not suffer for it.
        LOG.error("no live control, forwarding goes on: %s: %s", type(error).__name__, error)
        return None

    def edit_time(self) -> int:
        """The vehicle's time, at which an edit may now be made; what is due leaves before."""
        now_us = self.now_us()
        # Edits and frames that are due keep their order, so that a replay can repeat it.
        self._carry_out(self.core.due(now_us))
        journal = None if self.live is None else self.live.edit_log
        return now_us if journal is None else journal.begin(now_us)

    def use_compiled(self) -> None:
        """Let the compiled form take over, or go on without it where there is no memory for it."""
        try:
            from mavproxy_fault.compiled.forwarder import Forwarder

            self._forwarder = Forwarder(
                self.links, self.core, self.latencies, self._base_ns,
                tape=self.tape, waited=self._waited(),
            )  # fmt: skip
        except (OSError, MemoryError) as error:
            self._forwarder = None
            _warn_interpreted(error)

    def _patience_s(self) -> float:
        """How long the loop may sleep."""
        if self._busy_poll:
            return 0.0
        # Never asleep: the lowest latency costs a core.
        due_us = self.core.next_due_us
        if due_us is None:
            return RECONNECT_S
        # Asleep until shortly before; the rest is waited for awake, as a sleep ends late.
        return min(max(due_us - self.now_us() - AHEAD_US - EARLY_US, 0) * 1e-6, RECONNECT_S)

    def _serve(self, number: int) -> None:
        """Pass on what one link has."""
        link, core = self.links[number], self.core
        started_ns = time.monotonic_ns()
        # One time for the batch: it was there when the loop awoke.
        now_us = (self._base_ns + started_ns) // 1000
        count = 0
        for stream, data in link.read():
            count += 1
            try:
                self._carry_out(core.received(number, data, now_us, stream=stream), hold=True)
            except MemoryError:  # here, so that the others of the batch are not lost with it
                self._shed()
        self._let_go()
        if count:
            self.latencies[number].add(time.monotonic_ns() - started_ns, count)

    def _carry_out(self, sends: Sequence[Send], *, hold: bool = False) -> None:
        """Send; with `hold` more is about to come, and what goes to many peers may wait for it."""
        links, held = self.links, self._held
        for send in sends:
            if send.link in held:
                held[send.link].append(send.data)
                self._held_ns = self._held_ns or time.monotonic_ns()
            else:
                links[send.link].write(send.data)
        if self._held_ns and not (hold and time.monotonic_ns() < self._held_ns + BATCH_NS):
            self._let_go()

    def _let_go(self) -> None:
        """Send what is held."""
        if not self._held_ns:
            return
        self._held_ns = 0
        for number, chunks in self._held.items():
            if chunks:
                link: Any = self.links[number]
                link.write_all(chunks)
                chunks.clear()

    def _keep_time(self) -> None:
        due_us = self.core.next_due_us
        if due_us is not None and due_us <= (now_us := self.now_us()) + AHEAD_US:
            # The rest of a frame may wait in the kernel if this process was late.
            for number in self.core.links_to_resync(now_us + AHEAD_US):
                self._serve(number)
            # What is sent does not depend on when it is asked for, so only the writing waits.
            sends = self.core.due(max(due_us, now_us))
            due_ns = due_us * 1000 - self._base_ns
            # The compiled form sends to the microsecond; without it this thread spins.
            if self._forwarder is None or not sends or not self._forwarder.send_at(due_ns, sends):
                while time.monotonic_ns() < due_ns:
                    pass
                self._carry_out(sends)
        now_s = time.monotonic()
        if now_s >= self._tend_s:
            self._tend_s = now_s + RECONNECT_S
            self._tend()
        if now_s >= self._flush_s:
            self._flush_s = now_s + FLUSH_S
            self.record()
        if self.live is not None:
            self.live.show(now_s)
        # Here, between two steps: the core knows no locks.
        if (
            self.opening_live is not None
            and self.opening_live.done()
            and (live := self._opened_live())
        ):
            self.join(live)

    def _tend(self) -> None:
        """Let links reconnect; take over what the compiled form has counted."""
        for number in range(len(self.links)):
            # Links that the compiled form does not serve, streams for example, are drained here.
            if self._forwarder is None or not self._forwarder.serves(number):
                self._serve(number)
        if self._forwarder is not None:
            self._forwarder.count()
        # 0 is an exit code: None means that it is still at work.
        elif self._compiler is not None and (code := self._compiler.poll()) is not None:
            self._compiler = None
            # Made: it is loaded like one that was there from the start.
            if code == 0:
                self.prepare()
            else:
                LOG.warning(
                    "no machine code (`mavproxy-fault warm-up` tells why): all goes a slower way"
                )

    def record(self) -> None:
        """Write and publish what has been gathered since the last time."""
        # Labels then stay where they are: whoever uses the core drains them.
        if self.recorder is None and self.live is None:
            return
        if not self._has_memory() and not self._stopping:
            self._give_up_tape("no memory")
            return
        labels = self.core.drain_labels()
        if self.recorder is not None and self.tape is not None:
            edits = [] if self.live is None else self.live.edits()
            self.recorder.write(self.tape, labels, edits)
        if self.live is not None:
            self.live.publish(self.stats(), labels)
            if self.recorder is not None:
                self.live.publish_recording(self.recorder.failing, self.recorder.lost)

    def _finish(self) -> None:
        now_us = self.now_us()
        if self._forwarder is not None:
            self._forwarder.count()
        # Delayed frames leave now; faults end and say what they did.
        self._carry_out(self.core.finish(now_us))
        if self.opening_live is not None:
            # Waits for an opening that is under way: it must be closed again.
            self.live = self._opened_live()
        self.record()
        if self.recorder is not None:
            self.recorder.close(self.core.clock.t0_us, now_us)
        if self.live is not None:
            self.live.close()

    def stats(self) -> list[dict[str, Any]]:
        """Counters and latency percentiles of every endpoint."""
        found = []
        for number, link in enumerate(self.links):
            counters = link.counters
            found.append(
                {
                    **link_statistics(self.core, number),
                    "name": link.name,
                    "peers": link.peer_count,
                    "bytes_in": counters.bytes_in,
                    "chunks_in": counters.chunks_in,
                    "bytes_out": counters.bytes_out,
                    "chunks_out": counters.chunks_out,
                    "drops": counters.drops,
                    "errors": counters.errors,
                    "refused": counters.refused,
                    "lost_in_kernel": getattr(link, "lost_in_kernel", 0),  # datagrams only
                    **self.latencies[number].summary(),
                }
            )
        return found


def _warn_interpreted(error: OSError | MemoryError) -> None:
    LOG.warning("no machine code, all goes a slower way: %s", error or "no memory")
