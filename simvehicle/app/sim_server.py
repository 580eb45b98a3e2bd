"""`sim`: a scenario flown in real time, faster, or in lockstep with an autopilot.

With `--hil tcpin:` (or `tcp:`) an autopilot flies the vehicle in lockstep, on a serial device or
with `--real-time` one that runs on its own board; else the vehicle's own controller does, and HIL
frames are published to whoever listens. With `--gcs` a ground station commands it; a mission of the
scenario's own is flown until it does. Without one the scenario ends in time.
"""

import argparse
import time
from collections.abc import Callable
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

DATAGRAM_MAX_BYTES = 1400  # bytes that cross an Ethernet in one piece


def main(args: argparse.Namespace) -> int:
    """Run the simulator; the exit code."""
    speed = parse_speed(args.speed)
    scenario = read_scenario(args.scenario)
    if args.plot:
        from simvehicle.app.flight_plot import plot_scenario

        return plot_scenario(scenario, args.seed, args.plot)
    kind = parse_spec(args.hil).kind if args.hil else ""
    real_time = args.real_time or kind == "serial"
    check_real_time(args, real_time=real_time)
    # TCP is PX4's way; over UDP nobody answers but hardware.
    served = real_time or kind in ("tcpin", "tcp")
    if served and args.gcs:
        raise ConfigError(
            f"--gcs: {args.gcs} is not served beside --hil {args.hil}, whose autopilot answers "
            "ground stations itself; leave one of them out"
        )
    if args.hil:
        check_sensors(scenario)
    Simulation(scenario, args.seed).step()  # compiles the kernels before anyone waits for a step
    simulation = Simulation(scenario, args.seed)
    progress = Progress(time.monotonic())
    with ExitStack() as links:
        hil, gcs = (
            links.enter_context(closing(open_link(text, bare_udp="udpout"))) if text else None
            for text in (args.hil, args.gcs)
        )
        try:
            if real_time and hil is not None:
                return _run_real_time(simulation, hil, progress)
            if served and hil is not None:
                return _run_lockstep(simulation, hil, speed, progress)
            loop = FreeLoop(simulation, hil, gcs, speed, progress)
            # With a ground station the flight goes on until somebody ends it.
            loop.run(None if gcs else round(scenario.duration_s * 1e6))
            return 0
        except KeyboardInterrupt:
            progress.say("stopped")
            return 0
        # Also after Ctrl-C: how far it came is said at the end.
        finally:
            progress.end(simulation.truth.t_us, time.monotonic())


def check_real_time(args: argparse.Namespace, *, real_time: bool) -> None:
    """Refuse what hardware cannot have.

    Raises
    ------
    ConfigError
        With the option.
    """
    if args.real_time and not args.hil:
        raise ConfigError("--real-time: needs --hil, the link to the autopilot")
    if real_time and args.speed != "1":
        raise ConfigError(f"--speed: {args.speed} is not for hardware, whose clock is real; 1 is")


def check_sensors(scenario: Scenario) -> None:
    """Refuse more sensors of a kind than PX4 takes from HIL_SENSOR.

    Raises
    ------
    ConfigError
        If a list of sensors is too long, or an id too high.
    """
    for kind, most in (("imu", IMU_IDS), ("mag", MAG_IDS), ("baro", BARO_IDS)):
        fitted = getattr(scenario.sensors, kind) or []
        # One sensor or several.
        every = fitted if isinstance(fitted, list) else [fitted]
        if len(every) > most:
            raise ConfigError(
                f"sensors.{kind}: {len(every)} are too many for a HIL link; at most {most}"
            )
        for sensor in every:
            # Ids count from zero.
            if sensor.id >= most:
                raise ConfigError(
                    f"sensors.{kind}.id = {sensor.id} is not read from a HIL link; 0 to {most - 1}"
                )


def _run_lockstep(simulation: Simulation, link: Link, speed: float, progress: Progress) -> int:
    mav_type, mix = mav_type_and_mix(simulation)
    packer = HilPacker(mav_type=mav_type)
    loop = LockstepLoop(simulation, packer, Inbox(link), mix, speed, progress)
    return serve_autopilot(loop, progress, None)


def _run_real_time(simulation: Simulation, link: Link, progress: Progress) -> int:
    mav_type, mix = mav_type_and_mix(simulation)
    loop = RealTimeLoop(simulation, HilPacker(mav_type=mav_type), Inbox(link), mix, progress)
    try:
        return serve_autopilot(loop, progress, None)
    finally:
        progress.say(loop.overruns.text())


