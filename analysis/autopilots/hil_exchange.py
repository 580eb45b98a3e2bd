"""Pass frames between the simulator's lockstep loop and an autopilot through the proxy's core.

Faults act on the frames of both directions, in compiled code where it supports them
(`compiled.passage`). The core's wall clock is simulated time: a delay is in vehicle time, however
fast the flight is. The loop does not wait for what a fault withholds: if no frame of a step has
reached the autopilot, no answer is expected.
"""

import select
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from analysis.run.proxied_flight import GROUND, SIMULATOR, VEHICLE, ProxiedFlight, is_hil_frame
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Chunk, Link
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.wire.dialect import find_layout, message_layout
from mavproxy_fault.wire.frame import CRC_LENGTH, HEADER_V2, STX_V2, Frame
from mavproxy_fault.wire.parser import Parser, walk_frames
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.sensors.readings import Reading

SendListener = Callable[[list[Send]], None]  # receives the frames for monitor and ground station
STAMP_BYTES = slice(10, 18)  # time_usec in every message that steps the autopilot
STEP_REPLY = message_layout("HIL_ACTUATOR_CONTROLS")
STEP_REPLY_ID = STEP_REPLY.id.to_bytes(3, "little")
BATTERY = message_layout("BATTERY_STATUS").id
SIMULATOR_MESSAGES = {STEP_REPLY.id, message_layout("TUNNEL").id}


class StepMessage(NamedTuple):
    """The message that steps an autopilot: its id, with a payload shorter than `below_bytes`."""

    number: int
    below_bytes: int


PX4_STEP = StepMessage(107, 65)  # HIL_SENSOR of instance 0: its last byte, the id, is cut off
BRIDGE_STEP = StepMessage(115, 256)  # HIL_STATE_QUATERNION


def is_step_reply(data: bytes) -> bool:
    """Whether a frame is an autopilot's answer to a step."""
    return data[0] == STX_V2 and data[7:10] == STEP_REPLY_ID


def is_single_step_reply(data: bytes) -> bool:
    """Whether complete frames are a single one that answers a step."""
    return is_step_reply(data) and len(data) == HEADER_V2 + data[1] + CRC_LENGTH


def is_lockstep_traffic(data: bytes) -> bool:
    """Whether frames belong to the HIL lockstep, which no ground station needs."""
    return is_hil_frame(data) or is_single_step_reply(data)


def split_frames(data: bytes) -> list[bytes]:
    """Return the complete frames that bytes begin with."""
    return [data[start:end] for start, end, _ in walk_frames(data)]


