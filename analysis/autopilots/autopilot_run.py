"""`run --autopilot`: a scenario flown by a real autopilot, watched, recorded and reported.

Simulator and proxy run here in one process, the monitor in one of its own; the autopilot's program
is started and ended with the flight. The schedule counts from a moment of the flight, by default
from leaving the ground.
"""

import argparse
import contextlib
import gc
import os
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import msgspec

from analysis.autopilots.ardupilot import ardupilot_program
from analysis.autopilots.flight_operator import LOOK_US, Operator, Requests
from analysis.autopilots.flight_plan import HEIGHTS_M, flight_plan
from analysis.autopilots.hil_exchange import FromAutopilot, Patience, ToAutopilot, of_lockstep
from analysis.autopilots.onlookers import Onlookers
from analysis.autopilots.own_parameters import read_parameters
from analysis.autopilots.plain_flight import plain_flight
from analysis.autopilots.program import Program, Start, Unhurried
from analysis.autopilots.px4 import px4_program
from analysis.report.run_folder import ResultFile, make_folder, write_summary
from analysis.run.idle import tell_idle
from analysis.run.proxied_flight import GROUND, Flight, session
from analysis.run.run_command import EXIT_CODES, report
from analysis.run.setup import Setup, setup_of
from analysis.run.stop import Stop, stop_requests
from analysis.run.terminal import print_summary
from analysis.run.worker import MonitorProcess
from analysis.scoring.criteria import Check
from mavproxy_fault.app.recorder import EDITS, Recorder
from mavproxy_fault.compiled.passage import new_passage
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import Bus, open_run_bus
from mavproxy_fault.live.journal import JOIN, Journal, read_edits, told_edits
from mavproxy_fault.proxy.interfaces import Send
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.schedule.saving import as_yaml
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.tlog import read_columns
from simvehicle.app.lockstep_loop import LockstepLoop, PeerGoneError
from simvehicle.app.pace import parse_speed
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import airframe
from simvehicle.hil.hil_frames import Hil
from simvehicle.hil.lockstep import AutopilotSilentError, Lockstep
from simvehicle.scenario.scenario_file import Scenario

RECORD_US = 200_000  # simulated time between writes to the logs
START_S = 60.0  # wall time for the autopilot's program to come
AUTOPILOTS = {"ardupilot": ardupilot_program, "px4": px4_program}
LOAD = "@ctl/schedule/load"
MOMENTS = ("first-stamp", "arming", "take-off", "landing")
PRIORITY = 80  # PX4's logger and telemetry have 74 and below, its sensors and control 90 and above


@contextlib.contextmanager
def ahead_of_logs() -> Iterator[None]:
    """Run this thread at a real-time priority where that is allowed.

    PX4 started by root runs all its threads so: its logger would hold up the step that it waits
    for. Threads and processes begun meanwhile do not inherit it.
    """
    gc.freeze()  # what is loaded stays; to look it through would hold up a step by 0.1 s
    with contextlib.ExitStack() as undo:
        undo.callback(gc.unfreeze)
        # Not on every system, and not for every user.
        with contextlib.suppress(AttributeError, PermissionError):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
            undo.callback(_step_back, *before)
        yield


def _step_back(policy: int, priority: "os.sched_param") -> None:
    """Give a real-time priority back; the flag about forks only a privileged thread may drop."""
    try:
        os.sched_setscheduler(0, policy, priority)
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, priority)


class FlightOverError(Exception):
    """The operator has nothing more to do, or somebody wants the flight to end."""


def main(args: argparse.Namespace) -> int:
    """Fly, report, and return the exit code: 1 too where the flight was not flown to its end."""
    name, _, vehicle = args.autopilot.partition(":")
    autopilot = AUTOPILOTS[name]
    if args.against_clean:
        raise ConfigError(
            f"--against-clean: two flights of {name} differ without any fault, too; run both"
            " schedules, and hold their logs against each other by report --against"
        )
    check_moment(args.count_from)
    own = read_parameters(args.parameters)
    setup = setup_of(args)
    check_vehicle(setup.scenario)
    binary = autopilot.BINARIES[setup.scenario.vehicle.kind]
    if vehicle and binary != f"ardu{vehicle}":
        raise ConfigError(
            f"--autopilot {args.autopilot}: the scenario's vehicle is a "
            f"{setup.scenario.vehicle.kind}, which {binary} flies"
        )
    words = autopilot.command(args.binary or binary)
    folder = make_folder(args.out, setup.scenario.name)
    started_s = time.monotonic()
    with contextlib.ExitStack() as stack:
        monitor = stack.enter_context(MonitorProcess(setup.monitor, records=True))
        file = stack.enter_context(ResultFile(folder))
        stop = stack.enter_context(stop_requests())
        flown = AutopilotRun(setup, folder, args.count_from, monitor, stop)
        # At full speed nobody watches, and every message costs: only where somebody asks.
        if args.ui or args.zenoh != "auto":
            bus = open_run_bus(args.zenoh, folder.name, config_file=args.zenoh_config)
            flown.show_on(stack.enter_context(bus))
        simulation = flown.flight.simulation
        requests = stack.enter_context(autopilot.requests(simulation))
        program = autopilot.started(words, simulation, folder, own)
        reason = flown.fly(
            program, requests, parse_speed(args.speed or ("1" if args.ui else "max"))
        )
        columns = read_columns(folder / "sent.tlog")
        file.write(flown.results + monitor.results())
        wall_s = time.monotonic() - started_s
        labels = flown.flight.completed_labels()
        summary = monitor.summary(labels, setup.criteria, wall_s)
    tell_idle(summary, setup.schedule, labels)
    if reason:
        tell_early_end(summary, reason)
    summary["autopilot"] = flown.account(reason)
    summary["edited"] = flown.edited(folder)
    write_summary(folder, summary)
    if args.report:
        report(folder, summary, columns)
    print_summary(summary, folder)
    return 1 if reason else EXIT_CODES[summary["verdict"]]


