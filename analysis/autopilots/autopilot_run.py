"""`run --autopilot`: fly a scenario with a real autopilot, monitor, record and report it.

Simulator and proxy share this process, the monitor has its own; the autopilot's process starts and
ends with the flight. The schedule's times count from a flight event, by default the take-off.
"""

import argparse
import contextlib
import gc
import json
import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.ardupilot import ardupilot_process
from analysis.autopilots.flight_operator import (
    IGNORED_STREAMS,
    OPERATOR_PERIOD_US,
    Operator,
)
from analysis.autopilots.flight_plan import DEFAULT_HEIGHTS_M, flight_plan
from analysis.autopilots.flight_process import run_flight_process
from analysis.autopilots.hil_exchange import (
    AutopilotReceiver,
    AutopilotSender,
    ConnectionDeadline,
    is_lockstep_traffic,
)
from analysis.autopilots.operator_commands import OperatorCommands
from analysis.autopilots.px4 import px4_process
from analysis.autopilots.running_autopilot import Pacer, RunningAutopilot
from analysis.autopilots.stretches import open_stretches
from analysis.report.curves.fault_effects import deviation_curves
from analysis.report.curves.recording import Signal
from analysis.report.run_folder import make_folder
from analysis.run.flight_session import RECORD_PERIOD_US, FlightSession
from analysis.run.proxied_flight import GROUND
from analysis.run.reference_flight import REFERENCE_FOLDER
from analysis.run.run_setup import setup_from_args
from analysis.run.stop_signal import StopCheck, stop_requests
from analysis.scoring.criteria import CriterionCheck
from mavproxy_fault.compiled.passage import new_passage
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.parameter_list import read_parameters
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.schedule.entries import Entry, Schedule
from mavproxy_fault.schedule.saving import write_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser, walk_frames
from simvehicle.app.lockstep_loop import LockstepLoop, PeerGoneError
from simvehicle.app.pace import parse_speed
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import mav_type_and_mix
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import AutopilotSilentError, Lockstep
from simvehicle.scenario.scenario_file import Scenario

CONNECT_TIMEOUT_S = 60.0  # wall time for the autopilot to connect
AUTOPILOTS = {"ardupilot": ardupilot_process, "px4": px4_process}
LOAD_TOPIC = "@ctl/schedule/load"
SENSORS = frozenset(message_layout(name).id for name in ("HIL_SENSOR", "HIL_GPS"))
START_EVENTS = ("first-stamp", "arming", "take-off", "landing")
THREAD_PRIORITY = 80  # between PX4's logger and telemetry (74 and below) and its control (90)


@contextlib.contextmanager
def real_time_priority() -> Iterator[None]:
    """Run this thread at a real-time priority where permitted.

    PX4, if started by root, runs all its threads at real-time priorities: its logger would delay
    this thread, and so the next step. Threads and processes started inside do not inherit it.
    """
    gc.freeze()  # a collection over all loaded modules would delay a step by 0.1 s
    with contextlib.ExitStack() as undo:
        undo.callback(gc.unfreeze)
        # Some systems have no scheduler call, and some users no permission.
        with contextlib.suppress(AttributeError, PermissionError):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(THREAD_PRIORITY))
            undo.callback(_restore_priority, *before)
        yield


def _restore_priority(policy: int, priority: "os.sched_param") -> None:
    """Restore the priority; only a privileged thread may clear the reset-on-fork flag."""
    try:
        os.sched_setscheduler(0, policy, priority)
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, priority)


class FlightOverError(Exception):
    """The operator has finished, or a user has stopped the flight."""


def main(args: argparse.Namespace) -> int:
    """Fly, report, and return the exit code: also 1 if the flight ended early."""
    name, _, vehicle = args.autopilot.partition(":")
    autopilot = AUTOPILOTS[name]
    check_start_event(args.count_from)
    overrides = read_parameters(args.parameters)
    setup = setup_from_args(args)
    check_vehicle(setup.scenario)
    binary = autopilot.BINARIES[setup.scenario.vehicle.kind]
    if vehicle and binary != f"ardu{vehicle}":
        raise ConfigError(
            f"--autopilot {args.autopilot}: the scenario's vehicle is a "
            f"{setup.scenario.vehicle.kind}; it needs {binary}"
        )
    arguments = autopilot.launch_command(args.binary or binary)
    folder = make_folder(args.out, setup.scenario.name)
    args.out = str(folder)  # for the page beside the run
    # At full speed, publishing only costs time: publish only if requested.
    zenoh = "off" if args.zenoh == "auto" and not args.ui else args.zenoh
    faults = tuple(map(keep_telemetry, setup.schedule.faults))
    # The other faults are loaded at the chosen flight event; these name their own.
    first = Schedule(setup.schedule.seed, tuple(one for one in faults if "from" in one.written))
    with contextlib.ExitStack() as stack:
        session = FlightSession(args, setup, folder, first, stack, zenoh=zenoh, records=True)
        simulation = session.flight.simulation
        plan, modes = flight_plan(simulation), autopilot.MODES[setup.scenario.vehicle.kind]
        run = AutopilotRun(
            session,
            Schedule(setup.schedule.seed, faults),
            args.count_from,
            Operator(plan, OperatorCommands(modes, plan.waypoints, plan.landing)),
            stack.enter_context(stop_requests()),
            viewed=zenoh != "off",
        )
        launch = autopilot.start_autopilot(arguments, simulation, folder, overrides)
        reason = run.run_flight(launch, parse_speed(args.speed or ("1" if args.ui else "max")))
        summary = session.summarise()
    if reason:
        report_early_end(summary, reason)
    summary["autopilot"] = run.summary(reason)

    def read_curves(t0_us: int, summary: dict[str, Any]) -> list[Signal] | None:
        if not args.against_clean:
            return None
        return deviations_from_reference(args, setup.schedule.seed, folder, summary, t0_us)

    code = session.finish(args, summary, read_curves, under_autopilot=True)
    return 1 if reason else code