class AutopilotSender:
    """The packer of the lockstep loop: returns frames as they leave the proxy.

    `listener` receives the frames for monitor and ground station; `commands` returns a ground
    station's frames for the next step, and is called while the autopilot computes. These leave on
    `telemetry`, without it on the HIL link. Without a `passage`, the compiled form of the core,
    every frame takes the interpreted path.

    `step_us` is the timestamp in the last frames that the autopilot answers, if any; `returned` are
    frames for the simulator in between: changes of the plant, and late answers; `undelivered` are
    sends to other links, delivered while the autopilot computes the step.
    """

    def __init__(
        self,
        flight: ProxiedFlight,
        packer: HilPacker,
        listener: SendListener,
        commands: Callable[[], list[bytes]] = list,
        telemetry: Link | None = None,
        step: StepMessage = PX4_STEP,
        passage: Passage | None = None,
    ) -> None:
        self.start_us = packer.start_us
        self.step_us: int | None = None
        self.returned: list[Frame] = []
        self.undelivered: list[Send] = []
        self.flight, self._listener = flight, listener
        self._packer, self._commands = packer, commands
        self._telemetry, self._step, self._passage = telemetry, step, passage
        self._parser = Parser()
        self._proxy_answers: list[bytes] = []  # the proxy's own answers to the autopilot
        self._pending_commands: list[bytes] = []  # of a ground station, for the next step
        self._step_sent = False  # whether a step has left since the last call of `commands`

    def frames(self, readings: Sequence[Reading]) -> list[bytes]:
        """Return the frames of a step after the faults."""
        out: list[bytes] = []
        self._step_sent = True
        # The operator first: its commands belong to the state before this step.
        if self._proxy_answers or self._pending_commands:
            self._send_pending(out)
        self.step_us = None
        raws = self._packer.frames(readings)
        batteries = [raw for raw in raws if frame_message_id(raw) == BATTERY]
        step = b"".join(raw for raw in raws if raw not in batteries)
        for data in (step, *batteries):  # PX4 reads a battery on its telemetry only
            self._route_all(self.receive(SIMULATOR, data), out)
        return out

    def finish_packed(self, data: bytes) -> list[bytes]:
        """Finish what a stretch has begun with a step's frames."""
        assert self._passage is not None
        out: list[bytes] = []
        self.step_us = None
        self._route_all(self._passage.finish(SIMULATOR, data, self.flight.now_us), out)
        return out

    def note_step(self, step_us: int) -> None:
        """Note that a stretch has sent a step with this timestamp."""
        self.step_us, self._step_sent = step_us, True

    @property
    def has_pending(self) -> bool:
        """Whether frames wait to leave before the next step, or have returned for the plant."""
        return bool(self._proxy_answers or self._pending_commands or self.returned)

    def _send_pending(self, out: list[bytes]) -> None:
        """Send them one by one: frames of one datagram leave together, but on different links."""
        answers, pending = self._proxy_answers, self._pending_commands
        self._proxy_answers, self._pending_commands = [], []
        for raw in answers:
            self._send_out(raw, out)
        self._flush_passage()
        for raw in pending:
            self._route_all(self.flight.core.received(GROUND, raw, self.flight.now_us), out)

    def work_between_steps(self) -> None:
        """Do what can wait until a step has left: logs, listeners, the operator."""
        self.deliver_all()
        if self._step_sent:
            self._step_sent = False
            self._pending_commands = self._commands()

    def receive(self, link: int, data: bytes) -> list[Send]:
        """Pass complete frames through the proxy."""
        core = self.flight.core if self._passage is None else self._passage
        return core.received(link, data, self.flight.now_us)

    def _flush_passage(self) -> None:
        if self._passage is not None:
            self._passage.settle()

    def _route_all(self, sends: list[Send], out: list[bytes]) -> None:
        for send in sends:
            if send.link == VEHICLE:
                self._send_out(send.data, out)
            else:
                self.route_send(send, self.returned)

    def route_send(self, send: Send, returned: list[Frame], origin: bytes = b"") -> None:
        """Route a send: to the simulator at once, to the autopilot with the next step, to others
        later.

        `origin` are the received frames, which usually leave unchanged.
        """
        if send.link == VEHICLE:
            self._proxy_answers.append(send.data)
        elif send.link != SIMULATOR:
            if not is_single_step_reply(send.data):
                self.undelivered.append(send)
        elif send.data != origin:
            returned += self._decoded(send)
        else:
            frames = map(trusted_frame, split_frames(send.data))
            returned += [frame for frame in frames if frame.id in SIMULATOR_MESSAGES]

    def deliver_all(self) -> None:
        """Record the sends and deliver them to the listener."""
        self._flush_passage()
        if self.undelivered:
            sends, self.undelivered = self.undelivered, []
            self._listener(sends)

    def _decoded(self, send: Send) -> list[Frame]:
        """Decode the frames of a send that the simulator understands."""
        items = self._parser.push(send.data, datagram=True)
        return [item for item in items if isinstance(item, Frame) and item.id in SIMULATOR_MESSAGES]

    def _send_out(self, data: bytes, out: list[bytes]) -> None:
        """Send on the HIL link with the step, or at once on the telemetry link."""
        if self._telemetry is not None and (
            not is_hil_frame(data) or frame_message_id(data) == BATTERY
        ):
            self._telemetry.write(data)
            return
        out.append(data)
        if data[0] == STX_V2:
            self._note_step(data)

    def _note_step(self, data: bytes) -> None:
        """Store the timestamp of a step found in MAVLink 2 frames."""
        for start, end, number in walk_frames(data):
            if number == self._step.number and data[start + 1] < self._step.below_bytes:
                self.step_us = int.from_bytes(data[start:end][STAMP_BYTES], "little")


def frame_message_id(raw: bytes) -> int:
    """Return the message id of the first frame."""
    return next(walk_frames(raw))[2]


