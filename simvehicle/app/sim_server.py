"""`sim`: simulates a scenario in real time, faster, or in lockstep with an autopilot.

With `--hil tcpin:` (or `tcp:`) an autopilot flies the vehicle in lockstep; on a serial device, or
with `--real-time`, an autopilot on its own board flies it in real time. Otherwise the built-in
controller flies and HIL frames are published. With `--gcs` a ground station takes command of the
vehicle and its mission at any time; without `--gcs` the scenario ends at `duration_s`.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from typing import Any

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.descriptors import wait_until_readable
from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link, parse_spec
from simvehicle.app.battery_warnings import BatteryWarnings
from simvehicle.app.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.app.pace import Pace, parse_speed
from simvehicle.app.real_time_loop import RealTimeLoop
from simvehicle.app.sim_progress import Progress
from simvehicle.autopilot.autopilot_link import AutopilotLink
from simvehicle.autopilot.enums import MavType
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.mission_service import MissionItem, Missions, waypoint_items
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.pilot import Pilot
from simvehicle.autopilot.telemetry import HomePosition
from simvehicle.guidance.route import CircleTrack, PathTrack
from simvehicle.guidance.waypoints import path_waypoints
from simvehicle.hil.hil_frames import BARO_IDS, IMU_IDS, MAG_IDS, HilPacker
from simvehicle.hil.plant_changes import PlantChanges
from simvehicle.scenario.scenario_file import Scenario, read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import Mix

DATAGRAM_MAX_BYTES = 1400  # fits an Ethernet frame with IP and UDP headers


def main(args: argparse.Namespace) -> int:
    """Run the simulator; returns the exit code."""
    speed = parse_speed(args.speed)
    scenario = read_scenario(args.scenario)
    kind = parse_spec(args.hil).kind if args.hil else ""
    real_time = args.real_time or kind == "serial"
    if args.real_time and not args.hil:
        raise ConfigError("--real-time: needs a link to the autopilot; add --hil")
    if real_time and args.speed != "1":
        raise ConfigError(f"--speed: {args.speed} is not possible with hardware; use 1")
    # PX4's simulator link is TCP; over UDP only hardware answers.
    served = real_time or kind in ("tcpin", "tcp")
    if served and args.gcs:
        raise ConfigError(
            f"--gcs: {args.gcs[0]} cannot be combined with --hil {args.hil}, whose autopilot "
            "answers ground stations itself; remove one of them"
        )
    if args.hil:
        check_sensors(scenario)
    Simulation(scenario, args.seed).step()  # compiles the kernels before anyone waits for a step
    simulation = Simulation(scenario, args.seed)
    progress = Progress(time.monotonic())
    with ExitStack() as links:
        hil = links.enter_context(_opened(args.hil)) if args.hil else None
        gcs = [links.enter_context(_opened(text)) for text in args.gcs]
        try:
            if served and hil is not None:
                return _serve(simulation, hil, progress, None if real_time else speed)
            loop = FreeLoop(simulation, hil, gcs, speed, progress)
            # With a ground station the flight runs until it is interrupted.
            loop.run(None if gcs else round(scenario.duration_s * 1e6))
            return 0
        except KeyboardInterrupt:
            progress.say("stopped")
            return 0
        # Also after Ctrl-C: the summary says how far the flight got.
        finally:
            progress.end(simulation.truth.t_us, time.monotonic())


def _opened(text: str) -> closing[Link]:
    return closing(open_link(text, bare_udp="udpout"))


def check_sensors(scenario: Scenario) -> None:
    """Refuse more sensors of a kind than PX4 accepts from HIL_SENSOR.

    Raises
    ------
    ConfigError
        If a list of sensors is too long, or an id too high.
    """
    for kind, most in (("imu", IMU_IDS), ("mag", MAG_IDS), ("baro", BARO_IDS)):
        section = getattr(scenario.sensors, kind) or []
        # One sensor or several.
        sensors = section if isinstance(section, list) else [section]
        if len(sensors) > most:
            raise ConfigError(
                f"sensors.{kind}: {len(sensors)} are too many for a HIL link; use at most {most}"
            )
        for sensor in sensors:
            # Ids count from zero.
            if sensor.id >= most:
                raise ConfigError(
                    f"sensors.{kind}.id = {sensor.id} is too high for HIL; use 0 to {most - 1}"
                )


def _serve(simulation: Simulation, link: Link, progress: Progress, speed: float | None) -> int:
    """Fly under the autopilot on a link: in lockstep at a speed, or in real time with None."""
    mav_type, mix = mav_type_and_mix(simulation)
    packer, inbox = HilPacker(simulation.board, mav_type=mav_type), Inbox(link)
    if speed is not None:
        lockstep = LockstepLoop(simulation, packer, inbox, mix, speed, progress)
        return serve_autopilot(lockstep, progress, None)
    loop = RealTimeLoop(simulation, packer, inbox, mix, progress)
    try:
        return serve_autopilot(loop, progress, None)
    finally:
        progress.say(loop.overruns.text())


def mav_type_and_mix(simulation: Any) -> tuple[MavType, Mix]:
    """The vehicle's MAV_TYPE, and the mapping from PX4's channels to its actuators."""
    kind, vehicle = simulation.kind, simulation.vehicle
    return kind.mav_type(vehicle), kind.mix(vehicle)


class FreeLoop:
    """Runs the vehicle with its built-in controller and publishes its frames.

    Parameters
    ----------
    simulation : Simulation
    hil : Link or None
        The link for HIL frames.
    gcs : sequence of Link
        The links to ground stations.
    speed : float
        Multiple of real time; infinite for as fast as possible.
    """

    def __init__(
        self,
        simulation: Simulation,
        hil: Link | None,
        gcs: Sequence[Link],
        speed: float,
        progress: Progress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.t_us = 0
        self._simulation = simulation
        self._hil = Inbox(hil) if hil else None
        self._changes = PlantChanges(simulation.plant, progress.say)
        self._battery = BatteryWarnings(progress.say)
        self._packer = HilPacker(simulation.board, mav_type=mav_type_and_mix(simulation)[0])
        self._stations = [Inbox(link) for link in gcs]
        self._services: AutopilotLink | None = None
        self._pilot: Pilot | None = None
        if gcs:
            self._services, self._pilot = create_services(simulation)
        self._pace = Pace(speed)
        self._progress = progress
        self._clock = clock
        self._links = [*gcs] if hil is None else [hil, *gcs]

    def run(self, until_us: int | None) -> None:
        """Step until `until_us`, or endlessly with None."""
        while until_us is None or self.t_us < until_us:
            self.step()
            now_s = self._clock()
            self._progress.step(self.t_us, now_s)
            wait_s = self._pace.wait_s(self.t_us, now_s)
            if wait_s > 0.0:
                wait_until_readable(self._links, wait_s)

    def step(self) -> None:
        """Take one step of the simulation and serve the links."""
        pilot = self._pilot
        # Until the ground station commands it, the built-in controller flies the scenario.
        controls = pilot.controls() if pilot and pilot.flight.goal_active else None
        self.t_us, truth, readings = self._simulation.step(controls)
        self._battery.update(truth)
        if self._hil:
            for chunk in join_datagrams(self._packer.frames(readings)):
                self._hil.link.write(chunk)
            for frame in self._hil.frames():
                # Plant faults arrive on the HIL link.
                self._changes.carry_out(frame)
        if self._services:
            answers = [
                raw
                for station in self._stations
                for frame in station.frames()
                for raw in self._services.received(frame, self.t_us)
            ]
            # Answers go out before telemetry, so that a command is acknowledged at once.
            answers += self._services.tick(
                self.t_us, truth, readings, throttle_command(self._simulation)
            )
            for station in self._stations:
                for raw in answers:
                    station.link.write(raw)


def throttle_command(simulation: Any) -> float:
    """The throttle command of the motors, 0 to 1."""
    return float(simulation.kind.throttle(simulation.controls))


def create_services(simulation: Simulation) -> tuple[AutopilotLink, Pilot]:
    """The services for a ground station, and the pilot that flies its commands."""
    start, kind = simulation.scenario.start, simulation.kind
    parameters, missions = Parameters(kind.parameters), Missions(_scenario_items(simulation))
    flight = CommandedFlight(
        parameters,
        missions,
        HomePosition(start.lat_deg, start.lon_deg, start.alt_m),
        simulation.home.ned,
        airborne=start.height_m > 0.0,
        own_mission=bool(simulation.scenario.mission) or simulation.scenario.controls is not None,
        acceptance_m=_acceptance_m(simulation, float(parameters["NAV_ACC_RAD"])),
    )
    count = kind.motors(simulation.vehicle)

    def fail_motor(number: int, off: bool) -> bool:
        # MAVLink counts motors from 1; 0 means all.
        if not 0 <= number <= count:
            return False
        for motor in range(count) if number == 0 else (number - 1,):
            simulation.plant(f"motor_efficiency[{motor}]", 0.0 if off else None)
        return True

    link = AutopilotLink(flight, parameters, missions, fail_motor, mav_type_and_mix(simulation)[0])
    return link, Pilot(simulation, flight)


def _scenario_items(simulation: Simulation) -> tuple[MissionItem, ...]:
    """The scenario's mission as mission items for download; empty without a mission."""
    track = simulation.controller.track if simulation.scenario.mission else None
    if not isinstance(track, PathTrack):
        return ()
    scenario = simulation.scenario
    return waypoint_items(path_waypoints(track.path, scenario.start, scenario.vehicle.kind))


def _acceptance_m(simulation: Simulation, radius_m: float) -> float:
    """Acceptance radius [m]; a vehicle that circles a waypoint has reached it on its circle."""
    cruise = simulation.vehicle.parameters.cruise_mps
    track = simulation.controller.circle(0.0, 0.0, 0.0, cruise)
    # A third more than the circle's radius.
    return 1.3 * track.radius_m if isinstance(track, CircleTrack) else radius_m


def join_datagrams(frames: list[bytes]) -> list[bytes]:
    """Join frames into chunks that each fit a datagram."""
    joined = b"".join(frames)
    # The common case: one datagram per step.
    if len(joined) <= DATAGRAM_MAX_BYTES:
        return [joined]
    chunks = [b""]
    for frame in frames:
        # A frame is never split: a receiver expects complete frames in each datagram.
        if len(chunks[-1]) + len(frame) > DATAGRAM_MAX_BYTES:
            chunks.append(b"")
        chunks[-1] += frame
    return chunks
