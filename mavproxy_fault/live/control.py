"""Live control: turn requests from ground stations, RflySim and Zenoh into schedule edits.

All of it runs in the thread of the proxy's loop and does no I/O. `LiveControl` intercepts one
MAVLink command, MAV_CMD_INJECT_FAILURE. Where the proxy changes what the autopilot reads, it
applies the failure and acknowledges it in the vehicle's name; otherwise the command is forwarded,
and the autopilot's own acknowledgement is labelled. An autopilot on a HIL link sends a single
HEARTBEAT; it is repeated to ground stations, which need it to find the vehicle.
"""

import logging
import re
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import MOST_BYTES, read_yaml
from mavproxy_fault.faults.bit_faults import GROUPS
from mavproxy_fault.live.failure_command import (
    FAILURE_UNITS,
    INPUTS,
    LINK_UNITS,
    PARTS,
    FailureRequest,
    UnitPart,
    failure_entries,
    reaches_autopilot,
    telemetry_targets,
)
from mavproxy_fault.live.named_files import check_files
from mavproxy_fault.live.rflysim import IdMap, Packet, packet_entries
from mavproxy_fault.live.subscriptions import RECEIVED, SubscribedMessages, Watched
from mavproxy_fault.proxy.announcements import COMPONENT
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.proxy.senders import CLOCK_OFFSET, LINKS, NEWEST_STAMP
from mavproxy_fault.schedule.cross_checks import check_id
from mavproxy_fault.schedule.entries import parse_entry, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import Label

INJECT_FAILURE = 420  # MAV_CMD
ACCEPTED, DENIED, IN_PROGRESS = 0, 2, 5  # MAV_RESULT
OWN_COMMAND = bytes((COMPONENT,)) + message_layout("COMMAND_LONG").id.to_bytes(3, "little")
COMMANDS = frozenset(message_layout(name).id for name in ("COMMAND_LONG", "COMMAND_INT"))
ACKNOWLEDGEMENT = message_layout("COMMAND_ACK").id
PARAMETER = message_layout("PARAM_VALUE").id
HEARTBEAT = message_layout("HEARTBEAT").id
TUNNEL = message_layout("TUNNEL").id
STATION = 6  # MAV_TYPE_GCS
SILENT_US = 3_000_000  # chosen: three heartbeats missing
FAILURE_PARAMETER = (
    b"SYS_FAILURE_EN"  # PX4's parameter; 0 has the same bytes in every parameter type
)
LINK_PART = UnitPart("")  # stands for every message
LEARN_US = 2_000_000  # instances of a sensor all come within this time; GPS sends once a second
LEARN_FRAMES = 50  # or so many frames; chosen: sensors in HIL_SENSOR have 5 Hz or more of its 250
REPLY_US = 5_000_000  # chosen: ground stations give up after 3 s or less
MOST_PENDING = 16  # chosen: more commands than a station leaves unanswered
READ_ONLY_REQUESTS = ("state", "schedule/save")  # these do not change the schedule
REQUESTS = (
    *READ_ONLY_REQUESTS, "schedule/load", "schedule/begin", "schedule/stop", "fault/ID/arm",
    "fault/ID/disarm", "fault/ID/value",
)  # fmt: skip
LOG = logging.getLogger(__name__)
T = TypeVar("T")
FIRST_STATION = 240  # ground stations have system ids from here on: MAVSDK 245, others 255
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1, the component in whose name a command is acknowledged


class ValueRequest(msgspec.Struct, frozen=True):
    """A new magnitude of a fault, and when it was sent [us of Unix time]."""

    value: float
    sent_us: Annotated[int, Meta(ge=0, le=(1 << 63) - 1)] | None = None


