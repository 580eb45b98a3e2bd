"""Plain steps of a flight under an autopilot, and between them whatever else has to be done."""

import time
from collections.abc import Callable

import numpy as np

from analysis.autopilots import stretch_kernel as s
from analysis.autopilots.hil_exchange import FromAutopilot, ToAutopilot
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.links.tcp import TcpServer
from simvehicle.hil.hil_frames import Hil
from simvehicle.hil.lockstep import Lockstep
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_steps import PlainSteps, can_be_plain
from simvehicle.vehicles.body import Controls, Truth

STRETCH_US = 20_000  # of the vehicle's time, after which logs and operator are seen to


class PlainFlight:
    """The loop's plain steps behind the proxy; `outward` and `inward` take every other one."""

    def __init__(
        self,
        hil: Hil,
        outward: ToAutopilot,
        inward: FromAutopilot,
        lockstep: Lockstep,
        passage: Passage,
    ) -> None:
        simulation = outward.flight.simulation
        assert isinstance(inward.link, TcpServer)
        self._outward, self._inward, self._lockstep = outward, inward, lockstep
        self._link, self._passage, self._simulation = inward.link, passage, simulation
        self._steps = PlainSteps(simulation, hil)
        self._stretch = s.Stretch(
            words=np.zeros(s.WORDS, dtype=np.int64),
            polls=np.zeros(2, dtype=np.int64),
            came=np.zeros(s.ROOM, dtype=np.uint8),
            loop=np.asarray(passage.loop),
            data=np.asarray(passage.data),
        )
        self._stream = 0

    def fly(self, controls: Controls, flown: Callable[[Truth], None]) -> Controls:
        """Fly on until a step needs the loop; see `lockstep_loop.Plain`."""
        if self._outward.step_us is None:
            return controls
        words, began = self._stretch.words, False
        words[s.STEP_US] = self._outward.step_us
        until_us, left = self._steps.take()
        while left > 0 and self._open():
            words[s.UNTIL_US] = min(until_us, self._simulation.truth.t_us + STRETCH_US + 1)
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
        """Whether nothing waits that the ordinary way has to see to before the next step."""
        outward, inward, words = self._outward, self._inward, self._stretch.words
        peer = self._link.lone_peer()
        if peer is None or outward.waiting or inward.incomplete(peer[1]):
            return False
        now_us = outward.flight.now_us
        if not self._passage.ready(now_us):
            return False
        words[s.FD], self._stream = peer
        words[s.OTHER_FD] = inward.other_descriptor
        words[s.START_US] = now_us - outward.flight.t_us
        words[s.FORWARD], words[s.ADDRESSES] = self._passage.machine
        return True

    def _account(self) -> None:
        """Tell the lockstep and the link's counters what a stretch did."""
        words, now_s = self._stretch.words, time.monotonic()
        step_us, counters, steps = int(words[s.STEP_US]), self._link.counters, int(words[s.STEPS])
        self._lockstep.received(int(words[s.ANSWERED_US]), now_s)
        self._lockstep.sent(step_us, now_s)
        self._outward.stepped(step_us)
        counters.chunks_in += steps
        counters.chunks_out += steps
        counters.bytes_in += int(words[s.BYTES_IN])
        counters.bytes_out += int(words[s.BYTES_OUT])
        words[s.BYTES_IN] = words[s.BYTES_OUT] = 0

    def _see_to(self, reason: int) -> bool:
        """Do what a stretch ended for; whether a further one may follow."""
        words, outward = self._stretch.words, self._outward
        if reason == s.CAME:
            self._inward.give(self._stream, self._stretch.came[: words[s.GOT]].tobytes())
        elif reason == s.KEPT:
            arrays = self._steps.arrays
            packed = arrays.out[: arrays.words[k.LENGTH]].tobytes()
            self._link.write(b"".join(outward.packed(packed, int(words[s.STEP_US]))))
            self._lockstep.sent(outward.step_us, time.monotonic())
        elif reason == s.STAYED:
            length, went = int(self._steps.arrays.words[k.LENGTH]), max(int(words[s.WENT]), 0)
            self._link.write(self._stretch.data[went:length].tobytes())
        elif reason != s.SILENT:
            if reason == s.OTHER:
                self._inward.hear_others()
            outward.meanwhile()
            return True
        return False


def plain_flight(
    hil: Hil,
    outward: ToAutopilot,
    inward: FromAutopilot,
    lockstep: Lockstep,
    passage: Passage | None,
) -> PlainFlight | None:
    """The plain steps of a flight, where it has any."""
    plain = passage is not None and can_be_plain(outward.flight.simulation)
    if not plain or not isinstance(inward.link, TcpServer):
        return None
    assert passage is not None
    return PlainFlight(hil, outward, inward, lockstep, passage)
