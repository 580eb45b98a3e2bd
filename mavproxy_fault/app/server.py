"""The event loop of the proxy process: links, clock and files around the core.

One thread waits for all links and for the next due time. Links are read in batches; a slow link
never blocks the others. Recordings are flushed every second. Once the kernels are compiled, most
frames take the compiled path (`compiled.forwarder`).
"""

import ctypes
import gc
import logging
import math
import select
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import udp
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
RECONNECT_S = 0.1  # interval between attempts to reconnect links
FLUSH_S = 1.0
RESERVE_BYTES = 8 << 20  # bytes released when the system is out of memory
PR_SET_TIMERSLACK = 29  # <linux/prctl.h>; the default of 50 us delays every wait


class Server:
    """The event loop; `core.links` are the roles of `links`, in the same order."""

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
        self._busy_poll = busy_poll
        # A constant offset, so that setting the system clock does not move timestamps.
        self._base_ns = time.time_ns() - time.monotonic_ns()
        self._stopping = False
        self._maintain_s = self._flush_s = 0.0
        self._sliced: list[Any] = []  # links that send in pieces
        self._resume_s = math.inf  # when the first pause between pieces ends
        self._compiler: subprocess.Popen[bytes] | None = None
        self._forwarder: Forwarder | None = None
        self._wake: int | None = None
        self.live: LiveSession | None = None
        self.opening_live: Future[LiveSession] | None = None  # live control being opened
        self.memory_shortages = 0  # number of times that memory ran out
        self._reserve: bytearray | None = bytearray(RESERVE_BYTES)

    def now_us(self) -> int:
        """Return wall time without jumps: Unix time at the start plus the monotonic clock."""
        return (self._base_ns + time.monotonic_ns()) // 1000

    def stop(self) -> None:
        """End the loop at its next iteration."""
        self._stopping = True

    def run(self, wake: socket.socket | None = None) -> None:
        """Forward until stopped; `wake` becomes readable when a signal arrives."""
        # Otherwise every timed wait of this thread ends up to 50 us late.
        with suppress(AttributeError, TypeError):  # macOS, Windows
            ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1)
        self._wake = None if wake is None else wake.fileno()
        try:
            while not self._stopping:
                try:
                    self._step()
                except MemoryError:
                    self._free_memory()
        finally:
            self._reserve = None  # shutting down needs memory too
            self._finish()

    def _step(self) -> None:
        """Wait for the next event, forward what arrived, and do what is due."""
        if self._forwarder is not None:
            self._step_compiled(self._forwarder)
        else:
            self._step_interpreted()
        self._run_due()

    def _free_memory(self) -> None:
        """Free memory after it ran out: the reserve and the unwritten recording.

        The data being processed at that moment is lost.
        """
        self._reserve = None
        if not self.memory_shortages:
            LOG.warning("out of memory: data in process is lost, forwarding continues")
        self.memory_shortages += 1
        self._discard_recording("no memory")

    def _discard_recording(self, why: str) -> None:
        """Discard the unwritten recording and count it as lost."""
        extra = 0 if self._forwarder is None else self._forwarder.drop_tape()
        if self.recorder is not None and self.tape is not None:
            self.recorder.skip(self.tape, why, extra)

    def _has_memory(self) -> bool:
        """Whether the memory reserve exists or can be allocated again."""
        if self._reserve is None:
            with suppress(MemoryError):
                self._reserve = bytearray(RESERVE_BYTES)
        return self._reserve is not None

    def _extra_descriptors(self) -> list[int]:
        """Return the descriptors to wait on besides the links."""
        wake = [] if self._wake is None else [self._wake]
        return wake + ([] if self.live is None else self.live.filenos())

    def _step_interpreted(self) -> None:
        """Wait for the next event and forward what arrived, on the interpreted path."""
        # Collected each time, since connections come and go.
        by_fd = {fd: number for number, link in enumerate(self.links) for fd in link.filenos()}
        watched = [*by_fd, *self._extra_descriptors()]
        ready, _, _ = select.select(watched, (), (), self._sleep_limit_s())
        # A link with several descriptors is read once.
        for number in dict.fromkeys(by_fd[fd] for fd in ready if fd in by_fd):
            self._serve(number)
        if self.live is not None and not by_fd.keys() >= set(ready):
            self.live.serve()

    def _step_compiled(self, forwarder: "Forwarder") -> None:
        """Forward on the compiled path until something must be handled in Python."""
        # Until the core has something due, or the next maintenance of the links.
        due_ns = self.core.own_due_us * 1000 - self._base_ns
        maintain_ns = round(min(self._maintain_s, self._resume_s) * 1e9)
        forwarder.forward(min(maintain_ns, due_ns), spin=self._busy_poll)
        self._send_all(forwarder.take_sends())
        for number in forwarder.ready():
            self._serve(number)
        if self.live is not None and forwarder.wakes_ready:
            self.live.serve()

    def prepare(self) -> None:
        """Load the compiled kernels; at first use, compile them in another process."""
        if not udp.IS_LINUX:
            return
        try:
            from mavproxy_fault.compiled import object_file as kernels

            loaded = kernels.load() is not None
        except (OSError, MemoryError) as error:  # for example with a low `ulimit -v`
            _warn_interpreted(error)
            return
        if loaded:
            self.use_compiled()
        elif self._compiler is None:
            LOG.warning("compiling kernels (first use only); forwarding is slower until then")
            devnull = subprocess.DEVNULL  # it may outlive us, and a reader would wait for it
            self._compiler = subprocess.Popen(
                [sys.executable, "-P", "-m", kernels.__name__],
                stdin=devnull, stdout=devnull, stderr=devnull,
                start_new_session=True,  # so that Ctrl-C does not end the compilation
            )  # fmt: skip

    def join(self, live: "LiveSession") -> None:
        """Attach live control."""
        from mavproxy_fault.live.edit_log import JOIN, join_live_control

        self.live = live
        if live.edit_log is not None:
            live.edit_log.note(JOIN, b"", self.edit_time())
        join_live_control(self.core, live.control)
        gc.freeze()  # excludes loaded modules from later collections, which delay frames
        if self._forwarder is not None:
            self._forwarder.count()
            self.use_compiled()

    def _take_opened_live(self) -> "LiveSession | None":
        """Return the opened live control; None, with a log line, if the system refused it."""
        assert self.opening_live is not None
        coming, self.opening_live = self.opening_live, None
        error = coming.exception()
        if error is None:
            return coming.result()
        if isinstance(error, ConfigError):
            raise error
        # For example no descriptors, threads or memory: forwarding must continue.
        LOG.error("no live control, forwarding continues: %s: %s", type(error).__name__, error)
        return None

    def edit_time(self) -> int:
        """Send the frames that are due, then return the vehicle's time for an edit."""
        now_us = self.now_us()
        # Edits and due frames keep their order, so that a replay can repeat it.
        self._send_all(self.core.due(now_us))
        edits = None if self.live is None else self.live.edit_log
        return now_us if edits is None else edits.begin(now_us)

    def use_compiled(self) -> None:
        """Switch to the compiled path; stay on the interpreted one without the memory for it."""
        try:
            from mavproxy_fault.compiled.forwarder import Forwarder

            self._forwarder = Forwarder(
                self.links, self.core, self.latencies, self._base_ns,
                tape=self.tape, waited=self._extra_descriptors(),
            )  # fmt: skip
        except (OSError, MemoryError) as error:
            self._forwarder = None
            _warn_interpreted(error)

    def _sleep_limit_s(self) -> float:
        """Return how long the loop may sleep [s]."""
        if self._busy_poll:
            return 0.0
        due_us = self.core.next_due_us
        wait_s = RECONNECT_S if due_us is None else max(due_us - self.now_us(), 0) * 1e-6
        return min(wait_s, RECONNECT_S, max(self._resume_s - time.monotonic(), 0.0))

    def _serve(self, number: int) -> None:
        """Forward what one link has received."""
        link, core = self.links[number], self.core
        started_ns = time.monotonic_ns()
        # One arrival time for the batch.
        now_us = (self._base_ns + started_ns) // 1000
        receive = core.received if self._forwarder is None else self._forwarder.received
        count = 0
        for stream, data in link.read():
            count += 1
            try:
                self._send_all(receive(number, data, now_us, stream=stream))
            except MemoryError:  # here, to keep the rest of the batch
                self._free_memory()
        if count:
            self.latencies[number].add(time.monotonic_ns() - started_ns, count)

    def _send_all(self, sends: Sequence[Send]) -> None:
        for send in sends:
            self.links[send.link].write(send.data)

    def _run_due(self) -> None:
        due_us = self.core.next_due_us
        if due_us is not None and due_us <= (now_us := self.now_us()):
            # After a delay of this process, the rest of a frame may wait in the kernel.
            for number in self.core.links_to_resync(now_us):
                self._serve(number)
            self._send_all(self.core.due(now_us))
        if self._sliced:
            self._resume_s = min(link.flush() for link in self._sliced)
        now_s = time.monotonic()
        if now_s >= self._maintain_s:
            self._maintain_s = now_s + RECONNECT_S
            self._maintain_links()
        if now_s >= self._flush_s:
            self._flush_s = now_s + FLUSH_S
            self.record()
        if self.live is not None:
            self.live.show(now_s)
        # Between two steps, since the core has no locks.
        if (
            self.opening_live is not None
            and self.opening_live.done()
            and (live := self._take_opened_live())
        ):
            self.join(live)

    def _maintain_links(self) -> None:
        """Let links reconnect or be interrupted, and collect the counters of the compiled path."""
        engine: Any = self.core.engine
        ways = {} if engine is None else engine.interrupted
        self._sliced, self._resume_s = [], math.inf
        for number, link in enumerate(self.links):
            interrupt: Any = getattr(link, "interrupt", None)
            if interrupt is not None:
                how = next((ways[one] for one in ways if one >> number & 1), "kept")
                interrupt(how)
                self._sliced += [link] if isinstance(how, tuple) else []
        for number in range(len(self.links)):
            # Links outside the compiled path, such as streams, are read here.
            if self._forwarder is None or not self._forwarder.serves(number):
                self._serve(number)
        if self._forwarder is not None:
            self._forwarder.count()
        # None means that the compiler is still running.
        elif self._compiler is not None and (code := self._compiler.poll()) is not None:
            self._compiler = None
            # Success: load the kernels.
            if code == 0:
                self.prepare()
            else:
                LOG.warning(
                    "compiling kernels failed, forwarding is slower; run `mavproxy-fault warm-up`"
                )

    def record(self) -> None:
        """Record and publish the data since the last call."""
        # Without either, the labels are left to the user of the core.
        if self.recorder is None and self.live is None:
            return
        if not self._has_memory() and not self._stopping:
            self._discard_recording("no memory")
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
        # Send the delayed frames; end the faults, which write their labels.
        self._send_all(self.core.finish(now_us))
        if self.opening_live is not None:
            # Wait for it, since it must be closed.
            self.live = self._take_opened_live()
        self.record()
        if self.recorder is not None:
            self.recorder.close(self.core.clock.t0_us, now_us)
        if self.live is not None:
            self.live.close()

    def stats(self) -> list[dict[str, Any]]:
        """Return counters and latency percentiles of every endpoint."""
        endpoints = []
        for number, link in enumerate(self.links):
            endpoints.append(
                {
                    **link_statistics(self.core, number),
                    "name": link.name,
                    "peers": link.peer_count,
                    **asdict(link.counters),
                    "lost_in_kernel": getattr(link, "lost_in_kernel", 0),  # datagrams only
                    **self.latencies[number].summary(),
                }
            )
        return endpoints


def _warn_interpreted(error: OSError | MemoryError) -> None:
    LOG.warning("no compiled kernels, forwarding is slower: %s", error or "out of memory")