def tell_early_end(summary: dict[str, Any], reason: str) -> None:
    """Put into a summary that the flight was not flown to its end: whatever was seen, it fails."""
    check = Check(name="flown to the landing", limit="landed", value=reason, passed=False)
    summary["criteria"].append(msgspec.structs.asdict(check))
    summary["verdict"] = "FAIL"


def check_vehicle(scenario: Scenario) -> None:
    """Refuse what no autopilot flies here.

    Raises
    ------
    ConfigError
        With what is wrong.
    """
    if scenario.vehicle.kind not in HEIGHTS_M:
        raise ConfigError(
            f"vehicle.kind = {scenario.vehicle.kind} is not flown by an autopilot here; "
            f"{' or '.join(HEIGHTS_M)} is"
        )
    if scenario.start.height_m > 0.0:
        raise ConfigError(
            f"start.height_m = {scenario.start.height_m:g} is in the air; an autopilot "
            "takes off by itself, so leave it out"
        )


def check_moment(moment: str) -> None:
    """Refuse a moment that no flight has.

    Raises
    ------
    ConfigError
        If it is none.
    """
    head, _, number = moment.partition(":")
    if moment not in MOMENTS and not (head == "mission-item" and number.isdigit()):
        raise ConfigError(
            f"--from {moment}: is no moment of a flight; known: {', '.join(MOMENTS)}, "
            "mission-item:N"
        )