def trusted_frame(raw: bytes) -> Frame:
    """Wrap a frame that needs no check: packed here, or verified before."""
    layout = find_layout(frame_message_id(raw))
    assert layout is not None
    return Frame(raw, layout)


class WaitableProcess(Protocol):
    """The part of `subprocess.Popen` that is needed of an autopilot's process."""

    def poll(self) -> int | None:
        """Return the exit code once it has ended."""

    def wait(self, timeout: float) -> int:
        """Return the exit code; TimeoutExpired if it does not end in time."""


class ConnectionDeadline:
    """Raises an error if no autopilot connects; the loop handles one that disconnects."""

    def __init__(self, link: Link, process: WaitableProcess | None, seconds: float) -> None:
        self._connected = False
        self._link, self._process, self._seconds = link, process, seconds
        self._deadline = time.monotonic() + seconds

    def check(self) -> None:
        """Raise ConfigError if the autopilot has ended or the deadline has passed."""
        if self._connected:
            return
        self._connected = bool(self._link.peer_count)
        if self._connected:
            return
        # No need to wait for the deadline if its process has ended.
        code = None if self._process is None else self._process.poll()
        if code is not None:
            raise ConfigError(f"autopilot: ended with code {code} before it connected")
        if time.monotonic() > self._deadline:
            raise ConfigError(
                f"autopilot: did not connect to {self._link.name} within {self._seconds:g} s"
            )


class AutopilotReceiver:
    """The inbox of the lockstep loop: the autopilot's frames on HIL and telemetry links.

    An answer releases the next step when it arrives, whatever a fault does to it afterwards.
    """

    def __init__(
        self,
        sender: AutopilotSender,
        links: Sequence[Link],
        deadline: ConnectionDeadline,
        lockstep: Lockstep,
    ) -> None:
        self.link = links[0]
        self._sender, self._connection_deadline, self._lockstep = sender, deadline, lockstep
        self._inboxes = [Inbox(link) for link in links]
        self._pushed_chunks: list[Chunk] = []  # of the HIL link, read by a stretch

    def frames(self, wait_s: float = 0.0) -> list[Frame]:
        """Return received frames that have left the proxy for the simulator."""
        self._connection_deadline.check()
        sender = self._sender
        sender.work_between_steps()
        found, sender.returned = sender.returned, []
        if self._pushed_chunks:
            given, self._pushed_chunks = self._pushed_chunks, []
            self._read(self._inboxes[0], given, found)
            return found
        by_fd = {fd: inbox for inbox in self._inboxes for fd in inbox.link.filenos()}
        ready, _, _ = select.select(by_fd, (), (), wait_s)
        # One link per call, the HIL link first: the others wait until the step has left.
        for inbox in [by_fd[descriptor] for descriptor in ready[:1]]:
            self._read(inbox, inbox.link.read(), found)
        return found

    def push_bytes(self, stream: int, data: bytes) -> None:
        """Take bytes of the HIL link that a stretch has read."""
        self._pushed_chunks.append((stream, data))

    def incomplete(self, stream: int) -> bool:
        """Whether a stream of the HIL link ends within a frame."""
        return self._inboxes[0].incomplete(stream)

    def read_telemetry(self) -> None:
        """Read the links other than the HIL link, and return the simulator's frames to it."""
        for inbox in self._inboxes[1:]:
            self._read(inbox, inbox.link.read(), self._sender.returned)

    def _read(self, inbox: Inbox, chunks: Sequence[Chunk], found: list[Frame]) -> None:
        for stream, data in chunks:
            raws = [] if inbox.incomplete(stream) else split_frames(data)
            # Bytes that are not just whole frames need the parser.
            if sum(map(len, raws)) < len(data) or not data:
                raws = [frame.raw for frame in inbox.parsed(stream, data)]
            whole = b"".join(raws)
            if whole:
                self.route_received(whole, self._sender.receive(VEHICLE, whole), found)

    def route_received(self, data: bytes, sends: Sequence[Send], found: list[Frame]) -> None:
        """Note the answers among the autopilot's frames, and route what leaves of them."""
        for raw in split_frames(data):
            if is_step_reply(raw):  # as received: a fault may change the timestamp
                frame = Frame(raw, STEP_REPLY)
                self._lockstep.received(int(frame.number("time_usec")), time.monotonic())
        for send in sends:
            self._sender.route_send(send, found, data)
