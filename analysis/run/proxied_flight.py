"""Simulate a flight through the proxy's core: from truth to sensor frames to the proxy's output.

No sockets, files or clocks: `advance` simulates one step, and the caller records, forwards and
publishes the output.
"""

import logging
from typing import Any, NamedTuple

from analysis.run.vehicle_parts import check_parts
from analysis.scoring.fault_channels import ACTUATORS, target_visibility
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole, Send
from mavproxy_fault.proxy.statistics import link_statistics
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.frame import STX_V2, Frame
from mavproxy_fault.wire.label import Label, latest_labels
from mavproxy_fault.wire.parser import Parser
from simvehicle.app.sim_server import (
    check_sensors,
    create_services,
    mav_type_and_mix,
    throttle_command,
)
from simvehicle.hil.actuator_commands import ActuatorCommands
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.plant_changes import PlantChanges
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.simulation.simulation import Simulation

# The order of LINKS.
SIMULATOR, MONITOR, VEHICLE, GROUND = range(4)
LINKS = (
    LinkRole("simulator", "to-vehicle"),
    LinkRole("monitor", "from-vehicle"),
    LinkRole("vehicle", "from-vehicle"),
    LinkRole("ground station", "to-vehicle"),
)
# The component id of the simulator's HIL frames.
HIL_COMPONENT = 51
LOG = logging.getLogger(__name__)


class FlightOutput(NamedTuple):
    """Bytes that left the proxy for the monitor and for the ground station."""

    monitor: bytes
    ground: list[bytes]


