"""Plain steps of a flight under an autopilot, and the work between them."""

import time
from collections.abc import Callable

import numpy as np

from analysis.autopilots import stretch_kernel as s
from analysis.autopilots.flight_operator import OPERATOR_PERIOD_US
from analysis.autopilots.hil_exchange import AutopilotReceiver, AutopilotSender
from analysis.run.proxied_flight import SIMULATOR, VEHICLE
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_steps import PlainSteps, can_be_plain
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Controls, Truth


class PlainFlight:
    """Plain steps of the loop through the proxy; `outward` and `inward` handle all others."""

    def __init__(self, simulation: Simulation, hil: HilPacker, passage: Passage) -> None:
        self._steps = PlainSteps(simulation, hil)
        self._simulation, self._passage = simulation, passage
        self._due_us: int | None = None  # time of the core's next own send
        words = np.zeros(s.WORDS, dtype=np.int64)
        words[s.SIMULATOR], words[s.VEHICLE] = SIMULATOR, VEHICLE
        self._stretch = s.Stretch(
            words=words,
            poll=np.zeros(1, dtype=np.int64),
            came=np.zeros(s.ROOM, dtype=np.uint8),
            loop=np.asarray(passage.loop),
            data=np.asarray(passage.data),
        )
        # Compile now, without a step to fly, while no autopilot waits.
        s.stretch(self._steps.arrays, self._stretch)

    def join(self, outward: AutopilotSender, inward: AutopilotReceiver, lockstep: Lockstep) -> bool:
        """Connect to these; False if the link does not support plain steps."""
        if not isinstance(inward.link, TcpServer):
            return False
        self._outward, self._inward, self._lockstep = outward, inward, lockstep
        self._link, self._stream = inward.link, 0
        return True

    def fly(self, controls: Controls, flown: Callable[[Truth], None]) -> Controls:
        """Fly until a step needs the loop; see `lockstep_loop`."""
        if self._outward.step_us is None:
            return controls
        words, began = self._stretch.words, False
        words[s.STEP_US] = self._outward.step_us
        until_us, left = self._steps.take()
        while left > 0 and self._open():
            words[s.UNTIL_US] = min(until_us, self._simulation.truth.t_us + OPERATOR_PERIOD_US + 1)
            if self._due_us is not None:
                words[s.UNTIL_US] = min(words[s.UNTIL_US], self._due_us - words[s.START_US])
            words[s.LEFT], words[s.STEPS] = left, 0
            reason = s.stretch(self._steps.arrays, self._stretch)
            left = int(words[s.LEFT])
            if words[s.STEPS] or reason == s.DIVERGED:
                began = True
                self._steps.observe()
                self._account()
                flown(self._simulation.truth)
            if reason == s.OVER and words[s.STEPS] == 0:
                break
            if not self._see_to(reason):
                break
        return self._steps.give_back() if began else controls

    def _open(self) -> bool:
        """Whether nothing waits that the interpreted path has to handle before the next step."""
        outward, inward, words = self._outward, self._inward, self._stretch.words
        peer = self._link.lone_peer()
        if peer is None or outward.has_pending or inward.incomplete(peer[1]):
            return False
        words[s.FD], self._stream = peer
        words[s.START_US] = outward.flight.now_us - outward.flight.t_us
        self._due_us = self._passage.open_until_us()
        words[s.FORWARD], words[s.ADDRESSES] = self._passage.machine
        return True

    def _account(self) -> None:
        """Update the lockstep and the link's counters after a stretch."""
        words, now_s = self._stretch.words, time.monotonic()
        step_us, counters, steps = int(words[s.STEP_US]), self._link.counters, int(words[s.STEPS])
        self._lockstep.received(int(words[s.ANSWERED_US]), now_s)
        self._lockstep.sent(step_us, now_s)
        self._outward.note_step(step_us)
        counters.chunks_in += steps
        counters.chunks_out += steps
        counters.bytes_in += int(words[s.BYTES_IN])
        counters.bytes_out += int(words[s.BYTES_OUT])
        words[s.BYTES_IN] = words[s.BYTES_OUT] = 0

    def _see_to(self, reason: int) -> bool:
        """Handle the reason for which a stretch ended; return whether another may follow."""
        words, outward = self._stretch.words, self._outward
        if reason == s.CAME:
            self._inward.push_bytes(self._stream, self._stretch.came[: words[s.GOT]].tobytes())
        elif reason == s.KEPT:
            arrays = self._steps.arrays
            packed = arrays.out[: arrays.words[k.LENGTH]].tobytes()
            step_us = int(arrays.words[k.T_US] + arrays.words[k.START_US])
            self._link.write(b"".join(outward.send_packed(packed, step_us)))
            self._lockstep.sent(outward.step_us, time.monotonic())
        elif reason == s.STAYED:
            length, went = int(self._steps.arrays.words[k.LENGTH]), max(int(words[s.WENT]), 0)
            self._link.write(self._stretch.data[went:length].tobytes())
        elif reason != s.SILENT:
            self._inward.read_telemetry()
            outward.work_between_steps()
            return True
        return False


def plain_flight(
    simulation: Simulation, hil: HilPacker, passage: Passage | None
) -> PlainFlight | None:
    """Create the plain steps of a flight, or None if it has none."""
    if passage is None or not can_be_plain(simulation):
        return None
    return PlainFlight(simulation, hil, passage)
