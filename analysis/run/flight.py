"""The simulator and the proxy's core in one flight: truth to frames to what left the proxy.

No sockets, files or clocks: `advance` goes one step of simulated time, and the caller records,
sends on and publishes what comes of it.
"""

from mavproxy_fault.core import Core
from mavproxy_fault.engine import Engine
from mavproxy_fault.ports import LinkRole, Send
from mavproxy_fault.schedule import Schedule
from mavproxy_fault.tape import Tape
from mavproxy_fault.wire.label import Label, newest
from simvehicle.hil import Hil
from simvehicle.scenario import Scenario
from simvehicle.simulation import Simulation

SIMULATOR, MONITOR = range(2)
LINKS = (LinkRole("simulator", "to-vehicle"), LinkRole("monitor", "from-vehicle"))


class Flight:
    """A scenario in flight; its wall clock is the scenario's own start time."""

    def __init__(self, scenario: Scenario, schedule: Schedule) -> None:
        self.simulation = Simulation(scenario)
        self.engine = Engine(schedule)
        self.tape = Tape()
        self.core = Core(LINKS, self.engine, tape=self.tape)
        self._labels: list[Label] = []
        self._hil = Hil()
        self._start_us = round(scenario.start.time.timestamp() * 1e6)
        self.duration_s = scenario.duration_s

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.simulation.truth.t_us

    @property
    def now_us(self) -> int:
        """Simulated time as Unix time, which the logs are stamped with."""
        return self._start_us + self.t_us

    @property
    def over(self) -> bool:
        """Whether the scenario's duration has been flown."""
        return self.t_us >= self.duration_s * 1e6

    @property
    def active(self) -> list[str]:
        """Faults that act now."""
        return self.engine.active

    def advance(self) -> bytes:
        """Fly to the next sample of the IMU; what the proxy sent to the monitor."""
        t_us, truth, readings = self.simulation.step()
        sends: list[Send] = []
        for raw in self._hil.frames(t_us, truth, readings):
            sends += self.core.received(SIMULATOR, raw, self.now_us)
        return self._to_monitor(sends)

    def finish(self) -> bytes:
        """End the faults that still act."""
        return self._to_monitor(self.core.finish(self.now_us))

    def take_labels(self) -> list[Label]:
        """Labels since the last call, begun and ended ones, for the log."""
        taken = self.core.take_labels()
        self._labels += taken
        return taken

    def completed_labels(self) -> list[Label]:
        """What every fault really did, for the scores; after `take_labels`."""
        return newest(self._labels)

    def _to_monitor(self, sends: list[Send]) -> bytes:
        return b"".join(send.data for send in sends if send.link == MONITOR)
