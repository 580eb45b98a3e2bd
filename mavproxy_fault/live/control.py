"""Live control: turn requests from ground stations, RflySim and Zenoh into schedule edits.

All of it runs in the thread of the proxy's loop and does no I/O. `LiveControl` intercepts one
MAVLink command, MAV_CMD_INJECT_FAILURE, and acknowledges it in the vehicle's name.
"""

import math
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import MOST_BYTES, read_yaml
from mavproxy_fault.live.failure_command import (
    MESSAGES,
    TYPES,
    UNITS,
    extent_of,
    failure_id,
    faults_for,
)
from mavproxy_fault.live.named_files import check_files
from mavproxy_fault.live.rflysim import IdMap, Packet
from mavproxy_fault.live.subscriptions import SubscribedMessages, Watched
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.cross_checks import check_id
from mavproxy_fault.schedule.entries import parse_entry, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

INJECT_FAILURE = 420  # MAV_CMD
ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3  # MAV_RESULT
COMMANDS = frozenset(message_layout(name).id for name in ("COMMAND_LONG", "COMMAND_INT"))
PARAMETER = message_layout("PARAM_VALUE").id
FAILURE_PARAMETER = (
    b"SYS_FAILURE_EN"  # PX4's parameter; 0 has the same bytes in every parameter type
)
NAMES = {message_layout(name).id: name for name in MESSAGES}
READ_ONLY_REQUESTS = ("state", "schedule/save")  # these do not change the schedule
LARGEST = sys.float_info.max
AUTOPILOT = 1  # the component that acknowledges a broadcast command