def mav_type_and_mix(simulation: Any) -> tuple[MavType, Mix]:
    """What the vehicle calls itself, and how PX4's channels drive it."""
    kind, vehicle = simulation.kind, simulation.vehicle
    return kind.mav_type(vehicle), kind.mix(vehicle)


class FreeLoop:
    """The vehicle flown by its own controller, published as it goes.

    Parameters
    ----------
    simulation : Simulation
    hil, gcs : Link or None
        Where HIL frames go; where a ground station is.
    speed : float
        Times real time, infinite for as fast as possible.
    """

    def __init__(
        self,
        simulation: Simulation,
        hil: Link | None,
        gcs: Link | None,
        speed: float,
        progress: Progress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.t_us = 0
        self._simulation = simulation
        self._hil = Inbox(hil) if hil else None
        self._changes = PlantChanges(simulation, progress.say)
        self._battery = BatteryWarnings(progress.say)
        self._packer = HilPacker(mav_type=mav_type_and_mix(simulation)[0])
        self._gcs = Inbox(gcs) if gcs else None
        self._services: AutopilotLink | None = None
        self._pilot: Pilot | None = None
        if gcs:
            self._services, self._pilot = create_services(simulation)
        self._pace = Pace(speed)
        self._progress = progress
        self._clock = clock
        self._links = [link for link in (hil, gcs) if link is not None]

    def run(self, until_us: int | None) -> None:
        """Step until `until_us`, or for ever."""
        while until_us is None or self.t_us < until_us:
            self.step()
            now_s = self._clock()
            self._progress.step(self.t_us, now_s)
            wait_s = self._pace.wait_s(self.t_us, now_s)
            if wait_s > 0.0:
                wait_until_readable(self._links, wait_s)

    def step(self) -> None:
        """One step of the simulation and of everything on the links."""
        pilot = self._pilot
        # Until a ground station commands, the scenario's own controller flies.
        controls = pilot.controls() if pilot and pilot.flight.goal_active else None
        self.t_us, truth, readings = self._simulation.step(controls)
        self._battery.update(truth)
        if self._hil:
            for chunk in join_datagrams(self._packer.frames(self.t_us, truth, readings)):
                self._hil.link.write(chunk)
            for frame in self._hil.frames():
                # Plant faults come back on the HIL link.
                self._changes.carry_out(frame)
        if self._gcs and self._services:
            link = self._gcs.link
            answers = [
                raw
                for frame in self._gcs.frames()
                for raw in self._services.received(frame, self.t_us)
            ]
            # Answers before telemetry: a command is acknowledged at once.
            answers += self._services.tick(
                self.t_us, truth, readings, throttle_command(self._simulation)
            )
            for raw in answers:
                link.write(raw)


def throttle_command(simulation: Any) -> float:
    """The motors' command, 0 to 1."""
    return float(simulation.kind.throttle(simulation.controls))


def create_services(simulation: Simulation) -> tuple[AutopilotLink, Pilot]:
    """The ground station's view of a simulation, and who flies what it commands."""
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
    """The scenario's mission as a ground station downloads it; empty without one."""
    track = simulation.controller.track if simulation.scenario.mission else None
    if not isinstance(track, PathTrack):
        return ()
    scenario = simulation.scenario
    return waypoint_items(path_waypoints(track.path, scenario.start, scenario.vehicle.kind))


def _acceptance_m(simulation: Simulation, radius_m: float) -> float:
    """What circles a waypoint is there once on the circle, whatever radius was asked for."""
    cruise = simulation.vehicle.parameters.cruise_mps
    wait = simulation.controller.circle(0.0, 0.0, 0.0, cruise)
    # A third more than the circle's radius.
    return 1.3 * wait.radius_m if isinstance(wait, CircleTrack) else radius_m


def join_datagrams(frames: list[bytes]) -> list[bytes]:
    """Frames joined to chunks that fit a datagram."""
    whole = b"".join(frames)
    # The common case, one datagram a step.
    if len(whole) <= DATAGRAM_MAX_BYTES:
        return [whole]
    chunks = [b""]
    for frame in frames:
        # A frame is never split: receivers of datagrams take whole frames.
        if len(chunks[-1]) + len(frame) > DATAGRAM_MAX_BYTES:
            chunks.append(b"")
        chunks[-1] += frame
    return chunks