class LiveControl:
    """Applies live requests to the engine; refuses or forwards them unless `allowed`.

    Requests may name files below `folders` only; None allows any file.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        allowed: bool = True,
        rflysim: IdMap | None = None,
        folders: Sequence[Path] | None = (),
    ) -> None:
        self.engine = engine
        self.allowed = allowed
        self.rflysim = rflysim
        self.folders = folders
        self.view = SubscribedMessages()
        self.note_samples = self.view.note_samples
        self.senders = array("q")  # the core's, once attached
        self.replayed_us: int | None = None  # wall time of an edit that a replay repeats
        self._latched: set[str] = set()
        self._other_sizes: set[int] = set()  # of datagrams on RflySim's port that were reported
        # Instances heard in each part of a unit, from each system and direction.
        self._sources: dict[tuple[UnitPart, int, str], set[int]] = {}
        self._frames: dict[int, int] = {}  # of each message, since its instances are noted
        # Messages whose instances are still noted, until this time of the vehicle.
        self._learning = dict.fromkeys((message_layout(name).id for name in PARTS), NEVER_US)
        # Forwarded commands that were not acknowledged yet, with their times.
        self._pending: list[tuple[int, Frame, FailureRequest]] = []
        self._whole: dict[str, FailureRequest] = {}  # failures of all instances
        self._heartbeats: dict[int, tuple[int, Frame]] = {}  # of autopilots: newest, and its time
        self._first_vehicle = 0
        self._enabled = True  # until the vehicle reports SYS_FAILURE_EN = 0
        self.wanted: frozenset[int] = frozenset()
        self.needed: frozenset[int] = frozenset()  # without those that are only sampled
        self._update_wanted()

    # -- MAVLink ---------------------------------------------------------------------------------

    def consume(
        self, frame: Frame, direction: str, t_us: int, *, sealed: bool = False
    ) -> list[Frame] | None:
        """Return the reply to a command for the proxy; None for a frame to be forwarded.

        A `sealed` frame (signed with an unknown key) cannot be changed.
        """
        if frame.id in self.view.ids:
            self.view.sample(frame, t_us, RECEIVED)
        if frame.id == HEARTBEAT:
            return self._answer_heartbeat(frame, t_us)
        if frame.id in COMMANDS:
            failure = frame.number("command") == INJECT_FAILURE
            return self._command(frame, t_us, sealed=sealed) if failure else None
        if frame.id == ACKNOWLEDGEMENT:
            self._acknowledged(frame, t_us)
        elif frame.id == PARAMETER and frame.read("param_id") == FAILURE_PARAMETER:
            self._enabled = frame.number("param_value") != 0.0
        elif frame.id in self._learning:
            self._learn(frame, direction, t_us, sealed=sealed)
        return None

    def _answer_heartbeat(self, frame: Frame, t_us: int) -> list[Frame] | None:
        """Answer a ground station's HEARTBEAT with those of autopilots that send none, but fly."""
        if frame.component == AUTOPILOT:
            self._heartbeats[frame.system] = t_us, frame
        if frame.number("type") != STATION:
            return None
        return [
            beat
            for at_us, beat in self._heartbeats.values()
            # It may have come on the wall clock, before the first timestamp.
            if abs(t_us - at_us) > SILENT_US and t_us - self._last_stamp(beat) < SILENT_US
        ]

    def _last_stamp(self, frame: Frame) -> int:
        """Vehicle time of the sender's newest timestamp since its boot."""
        clock = (frame.system << 8 | frame.component) << 1
        return self.senders[NEWEST_STAMP + clock] + self.senders[CLOCK_OFFSET + clock]

    def _learn(self, frame: Frame, direction: str, t_us: int, *, sealed: bool) -> None:
        """Note which units and instances a message carries to the autopilot."""
        name = frame.layout.name
        field = frame.layout.instance
        instance = int(frame.number(field)) + 1 if field else 1
        flags = int(frame.number("fields_updated")) if name == "HIL_SENSOR" else 0
        for part in PARTS[name] if reaches_autopilot(name, direction) and not sealed else ():
            if not part.group or flags & GROUPS[part.group]:
                source = (part, frame.system, direction)
                self._sources.setdefault(source, set()).add(instance)
        # Later frames of this message bypass this function.
        until_us = self._learning[frame.id]
        # What comes from the autopilot is telemetry, and says nothing about its inputs.
        frames = self._frames.get(frame.id, 0) + reaches_autopilot(name, direction)
        self._frames[frame.id] = frames
        if t_us >= until_us or frames >= (LEARN_FRAMES if field else 1):
            del self._learning[frame.id]
            self._update_wanted()
        elif until_us - t_us > LEARN_US:  # the first frame, or the clock has gone back
            self._learning[frame.id] = t_us + LEARN_US

    def _command(self, frame: Frame, t_us: int, *, sealed: bool) -> list[Frame] | None:
        """Carry out a failure command; None if it is left to the autopilot."""
        request = FailureRequest.read(frame)
        parts = {system: self._parts(request, system) for system in self._vehicles(frame)}
        known = parts and all(self._knows(request, found) for found in parts.values())
        if not known or sealed or not self.allowed or not self._enabled:
            # Its module may know better, and its reply starts the label.
            self._await_reply(frame, request, t_us)
            # A unit or an instance that was not heard may exist by now.
            unit = FAILURE_UNITS.get(request.unit)
            for part in unit.parts if unit else ():
                self._learning[message_layout(part.message).id] = t_us + LEARN_US
                self._frames.pop(message_layout(part.message).id, None)
            self._update_wanted()
            return None
        if request.instances is None:
            return [acknowledge_command(frame, DENIED, system) for system in parts]
        self.engine.advance_time(t_us)
        for system, found in parts.items():
            for instance in request.instances or (0,):
                self._replace(system, request, instance, found)
        return [acknowledge_command(frame, ACCEPTED, system) for system in parts]

    def _vehicles(self, command: Frame) -> list[int]:
        """Return the systems in whose name to reply; none if an addressed one was not heard."""
        system = int(command.number("target_system"))
        component = int(command.number("target_component")) or AUTOPILOT
        addressed = [system] if system else self._autopilots()
        heard = all(self.senders[LINKS + (n << 8 | AUTOPILOT)] for n in addressed)
        return addressed if heard and component == AUTOPILOT else []

    def _autopilots(self) -> list[int]:
        return [n for n in range(1, FIRST_STATION) if self.senders[LINKS + (n << 8 | AUTOPILOT)]]

    def _parts(self, request: FailureRequest, system: int) -> list[tuple[UnitPart, dict[str, Any]]]:
        """Return what carries a unit to the autopilot of a system, and which frames those are."""
        alone = set(self._autopilots()) <= {system}
        sender = {} if alone else {"system": system}
        if not request.kind:
            return []
        if request.unit in LINK_UNITS and set(request.instances or ()) <= {1}:
            return [(LINK_PART, sender)]
        found = []
        unit = FAILURE_UNITS.get(request.unit)
        for part in unit.parts if unit else ():
            # With several vehicles, what another system sends may be for any of them.
            if any(one == part and (alone or n == system) for one, n, _ in self._sources):
                # The telemetry of the same name is left alone.
                way = {} if part.message in INPUTS else {"direction": "to-vehicle"}
                found.append((part, {**sender, **way}))
        return found

    def _knows(
        self, request: FailureRequest, parts: Sequence[tuple[UnitPart, dict[str, Any]]]
    ) -> bool:
        """Whether there are parts, and each addressed instance was heard in one of them."""
        addressed = request.instances or (0,)
        return bool(parts) and all(
            any(self._carries(part, n) for part, _ in parts) for n in addressed
        )

    def _carries(self, part: UnitPart, instance: int) -> bool:
        return part == LINK_PART or not instance or instance in self._instances(part)

    def _replace(
        self,
        system: int,
        request: FailureRequest,
        instance: int,
        parts: Sequence[tuple[UnitPart, dict[str, Any]]],
    ) -> None:
        """Replace the failure of an instance (0: of all), as PX4 does; type `ok` only ends it."""
        self._first_vehicle = self._first_vehicle or system
        unit = f"{'mav' if system == self._first_vehicle else f'mav{system}'}-{request.unit}"
        ids = [id for id in self.engine.ids() if re.fullmatch(rf"{unit}(-\d+)?\.\d+", id)]
        for id in ids:
            if not instance or id.rpartition(".")[0] == f"{unit}-{instance}":
                self.engine.clear(id)
        # A failure of all instances goes on at the others.
        whole = self._whole.get(unit)
        if whole is not None:
            self.engine.clear(unit)
            del self._whole[unit]
            heard = {n for part, _ in parts for n in self._instances(part)}
            for other in sorted(heard - {instance}) if instance else ():
                self._arm(f"{unit}-{other}", whole, other, parts)
        if request.kind == "ok":
            return
        if not instance:
            self._whole[unit] = request
        self._arm(f"{unit}-{instance}" if instance else unit, request, instance, parts)

    def _instances(self, part: UnitPart) -> set[int]:
        if part.indexed:
            return set(range(1, message_layout(part.message).fields[part.fields[0][0]].count + 1))
        return {n for (one, *_), seen in self._sources.items() if one == part for n in seen}

    def _arm(
        self,
        id: str,
        request: FailureRequest,
        instance: int,
        parts: Sequence[tuple[UnitPart, dict[str, Any]]],
    ) -> None:
        carried = [(part, where) for part, where in parts if self._carries(part, instance)]
        for entry in failure_entries(id, request, instance, carried):
            self.engine.arm(entry)

    def _await_reply(self, command: Frame, request: FailureRequest, t_us: int) -> None:
        """Note a forwarded command; a repetition of it, as after a lost reply, is noted once."""
        source = command.system, command.component
        waiting = [one for one in self._pending if t_us - one[0] <= REPLY_US]
        if all((c.system, c.component, asked) != (*source, request) for _, c, asked in waiting):
            waiting = [*waiting[1 - MOST_PENDING :], (t_us, command, request)]
        self._pending = waiting

    def _acknowledged(self, ack: Frame, t_us: int) -> None:
        """Begin or end the label of a failure that the autopilot itself has accepted."""
        if ack.number("command") != INJECT_FAILURE or ack.number("result") == IN_PROGRESS:
            return
        requester = ack.number("target_system"), ack.number("target_component")
        for place, (asked_us, command, request) in enumerate(self._pending):
            asked = command.system, command.component
            if (
                t_us - asked_us <= REPLY_US
                and command.number("target_system") in (0, ack.system)
                and requester in (asked, (0, 0))
            ):
                # Other vehicles reply to a broadcast too.
                if command.number("target_system"):
                    del self._pending[place]
                if ack.number("result") == ACCEPTED:
                    self._label(ack.system, request, asked_us, t_us)
                return

    def _label(self, system: int, request: FailureRequest, asked_us: int, t_us: int) -> None:
        """Begin the label of a failure when it was requested, or end it when `ok` was accepted."""
        base = f"autopilot{system}-{request.unit or 'unit'}"
        for instance in request.instances or (0,):
            id = f"{base}-{instance}" if instance else base
            self.engine.end_noted(id if instance else base, t_us, parts=not instance)
            if request.kind == "ok":
                continue
            chosen = replace(request, instances=(instance,) if instance else ())
            self.engine.note_label(
                Label(
                    id=id,
                    fault=request.name,
                    targets=telemetry_targets(chosen),
                    direction="to-vehicle",
                    t0_us=asked_us if self.engine.t0_us is None else self.engine.t0_us,
                    start_us=asked_us,
                    seed=self.engine.seed,
                    by="autopilot",
                )
            )

    # -- RflySim ---------------------------------------------------------------------------------

    def packet(self, data: bytes, t_us: int) -> list[str]:
        """Apply one RflySim packet and return the ids of its faults; ignore other datagrams."""
        packet = Packet.read(data)
        if packet is None and len(data) not in self._other_sizes:
            self._other_sizes.add(len(data))
            LOG.warning("RflySim: a datagram of %d bytes is no fault packet; ignored", len(data))
        # Without an id map none can be applied.
        if packet is None or self.rflysim is None or not self.allowed:
            return []
        self.engine.advance_time(t_us)
        wanted = packet_entries(self.rflysim, packet)
        # A packet lists all active faults; those no longer listed have ended.
        for id in self._latched - {entry["id"] for entry in wanted} if packet.clears else ():
            self.engine.clear(id)
            self._latched.discard(id)
        for entry in wanted:
            self.engine.arm(entry)
            self._latched.add(entry["id"])
        return [entry["id"] for entry in wanted]

    # -- viewers ---------------------------------------------------------------------------------

    def sent(self, raw: bytes, t_us: int) -> None:
        """Sample a sent frame for viewers; note a failure command of the schedule."""
        if self.view.ids:
            self.view.sent(raw, t_us)
        if raw[6:10] == OWN_COMMAND:
            command = Frame(raw, message_layout("COMMAND_LONG"))
            if command.number("command") == INJECT_FAILURE:
                self._await_reply(command, FailureRequest.read(command), t_us)

    def watch(self, payload: bytes, now_s: float) -> Any:
        """Subscribe a viewer to the messages of a JSON list until the lease from `now_s` ends.

        Raises
        ------
        ConfigError
            If the payload is not such a list, a message does not exist or there are too many.
        """
        try:
            names = msgspec.json.decode(payload, type=list[str])
        except msgspec.MsgspecError as error:
            raise ConfigError(f"@ctl/watch: {error}; send a JSON list of message names") from None
        self.view.watch(names, now_s)
        self._update_wanted()
        return {"watched": len(self.view.ids)}

    def watched(self, now_s: float) -> list[Watched]:
        """Return the samples since the last call."""
        if not self.view.ids:
            return []
        self.view.expire(now_s)
        self._update_wanted()
        return self.view.drain()

    def _update_wanted(self) -> None:
        self.needed = COMMANDS | {HEARTBEAT, PARAMETER, ACKNOWLEDGEMENT, *self._learning}
        self.needed |= self.view.ids & {TUNNEL}  # of whose fragments none may be missing
        self.wanted = self.needed | self.view.ids

    # -- Zenoh -----------------------------------------------------------------------------------

    def answer(self, key: str, payload: bytes, t_us: int) -> Any:
        """Apply a query whose key ends in `@ctl/<what>` and return the reply (docs/faults.md).

        Raises
        ------
        ConfigError
            If the key or the payload is wrong; the schedule is then unchanged.
        """
        return self.prepare(key, payload)(t_us)

    def prepare(self, key: str, payload: bytes) -> Callable[[int], Any]:
        """Check a query and return the function that applies it at the vehicle's time.

        Parsing and checking a payload may take long and does not touch the engine, so this may
        be called in any thread.
        """
        _, _, what = key.partition("@ctl/")
        if len(payload) > MOST_BYTES:  # the edit log would record it
            raise ConfigError(f"{what}: is too large; at most {MOST_BYTES >> 20} MB are read")
        if what == "state":
            # Read-only queries are answered even with live control disabled.
            return lambda t_us: {
                # The later of both: the engine's time stops while no frames arrive.
                **self.engine.state(), "now_us": max(self.engine.now_us, t_us)
            }  # fmt: skip
        if what == "schedule/save":
            return lambda _: {"yaml": self.engine.save(), "anew": self.engine.save(anew=True)}
        if not self.allowed:
            raise ConfigError(f"{what}: live control is disabled; start without --no-inject")
        edit = self._edit(what, payload)

        def act(t_us: int) -> Any:
            self.engine.advance_time(t_us)
            return edit()

        return act

    def _edit(self, what: str, payload: bytes) -> Callable[[], Any]:
        """Check a request that changes the schedule and return what applies it."""
        match what.split("/"):
            case ["schedule", "load" | "begin" as how]:
                return self._load(what, payload, anew=how == "begin")
            case ["schedule", "stop"]:
                return lambda: {"cleared": self.engine.clear("all")}
            case ["fault", id, "disarm"]:
                return lambda: self._disarm(id)
            case ["fault", id, "value"]:
                value = _decode(what, payload, ValueRequest)
                return lambda: self._update(id, value)
            case ["fault", id, "arm"]:
                data = _decode(what, payload, dict[str, Any])
                check_id(id, "arm")
                check_files(data, self.folders, "arm")
                # The id in the key takes precedence over one in the payload.
                entries = parse_entry({**data, "id": id}, "arm")
                return lambda: {"armed": self.engine.arm(entries)}
        raise ConfigError(f"@ctl: {what} is unknown; {suggest_known(what, REQUESTS)}")

    def _disarm(self, id: str) -> Any:
        if not self.engine.clear(id):
            raise ConfigError(
                f"disarm: {id} is not a fault; {suggest_known(id, self.engine.ids())}"
            )
        return {"cleared": id}

    def _update(self, id: str, wanted: ValueRequest) -> Any:
        # By the wall clocks of sender and proxy: the vehicle's clock may run at another speed.
        now_us = time.time_ns() // 1000 if self.replayed_us is None else self.replayed_us
        latency_us = None if wanted.sent_us is None else now_us - wanted.sent_us
        self.engine.update(id, wanted.value, latency_us)
        return {"id": id, "value": wanted.value}

    def _load(self, what: str, payload: bytes, *, anew: bool) -> Callable[[], Any]:
        document = read_yaml(payload.decode("utf-8", "replace"), what)
        check_files(document.data, self.folders, what)
        schedule = parse_schedule(document)
        # A thousand entries would block the loop for milliseconds: the new ones are built, and the
        # replaced ones released, in this thread.
        prepared = self.engine.prepare_entries(schedule)
        replaced: list[object] = []

        def act() -> Any:
            replaced.append(self.engine.replace(schedule, anew=anew, prepared=prepared))
            return {"faults": [entry.id for entry in schedule.faults]}

        return act


def _decode(what: str, payload: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(payload, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"@ctl/{what}: {error}; send JSON") from None


def acknowledge_command(command: Frame, result: int, system: int) -> Frame:
    """Return the COMMAND_ACK to the sender of a command, from the autopilot of a system."""
    values = {
        "command": int(command.number("command")),
        "result": result,
        "target_system": command.system,
        "target_component": command.component,
    }
    layout = message_layout("COMMAND_ACK")
    return Frame(build_frame(layout, values, system=system, component=AUTOPILOT), layout)
