"""Stretches of steps of a flight under an autopilot in compiled code, and the work between them."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from analysis.autopilots import stretch_kernel as k
from analysis.autopilots.flight_operator import OPERATOR_PERIOD_US
from analysis.autopilots.hil_exchange import AutopilotReceiver, AutopilotSender
from analysis.run.proxied_flight import SIMULATOR, VEHICLE
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Controls, Truth


class Stretches:
    """Steps of the loop in compiled code through the proxy; `sender` and `receiver` handle all
    others, and what happens between stretches."""

    def __init__(self, simulation: Simulation, packer: HilPacker, passage: Passage) -> None:
        self._simulation, self._packer, self._passage = simulation, packer, passage
        self._records = np.zeros(1, dtype=k.STRETCH)
        self._now: Any = self._records[0]
        self._now["simulator"], self._now["vehicle"] = SIMULATOR, VEHICLE
        self._room = np.asarray(passage.loop), np.asarray(passage.room)
        # Compile now, without a step to fly, while no autopilot waits.
        self._fly()

    def join(
        self, sender: AutopilotSender, receiver: AutopilotReceiver, lockstep: Lockstep
    ) -> bool:
        """Connect to these; False if the link does not support stretches."""
        if not isinstance(receiver.link, TcpServer):
            return False
        self._sender, self._receiver, self._lockstep = sender, receiver, lockstep
        self._link, self._stream = receiver.link, 0
        return True

    def fly(self, controls: Controls, flown: Callable[[Truth], None]) -> Controls:
        """Fly until a step needs the loop; see `lockstep_loop`."""
        now, began = self._now, False
        while self._sender.step_us is not None and self._open():
            now["step_us"], now["steps"] = self._sender.step_us, 0
            reason = self._fly()
            if now["steps"] or reason == k.DIVERGED:
                began = True
                self._simulation.observe(finite=reason != k.DIVERGED)
                self._account()
                flown(self._simulation.truth)
            if (reason == k.OVER and now["steps"] == 0) or not self._see_to(reason):
                break
        if not began:
            return controls
        simulation = self._simulation
        armed = bool(simulation.board.flight["armed"][0])
        return Controls(simulation.controls, armed=armed)

    def _fly(self) -> int:
        flight, sensors = self._simulation.board
        packed = self._simulation.packed
        assert packed is not None
        return k.fly_stretch(
            flight, sensors, packed, self._packer.records, self._records, *self._room
        )

    def _open(self) -> bool:
        """Whether nothing waits that the interpreter has to handle before the next step; sets the
        time until which that is so."""
        sender, receiver, now = self._sender, self._receiver, self._now
        peer = self._link.lone_peer()
        if peer is None or sender.has_pending or receiver.incomplete(peer[1]):
            return False
        now["fd"], self._stream = peer
        t_us = self._simulation.truth.t_us
        now["unix_us"] = sender.flight.now_us - t_us
        ends = [
            self._simulation.quiet_until_us(),
            self._packer.heartbeat_us,
            t_us + OPERATOR_PERIOD_US + 1,
        ]
        due_us = self._passage.open_until_us()
        if due_us is not None:
            ends.append(due_us - int(now["unix_us"]))
        now["until_us"] = min(ends)
        now["forward"], now["addresses"] = self._passage.machine
        return True

    def _account(self) -> None:
        """Update lockstep, packer and the link's counters after a stretch."""
        now, now_s, counters = self._now, time.monotonic(), self._link.counters
        step_us, steps = int(now["step_us"]), int(now["steps"])
        self._lockstep.received(int(now["answered_us"]), now_s)
        self._lockstep.sent(step_us, now_s)
        self._sender.note_step(step_us)
        self._packer.step_us = self._simulation.truth.t_us + self._packer.start_us
        counters.chunks_in += steps
        counters.chunks_out += steps
        counters.bytes_in += int(now["bytes_in"])
        counters.bytes_out += int(now["bytes_out"])
        now["bytes_in"] = now["bytes_out"] = 0

    def _see_to(self, reason: int) -> bool:
        """Handle the reason for which a stretch ended; return whether another may follow."""
        now, sender = self._now, self._sender
        if reason == k.CAME:
            self._receiver.push_bytes(self._stream, now["came"][: now["got"]].tobytes())
        elif reason == k.ANSWERED:
            answer = now["came"][: now["got"]].tobytes()
            sends = self._passage.finish(VEHICLE, answer, sender.flight.now_us)
            self._receiver.route_received(answer, sends, sender.returned)
        elif reason == k.KEPT:
            packed = self._packer.packed_bytes()
            self._link.write(b"".join(sender.finish_packed(packed)))
            self._lockstep.sent(sender.step_us, time.monotonic())
        elif reason == k.STAYED:
            length, went = len(self._packer.packed_bytes()), max(int(now["went"]), 0)
            self._link.write(self._room[1][went:length].tobytes())
        elif reason != k.SILENT:
            self._simulation.prepare()
            self._receiver.read_telemetry()
            sender.work_between_steps()
            return True
        return False


def open_stretches(
    simulation: Simulation, packer: HilPacker, passage: Passage | None
) -> Stretches | None:
    """Create the stretches of a flight, or None if it has none."""
    if passage is None or simulation.packed is None:
        return None
    return Stretches(simulation, packer, passage)