class AutopilotRun:
    """One flight: what is recorded, and when the schedule begins."""

    def __init__(
        self,
        setup: Setup,
        folder: Path,
        count_from: str,
        monitor: MonitorProcess,
        stop: Stop,
    ) -> None:
        # The faults come once the chosen moment is there, but for those that name one themselves.
        own = tuple(entry for entry in setup.schedule.faults if "from" in entry.written)
        self.flight = Flight(setup.scenario, Schedule(setup.schedule.seed, own))
        self.results: list[Any] = []
        self._schedule = setup.schedule
        self._count_from, self._stop = count_from, stop
        self._monitor = monitor
        self._journal = Journal(self.flight.core, self.flight.tape)
        self._journal.note(JOIN, b"", self._journal.begin(self.flight.now_us))
        self._recorder = Recorder(
            folder, session(setup.scenario.name, setup.schedule.seed, self.flight)
        )
        self._parser = Parser()
        self._passage = new_passage(self.flight.core, self.flight.tape)
        self._unhurried = Unhurried()
        self._recorded_us = self._operator_us = 0
        self._loaded: str | None = None  # the schedule as it began
        self._progress = Progress(time.monotonic())
        self._phase = ""
        self._onlookers: Onlookers | None = None

    def show_on(self, bus: Bus | None) -> None:
        """Publish the flight on a bus, and let faults be armed from there."""
        if bus is not None:
            self._onlookers = Onlookers(bus, self.flight, self._journal)

    def fly(
        self, program: AbstractContextManager[Program], requests: Requests, speed: float
    ) -> str:
        """Fly to the landing; why it did not come to it, or nothing."""
        simulation = self.flight.simulation
        self._requests = requests
        self._operator = Operator(flight_plan(simulation), requests)
        mav_type, mix = airframe(simulation)
        hil = Hil(mav_type=mav_type)
        plain = plain_flight(simulation, hil, self._passage)
        with program as flying:
            self._start = Start(flying)
            patience = Patience(flying.links[0], flying.process, START_S)
            lockstep = Lockstep()
            outward = ToAutopilot(
                self.flight,
                hil,
                self._hear,
                self._commands,
                flying.links[-1],
                flying.step,
                self._passage,
            )
            inward = FromAutopilot(outward, flying.links, patience, lockstep)
            loop = LockstepLoop(
                simulation,
                outward,
                inward,
                mix,
                speed,
                self._progress,
                lockstep,
                plain if plain and plain.join(outward, inward, lockstep) else None,
            )
            reason = ""
            try:
                with ahead_of_logs():
                    loop.run()
            except FlightOverError as over:
                reason = str(over)
            except (PeerGoneError, AutopilotSilentError) as gone:
                reason = f"{gone} at {loop.t_us * 1e-6:.1f} s{flying.last_words()}"
            except ConfigError as wrong:
                reason = f"{wrong}{flying.last_words()}"
        outward.hear_all()
        self._close()
        if reason and simulation.truth.battery_remaining <= 0.0:
            reason += "; the simulated battery was empty"
        if reason:
            self._progress.say(f"the flight ended early: {reason}")
        return reason

    def account(self, reason: str) -> dict[str, Any]:
        """What `summary.json` tells of the autopilot; times are the vehicle's in seconds."""
        operator = self._operator
        return {
            "landed": operator.phase == "landed",
            "ended_early": reason,
            "moments_s": {name: t_us * 1e-6 for name, t_us in operator.moments_us.items()},
            "schedule_counts_from": self._count_from,
            "texts": [[round(t_us * 1e-6, 3), text] for t_us, text in operator.texts],
        }

    def edited(self, folder: Path) -> list[str]:
        """What was asked live, for people; not that the schedule began."""
        edits = [edit for edit in read_edits(folder / EDITS) if edit.payload != self._loaded]
        return told_edits(edits, self.flight.core.clock.t0_us or 0)

    def _hear(self, sends: list[Send]) -> None:
        for send in sends:
            if send.link == GROUND and not of_lockstep(send.data):
                for item in self._parser.push(send.data, datagram=True):
                    if isinstance(item, Frame):
                        self._operator.heard(item)

    def _take(self, results: list[Any]) -> None:
        self.results += results
        if self._onlookers is not None:
            self._onlookers.tell(results)

    def _commands(self) -> list[bytes]:
        """Called before each step: what the operator sends, and what has to be written."""
        if self._onlookers is not None:
            self._onlookers.serve()
        t_us = self.flight.vehicle_us
        self._start.hold(t_us)
        self._unhurried.hold(t_us, awaiting=self._requests.awaiting)
        frames: list[bytes] = []
        if t_us >= self._operator_us:
            self._operator_us = t_us + LOOK_US
            on_ground = self.flight.simulation.truth.on_ground
            # Before the first stamp there is no time.
            started = self._start.over
            frames = self._operator.step(t_us, on_ground=on_ground, started=started) if t_us else []
        if self._loaded is None and self._count_from in self._operator.moments_us:
            self._begin_schedule(t_us)
        if self._phase != self._operator.phase:
            self._phase = self._operator.phase
            self._progress.say(f"{t_us * 1e-6:8.1f} s {self._phase}")
        # Ctrl-C is looked at here as well: between two writes the logs are whole.
        if self.flight.t_us - self._recorded_us >= RECORD_US:
            self._record()
            if self._stop():
                raise FlightOverError("stopped")
            if self._operator.over:
                raise FlightOverError(self._operator.gave_up)
        return frames

    def _begin_schedule(self, t_us: int) -> None:
        """Load the schedule, its times counted from now; the journal lets a replay do the same."""
        # The schedule counts from the first stamp; this moment lies so much later.
        late_s = (t_us - (self.flight.core.clock.t0_us or t_us)) * 1e-6
        entries = [
            (entry, 0.0 if "from" in entry.written else late_s) for entry in self._schedule.faults
        ]
        self._loaded = as_yaml(self._schedule.seed, entries)
        text = self._loaded.encode()
        at_us = self._journal.begin(self.flight.now_us)
        self.flight.control.answer(LOAD, text, at_us)
        self._journal.note(LOAD, text, at_us)

    def _record(self) -> None:
        self._recorded_us = self.flight.t_us
        labels = self.flight.drain_labels()
        if self._passage is not None:
            self._passage.count()
        sent = bytes(self.flight.tape.sent)
        self._recorder.write(self.flight.tape, labels, self._journal.drain())
        # Somebody may watch: results must not wait for a full batch then.
        self._take(self._monitor.feed(sent, now=self._onlookers is not None))
        if self._onlookers is not None:
            self._onlookers.tell_labels(labels)

    def _close(self) -> None:
        self._hear(self.flight.core.finish(self.flight.now_us))
        self._record()
        if self._onlookers is not None:
            self._onlookers.close()
        self._recorder.close(self.flight.core.clock.t0_us, self.flight.now_us)
        self._progress.end(self.flight.t_us, time.monotonic())