def deviations_from_reference(
    args: argparse.Namespace, seed: int, folder: Path, summary: dict[str, Any], t0_us: int
) -> list[Signal]:
    """Fly the same without faults, and return the deviations from it by the time since take-off."""
    given = {name: getattr(args, name) for name in ("autopilot", "binary", "parameters", "speed")}
    run = [args.scenario] if args.scenario else []
    run += [f"--set={change}" for change in args.set]
    run += [f"--{name}={value}" for name, value in given.items() if value is not None]
    schedule = {"seed": seed, "faults": []}
    reference = run_flight_process(
        "--against-clean", run, schedule, folder / REFERENCE_FOLDER, kept=False
    )
    clean = json.loads((reference / "summary.json").read_text())
    take_offs_s = [one["autopilot"]["moments_s"].get("take-off") for one in (summary, clean)]
    if None in take_offs_s:
        return []
    later_us = round((take_offs_s[0] - take_offs_s[1]) * 1e6)
    return deviation_curves(folder, reference, t0_us, later_us)


def report_early_end(summary: dict[str, Any], reason: str) -> None:
    """Add the failed check of an early end to a summary; its verdict becomes FAIL."""
    check = CriterionCheck(name="flight completed", limit="landed", value=reason, passed=False)
    summary["criteria"].append(msgspec.structs.asdict(check))
    summary["verdict"] = "FAIL"


def check_vehicle(scenario: Scenario) -> None:
    """Refuse scenarios that no supported autopilot can fly.

    Raises
    ------
    ConfigError
        If the vehicle's kind is unsupported or the flight starts in the air.
    """
    if scenario.vehicle.kind not in DEFAULT_HEIGHTS_M:
        raise ConfigError(
            f"vehicle.kind = {scenario.vehicle.kind} cannot be flown by an autopilot; "
            f"use {' or '.join(DEFAULT_HEIGHTS_M)}"
        )
    if scenario.start.height_m > 0.0:
        raise ConfigError(
            f"start.height_m = {scenario.start.height_m:g} starts in the air; remove it, since an "
            "autopilot takes off from the ground"
        )


def check_start_event(event: str) -> None:
    """Refuse a flight event that does not exist.

    Raises
    ------
    ConfigError
        If it is unknown.
    """
    head, _, number = event.partition(":")
    if event not in START_EVENTS and not (head == "mission-item" and number.isdigit()):
        raise ConfigError(
            f"--from {event}: is not a flight event; known: {', '.join(START_EVENTS)}, "
            "mission-item:N"
        )


def keep_telemetry(entry: Entry) -> Entry:
    """Let a sensor's fault that names no target change what the autopilot reads, and not what it
    reports in messages of the same content."""
    given = "target" in entry.written or entry.where.direction
    if given or entry.fault.acts_on == "plant" or not SENSORS.intersection(entry.ids or ()):
        return entry
    where = msgspec.structs.replace(entry.where, direction="to-vehicle")
    return msgspec.structs.replace(entry, where=where, written={**entry.written, "where": where})


