"""The proxy's core between the simulator's lockstep loop and an autopilot on a link.

The loop packs frames for the autopilot and reads what it says; here both pass through the core of
a flight, so that faults act on them. The core's wall clock is simulated time: a delay is one of
the vehicle's time, however fast the flight is.
"""

import logging
import subprocess
import time
from collections.abc import Callable, Sequence

from analysis.run.proxied_flight import GROUND, SIMULATOR, VEHICLE, Flight
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Link
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.hil.hil_frames import Hil
from simvehicle.hil.plant_changes import PlantChanges
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.body import Truth

LOG = logging.getLogger(__name__)
Process = subprocess.Popen[bytes]
Hear = Callable[[Send], None]  # what leaves for monitor and ground station


class ToAutopilot:
    """The loop's packer: frames as they leave the proxy.

    Parameters
    ----------
    flight : Flight
    packer : Hil
    hear : callable
        Is given what leaves on other links.
    commands : callable
        What a ground station sends before a step.
    """

    def __init__(
        self, flight: Flight, packer: Hil, hear: Hear, commands: Callable[[], list[bytes]] = list
    ) -> None:
        self.start_us = packer.start_us
        self._flight, self._packer = flight, packer
        self._hear, self._commands = hear, commands
        self._plant = PlantChanges(flight.simulation, LOG.warning)
        self._parser = Parser()

    def frames(self, t_us: int, truth: Truth, readings: Sequence[Reading]) -> list[bytes]:
        """The frames of a step, with faults."""
        out = []
        # The operator first: its commands belong to the state before this step.
        received = [(GROUND, raw) for raw in self._commands()]
        received += [(SIMULATOR, raw) for raw in self._packer.frames(t_us, truth, readings)]
        for link, raw in received:
            for send in self._flight.core.received(link, raw, self._flight.now_us):
                if send.link == VEHICLE:
                    out.append(send.data)
                elif send.link == SIMULATOR:
                    self._change_plant(send.data)
                else:
                    self._hear(send)
        return out

    def _change_plant(self, data: bytes) -> None:
        """Carry out what a plant fault asks of the simulator."""
        for item in self._parser.push(data, datagram=True):
            if isinstance(item, Frame):
                self._plant.carry_out(item)


class Patience:
    """Gives up where no autopilot comes; one that came and went is the loop's to tell."""

    def __init__(self, link: Link, process: Process | None, seconds: float) -> None:
        self._came = False
        self._link, self._process, self._seconds = link, process, seconds
        self._deadline = time.monotonic() + seconds

    def check(self) -> None:
        """Raise ConfigError where nobody is there and nobody will come."""
        self._came = self._came or bool(self._link.peer_count)
        if self._came:
            return
        # A program that has ended will not come: no need to wait for the deadline.
        if self._process is not None and self._process.poll() is not None:
            code = self._process.returncode
            raise ConfigError(f"autopilot.command: it ended with code {code}; it has to connect")
        if time.monotonic() > self._deadline:
            raise ConfigError(
                f"autopilot: nobody came to {self._link.name} within {self._seconds:g} s"
            )


class FromAutopilot:
    """The loop's inbox: what the autopilot says, on the HIL link and on its telemetry."""

    def __init__(
        self, flight: Flight, links: Sequence[Link], patience: Patience, hear: Hear
    ) -> None:
        self.link = links[0]
        self._flight, self._patience, self._hear = flight, patience, hear
        self._inboxes = [Inbox(link) for link in links]
        self._parser = Parser()

    def frames(self) -> list[Frame]:
        """What came and left the proxy for the simulator."""
        self._patience.check()
        found = []
        for inbox in self._inboxes:
            for frame in inbox.frames():
                for send in self._flight.core.received(VEHICLE, frame.raw, self._flight.now_us):
                    if send.link == SIMULATOR:
                        items = self._parser.push(send.data, datagram=True)
                        found += [item for item in items if isinstance(item, Frame)]
                    else:
                        self._hear(send)
        return found