class LiveControl:
    """Applies live requests to the engine; denies them unless `allowed`.

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
        # Names of the messages seen so far, on which a failure command can act.
        self._seen: set[str] = set()
        self._latched: set[str] = set()
        # A failure unit is supported once one of its messages has passed.
        self._unseen: frozenset[int] = frozenset(NAMES)
        self._enabled = True  # until the vehicle reports SYS_FAILURE_EN = 0
        self.wanted: frozenset[int] = COMMANDS | {PARAMETER} | self._unseen

    # -- MAVLink ---------------------------------------------------------------------------------

    def consume(self, frame: Frame, t_us: int) -> list[Frame] | None:
        """Return the reply to a command for the proxy; None for a frame to be forwarded."""
        if frame.id in self.view.ids:
            self.view.received(frame, t_us)
        if frame.id not in COMMANDS:
            if frame.id in self._unseen:
                self._seen.add(frame.layout.name)
                # Noted once; later frames of this message bypass this function.
                self._unseen -= {frame.id}
                self._update_wanted()
            if frame.id == PARAMETER and frame.read("param_id") == FAILURE_PARAMETER:
                self._enabled = frame.number("param_value") != 0.0
            return None
        if frame.number("command") != INJECT_FAILURE:
            return None
        # COMMAND_INT has integer coordinates in place of params 5 and 6.
        positions = range(1, 6 if "param5" in frame.layout.fields else 5)
        result = self._inject([frame.number(f"param{n}") for n in positions], t_us)
        return [acknowledge_command(frame, result)]

    def _inject(self, parameters: list[int | float], t_us: int) -> int:
        if not self.allowed or not self._enabled:
            return DENIED
        # NaN means "not given" in MAVLink; -1 is neither a unit nor a type.
        numbers = [int(one) if math.isfinite(one) else -1 for one in parameters]
        unit, kind = UNITS.get(numbers[0]), TYPES.get(numbers[1])
        # An instance that is not given means all.
        instance = 0 if math.isnan(parameters[2]) else numbers[2]
        if unit is None or kind is None or instance < 0:
            return UNSUPPORTED
        self.engine.advance_time(t_us)
        if kind == "ok":
            return self._clear(unit, instance)
        try:
            extent = extent_of(kind, parameters[3:])
            entries = faults_for(unit, kind, instance, self._seen, extent)
        except ValueError:
            return UNSUPPORTED  # the instance does not exist, e.g. the seventeenth motor
        if not entries:
            return UNSUPPORTED
        # A new failure of a unit replaces the previous one, as in PX4.
        self.engine.clear(failure_id(unit, instance))
        for entry in entries:
            self.engine.arm(entry)
        return ACCEPTED

    def _clear(self, unit: str, instance: int) -> int:
        """End the failures of one instance of a unit, or of all its instances."""
        prefix = failure_id(unit, instance)
        # Ids are `unit-instance.part`; instance 0 ends those of every instance.
        for id in self.engine.ids():
            if id.rpartition(".")[0] == prefix or (not instance and id.startswith(f"{prefix}-")):
                self.engine.clear(id)
        return ACCEPTED

    # -- RflySim ---------------------------------------------------------------------------------

    def packet(self, data: bytes, t_us: int) -> list[str]:
        """Apply one RflySim packet and return the ids of its faults; ignore other datagrams."""
        packet = Packet.read(data)
        # Other datagrams reach that port too; without an id map none can be applied.
        if packet is None or self.rflysim is None or not self.allowed:
            return []
        self.engine.advance_time(t_us)
        wanted = self.rflysim.entries(packet)
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
        """Sample a sent frame for viewers."""
        if self.view.ids:
            self.view.sent(raw, t_us)

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
        self.wanted = COMMANDS | {PARAMETER} | self._unseen | self.view.ids

    # -- Zenoh -----------------------------------------------------------------------------------

    def answer(self, key: str, payload: bytes, t_us: int) -> Any:
        """Apply a query whose key ends in `@ctl/<what>` and return the reply.

        `fault/{id}/arm` (an entry as JSON), `fault/{id}/value` (`{"value": 1.5, "sent_us": ...}`),
        `fault/{id}/disarm`, `schedule/load` (YAML, its times count from the schedule's start),
        `schedule/begin` (YAML, from now), `schedule/save` (`yaml` for load, `anew` for begin),
        `schedule/stop`, `state`.

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
        prefix, _, action = what.rpartition("/")
        edits: dict[str, Callable[[bytes], Callable[[], Any]]] = {
            "schedule/load": partial(self._load, what, anew=False),
            "schedule/begin": partial(self._load, what, anew=True),
            "schedule/stop": lambda _: lambda: {"cleared": self.engine.clear("all")},
        }
        if prefix.startswith("fault/"):
            edit = self._fault_edit(prefix.removeprefix("fault/"), action, payload)
        elif what in edits:
            edit = edits[what](payload)
        else:
            raise ConfigError(
                f"@ctl: {what} is unknown; {suggest_known(what, [*edits, *READ_ONLY_REQUESTS])}"
            )

        def act(t_us: int) -> Any:
            self.engine.advance_time(t_us)
            return edit()

        return act

    def _fault_edit(self, id: str, action: str, payload: bytes) -> Callable[[], Any]:
        if action == "disarm":
            return lambda: self._disarm(id)
        try:
            data = msgspec.json.decode(payload, type=dict[str, Any])
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise ConfigError(f"@ctl/fault/{id}/{action}: {error}; send JSON") from None
        if action == "arm":
            check_id(id, "arm")
            check_files(data, self.folders, "arm")
            # The id in the key takes precedence over one in the payload.
            entries = parse_entry({**data, "id": id}, "arm")
            return lambda: {"armed": self.engine.arm(entries)}
        value = data.get("value")
        # JSON integers may exceed the range of a float.
        if action != "value" or not isinstance(value, int | float) or abs(value) > LARGEST:
            raise ConfigError(
                f"@ctl/fault/{id}/{action}: is unknown; send arm, disarm or value with a number"
            )
        sent_us = data.get("sent_us")
        if not isinstance(sent_us, int | None) or not 0 <= (sent_us or 0) < 1 << 63:
            raise ConfigError(
                f"@ctl/fault/{id}/value: sent_us = {sent_us!r} is not a timestamp; give "
                "integer microseconds of Unix time"
            )
        return lambda: self._update(id, value, sent_us)

    def _disarm(self, id: str) -> Any:
        if not self.engine.clear(id):
            raise ConfigError(
                f"disarm: {id} is not a fault; {suggest_known(id, self.engine.ids())}"
            )
        return {"cleared": id}

    def _update(self, id: str, value: float, sent_us: int | None) -> Any:
        # By the wall clocks of sender and proxy: the vehicle's clock may run at another speed.
        latency_us = None if sent_us is None else time.time_ns() // 1000 - sent_us
        self.engine.update(id, value, latency_us)
        return {"id": id, "value": value}

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


def acknowledge_command(command: Frame, result: int) -> Frame:
    """Return the COMMAND_ACK to the sender of a command, from the command's target."""
    values = {
        "command": int(command.number("command")),
        "result": result,
        "target_system": command.system,
        "target_component": command.component,
    }
    layout = message_layout("COMMAND_ACK")
    raw = build_frame(
        layout,
        values,
        # A broadcast command (0) is acknowledged as system 1, autopilot.
        system=int(command.number("target_system")) or 1,
        component=int(command.number("target_component")) or AUTOPILOT,
    )
    return Frame(raw, layout)