class ProxiedFlight:
    """A simulated flight through the proxy; its wall clock starts at the scenario's start time.

    The scenario's mission is flown until a ground station takes over.
    """

    def __init__(self, scenario: Scenario, schedule: Schedule) -> None:
        check_sensors(scenario)
        self.duration_s = scenario.duration_s
        simulation = self.simulation = Simulation(scenario)
        # Also what is injected in flight: a fault of a missing part would be labelled.
        self.engine = Engine(schedule, check=lambda one: check_parts(one, lambda: simulation))
        self.capture = CaptureBuffer()
        self.control = LiveControl(self.engine)
        self.core = Core(LINKS, self.engine, tape=self.capture, control=self.control)
        self._labels: list[Label] = []
        self._out = [0] * len(LINKS)  # datagrams sent on each link
        self._hil = HilPacker(self.simulation.board, mav_type=mav_type_and_mix(self.simulation)[0])
        self._services, self._pilot = create_services(self.simulation)
        self._plant = PlantChanges(self.simulation.plant, LOG.warning)
        self._commands = self._actuator_commands(schedule)
        self._parser = Parser()
        self._start_us = round(scenario.start.time.timestamp() * 1e6)

    @property
    def t_us(self) -> int:
        """Simulated time."""
        return self.simulation.truth.t_us

    @property
    def now_us(self) -> int:
        """Simulated time as Unix time, the timestamp of the logs."""
        return self._start_us + self.t_us

    @property
    def vehicle_us(self) -> int:
        """The vehicle's clock, which schedules and labels use."""
        return self.core.clock.t_us

    @property
    def finished(self) -> bool:
        """Whether the scenario's duration has passed."""
        return self.t_us >= self.duration_s * 1e6

    def advance(self, commands: list[bytes]) -> FlightOutput:
        """Simulate up to the next IMU sample, with the commands of a ground station."""
        # Until a ground station commands, the scenario's own controller flies.
        controls = self._pilot.controls() if self._pilot.flight.goal_active else None
        sends, commanded = self._send_actuator_commands() if controls is None else ([], b"")
        if controls is None and self._commands is not None:
            controls = self._commands.last_received
        t_us, truth, readings = self.simulation.step(controls)
        # Sensors, telemetry, commands: a fixed order, for reproducible bytes.
        for raw in self._hil.frames(readings):
            sends += self.core.received(SIMULATOR, raw, self.now_us)
        for raw in self._services.tick(t_us, truth, readings, throttle_command(self.simulation)):
            sends += self.core.received(VEHICLE, raw, self.now_us)
        for data in commands:
            sends += self.core.received(GROUND, data, self.now_us)
        sent = self._split_sends(sends)
        # The monitor compares the vehicle's response with the commands before the faults.
        return sent._replace(monitor=commanded + sent.monitor)

    def _actuator_commands(self, schedule: Schedule) -> ActuatorCommands | None:
        """Send the controller's commands as frames only if the schedule has an actuator fault."""
        targets = [target for entry in schedule.faults for target in entry.targets]
        if not any(ACTUATORS in target_visibility(target).channels for target in targets):
            return None
        kind, vehicle = self.simulation.kind, self.simulation.vehicle
        return ActuatorCommands(kind.actuators(vehicle), kind.mix(vehicle))

    def _send_actuator_commands(self) -> tuple[list[Send], bytes]:
        """Send the actuator commands of the next step through the proxy and apply the result;
        return the other sends and the commands as sent."""
        if self._commands is None:
            return [], b""
        message = self._commands.message(self.vehicle_us, self.simulation.commanded())
        raw = self._services.pack(message)
        sends = self.core.received(VEHICLE, raw, self.now_us)
        for link, data, _ in sends:
            if link == SIMULATOR:
                self._apply_frame(link, data)
        return [send for send in sends if send.link != SIMULATOR], raw

    def finish(self) -> FlightOutput:
        """End the active faults."""
        return self._split_sends(self.core.finish(self.now_us))

    def drain_labels(self) -> list[Label]:
        """Return the labels begun or ended since the last call, for the log."""
        labels = self.core.drain_labels()
        self._labels += labels
        return labels

    def completed_labels(self) -> list[Label]:
        """Return the final label of every fault, for the scores; call `drain_labels` first."""
        return latest_labels(self._labels)

    def stats(self) -> list[dict[str, Any]]:
        """Return the traffic counters of every link."""
        return [
            {**link_statistics(self.core, number), "chunks_out": out}
            for number, out in enumerate(self._out)
        ]

    def _split_sends(self, sends: list[Send]) -> FlightOutput:
        """Apply commands to the vehicle; the HIL stream goes to the monitor, the rest to the ground
        station."""
        # One datagram: the monitor needs no boundaries on its reliable pipe.
        sent = FlightOutput(
            b"".join(s.data for s in sends if s.link == MONITOR and is_hil_frame(s.data)), []
        )
        answers: list[Send] = []
        for link, data, _ in sends:
            self._out[link] += 1
            # The HIL stream would swamp a ground station.
            if link == GROUND and not is_hil_frame(data):
                sent.ground.append(data)
            elif link in (VEHICLE, SIMULATOR):
                answers += self._apply_frame(link, data)
        sent.ground.extend(s.data for s in answers if s.link == GROUND)
        return sent

    def _apply_frame(self, link: int, data: bytes) -> list[Send]:
        """Apply a frame for the vehicle or the simulated plant; return the replies."""
        sends: list[Send] = []
        # Each send is one datagram, so no frame spans two.
        for item in self._parser.push(data, datagram=True):
            # The router returns the simulator's own frames, which are not commands.
            if not isinstance(item, Frame) or item.component == HIL_COMPONENT:
                continue
            # Only plant faults send frames to the simulator.
            if link == SIMULATOR:
                self._plant.carry_out(item)
                if self._commands is not None:
                    self._commands.receive(item)
                continue
            for raw in self._services.received(item, self.t_us):
                sends += self.core.received(VEHICLE, raw, self.now_us)
        return sends


def recorder_session(scenario: str, seed: int, flight: ProxiedFlight) -> dict[str, Any]:
    """Return the session data that a replay of the run needs."""
    links = [{"name": role.name, "direction": role.direction} for role in flight.core.links]
    return {
        "scenario": scenario,
        "seed": seed,
        "schedule": flight.engine.save(),
        "links": links,
    }


def is_hil_frame(data: bytes) -> bool:
    """Whether a datagram is from the simulator's HIL interface."""
    # Byte 6 of a MAVLink 2 header is the component id; HIL frames are never version 1.
    return data[0] == STX_V2 and data[6] == HIL_COMPONENT