class AutopilotRun:
    """One flight under an autopilot: connects its parts, records it, and starts the schedule."""

    def __init__(
        self,
        session: FlightSession,
        schedule: Schedule,
        count_from: str,
        operator: Operator,
        stop: StopCheck,
        *,
        viewed: bool,
    ) -> None:
        self._session, self._flight = session, session.flight
        self._schedule, self._count_from = schedule, count_from
        self._operator, self._stop, self._viewed = operator, stop, viewed
        self._parser = Parser()
        self._passage = new_passage(self._flight.core, self._flight.capture)
        self._recorded_us = self._operator_us = 0
        self._progress = Progress(time.monotonic())
        self._phase = ""

    def run_flight(
        self,
        launch: AbstractContextManager[RunningAutopilot],
        speed: float,
    ) -> str:
        """Fly to the landing; return the reason of an early end, or an empty string.

        Raises
        ------
        ConfigError
            If the autopilot took no step.
        """
        simulation = self._flight.simulation
        mav_type, mix = mav_type_and_mix(simulation)
        hil = HilPacker(simulation.board, mav_type=mav_type)
        stretches = open_stretches(simulation, hil, self._passage)
        with launch as running:
            self._pacer = Pacer(running)
            deadline = ConnectionDeadline(running.links[0], running.process, CONNECT_TIMEOUT_S)
            lockstep = Lockstep()
            sender = AutopilotSender(
                self._flight,
                hil,
                self._deliver,
                self._step_operator,
                running.links[-1],
                running.step_message,
                self._passage,
            )
            receiver = AutopilotReceiver(sender, running.links, deadline, lockstep)
            loop = LockstepLoop(
                simulation,
                sender,
                receiver,
                mix,
                speed,
                self._progress,
                lockstep,
                stretches if stretches and stretches.join(sender, receiver, lockstep) else None,
            )
            reason = ""
            try:
                with real_time_priority():
                    loop.run()
            except FlightOverError as ended:
                reason = str(ended)
            except (PeerGoneError, AutopilotSilentError) as lost:
                reason = f"{lost} at {loop.t_us * 1e-6:.1f} s{running.exit_details()}"
            except ConfigError as refused:
                reason = f"{refused}{running.exit_details()}"
        sender.deliver_all()
        self._close()
        if reason and loop.t_us == 0:  # nothing to report on
            raise ConfigError(reason)
        if reason and simulation.truth.battery_remaining <= 0.0:
            reason += "; the simulated battery was empty"
        if reason:
            self._progress.say(f"the flight ended early: {reason}")
        return reason

    def summary(self, reason: str) -> dict[str, Any]:
        """Return the section `autopilot` of `summary.json`; times are vehicle time [s]."""
        operator = self._operator
        return {
            "landed": operator.phase == "landed",
            "ended_early": reason,
            "moments_s": {name: t_us * 1e-6 for name, t_us in operator.events_us.items()},
            "schedule_counts_from": self._count_from,
            "texts": [[round(t_us * 1e-6, 3), text] for t_us, text in operator.texts],
        }

    def _deliver(self, sends: list[Send]) -> None:
        for send in sends:
            if send.link == GROUND and not is_lockstep_traffic(send.data):
                wanted = [
                    send.data[start:end]
                    for start, end, number in walk_frames(send.data)
                    if number not in IGNORED_STREAMS
                ]
                for item in self._parser.push(b"".join(wanted), datagram=True):
                    if isinstance(item, Frame):
                        self._operator.receive(item)

    def _step_operator(self) -> list[bytes]:
        """Return the operator's frames and write the logs when due; called before each step."""
        self._session.serve()
        t_us = self._flight.vehicle_us
        self._pacer.wait_for_pace(t_us, careful=self._operator.needs_time)
        frames: list[bytes] = []
        if t_us >= self._operator_us:
            self._operator_us = t_us + OPERATOR_PERIOD_US
            on_ground = self._flight.simulation.truth.on_ground
            # Before the first timestamp there is no vehicle time.
            started = self._pacer.started
            frames = self._operator.step(t_us, on_ground=on_ground, started=started) if t_us else []
        if self._session.loaded_schedule is None and self._count_from in self._operator.events_us:
            self._begin_schedule(t_us)
        if self._phase != self._operator.phase:
            self._phase = self._operator.phase
            self._progress.say(f"{t_us * 1e-6:8.1f} s {self._phase}")
        # Ctrl-C is handled here too: the logs are complete between two writes.
        if self._flight.t_us - self._recorded_us >= RECORD_PERIOD_US:
            self._record()
            if self._stop():
                raise FlightOverError("stopped")
            if self._operator.finished:
                raise FlightOverError(self._operator.failure)
        return frames

    def _begin_schedule(self, t_us: int) -> None:
        """Load the schedule, its times counted from now; the edit log lets a replay repeat it."""
        # The schedule counts from the first timestamp; the event is this much later.
        offset_s = (t_us - (self._flight.core.clock.t0_us or t_us)) * 1e-6
        entries = [
            (entry, 0.0 if "from" in entry.written else offset_s) for entry in self._schedule.faults
        ]
        text = write_schedule(self._schedule.seed, entries)
        self._session.loaded_schedule = text
        edit_log = self._session.edit_log
        at_us = edit_log.begin(self._flight.now_us)
        self._flight.control.answer(LOAD_TOPIC, text.encode(), at_us)
        edit_log.note(LOAD_TOPIC, text.encode(), at_us)

    def _record(self) -> None:
        self._recorded_us = self._flight.t_us
        if self._passage is not None:
            self._passage.count()
        sent = bytes(self._flight.capture.sent)
        self._session.record()
        # A live viewer must not wait for a full batch of results.
        self._session.deliver(self._session.monitor.feed(sent, now=self._viewed))

    def _close(self) -> None:
        self._deliver(self._flight.core.finish(self._flight.now_us))
        self._record()
        self._session.close_logs()
        self._progress.end(self._flight.t_us, time.monotonic())
