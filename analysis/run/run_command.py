"""`run`: fly a scenario through the proxy, monitor, record and report it."""

import argparse
import contextlib
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from analysis.monitor.publish import Publisher
from analysis.report.curves.fault_effects import deviation_curves, measure_effects
from analysis.report.curves.recording import FlightData, Signal
from analysis.report.run_folder import ResultFile, make_folder, write_summary
from analysis.results import Result, read_results
from analysis.run.monitor_process import MonitorProcess
from analysis.run.proxied_flight import ProxiedFlight, recorder_session
from analysis.run.reference_flight import REFERENCE_FOLDER, start_reference_flight
from analysis.run.run_setup import setup_from_args
from analysis.run.stop_signal import stop_requests
from analysis.run.terminal_summary import show_summary
from analysis.run.vehicle_judging import judge_vehicle_of_run, report_unmatched_faults
from analysis.work_progress import WorkProgress
from mavproxy_fault.app.recorder import EDITS, Recorder
from mavproxy_fault.links.bus import open_run_bus
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.live.edit_log import JOIN, EditLog, describe_edits, read_edits
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import Columns, read_columns
from simvehicle.app.battery_warnings import BatteryWarnings
from simvehicle.app.pace import Pace, parse_speed

RECORD_PERIOD_US = 200_000  # simulated time between writes to the logs
MAX_PENDING_BATCHES = 10  # two seconds of flight by which the monitor may lag behind a live page
MONITOR_WAIT_S = 0.02  # chosen


def main(args: argparse.Namespace) -> int:
    """Fly, report, and return the verdict's exit code."""
    setup = setup_from_args(args)
    # A live page needs real time; without one, fly as fast as possible.
    pace = Pace(parse_speed(args.speed or ("1" if args.ui else "max")))
    folder = make_folder(args.out, setup.scenario.name)
    args.out = str(folder)  # for the page beside the run
    # Started first, so that both processes compile in parallel.
    reference = start_reference_flight(setup, folder) if args.against_clean else None
    with contextlib.ExitStack() as stack:
        # Before the bus, whose threads would prevent a fork.
        monitor = stack.enter_context(MonitorProcess(setup.monitor))
        run_bus = open_run_bus(args.zenoh, folder.name, config_file=args.zenoh_config)
        bus = stack.enter_context(run_bus)
        file = stack.enter_context(ResultFile(folder))
        publisher = Publisher(bus) if bus else None

        def deliver(results: list[Result]) -> None:
            file.write(results)
            if publisher is not None:
                publisher.publish(results)

        flight = ProxiedFlight(setup.scenario, setup.schedule)
        edit_log = EditLog(flight.core, flight.capture)
        # From the first byte, so that a replay starts live control at the same place.
        edit_log.note(JOIN, b"", edit_log.begin(flight.now_us))
        live = stack.enter_context(
            contextlib.closing(
                LiveSession(flight.control, lambda: edit_log.begin(flight.now_us), edit_log)
            )
        )
        if bus is not None:
            live.offer(bus)
        link = open_ground_link(args.gcs, pace)
        started_s = time.monotonic()
        recorder = Recorder(
            folder, recorder_session(setup.scenario.name, setup.schedule.seed, flight)
        )
        run_flight(flight, monitor, recorder, pace, deliver, link, live, together=args.ui)
        # Read while the monitor's process completes its backlog.
        columns = read_columns(folder / "sent.tlog")
        deliver(monitor.results())
        # The wall time excludes the report.
        wall_s = time.monotonic() - started_s
        labels = flight.completed_labels()
        summary = monitor.summary(labels, setup.criteria, wall_s)
    judge_vehicle_of_run(summary, columns, labels, setup, folder)
    report_unmatched_faults(summary, setup.schedule, labels)
    summary["edited"] = describe_edits(read_edits(folder / EDITS), flight.core.clock.t0_us or 0)
    curves = []
    # It runs in parallel on the second core, and is usually complete by now.
    if reference is not None and reference.wait_until(flight.now_us):
        t0_us = flight.core.clock.t0_us or 0
        curves = deviation_curves(folder, folder / REFERENCE_FOLDER, t0_us)
        summary["effects"] = measure_effects(curves, labels, t0_us)
    write_summary(folder, summary)
    if args.report:
        write_flight_report(folder, summary, columns, curves)
    return show_summary(args, summary, folder)


def run_flight(
    flight: ProxiedFlight,
    monitor: MonitorProcess,
    recorder: Recorder,
    pace: Pace,
    deliver: Callable[[list[Result]], None],
    ground: Link | None,
    live: LiveSession,
    *,
    together: bool,
) -> None:
    """Fly to the end of the scenario or until Ctrl-C, and close the logs.

    With `together`, for a live page, the flight waits for a monitor that falls behind.
    """
    recorded_us = 0
    with WorkProgress("flying", flight.duration_s) as progress:
        battery = BatteryWarnings(progress.say)
        with stop_requests() as stop:
            # Stop only between two steps, so that logs stay complete.
            while not (flight.finished or stop()):
                # A live page must not show verdicts long after the flight.
                monitor_lags = together and monitor.pending_batches > MAX_PENDING_BATCHES
                wait_s = (
                    MONITOR_WAIT_S if monitor_lags else pace.wait_s(flight.t_us, time.monotonic())
                )
                if wait_s > 0.0:
                    time.sleep(wait_s)
                live.serve()
                # The wall clock only paces the page, not the flight.
                live.show(time.monotonic())
                if monitor_lags:
                    deliver(monitor.feed(b"", now=True))
                    continue
                sent = flight.advance([data for _, data in ground.read()] if ground else [])
                deliver(monitor.feed(sent.monitor))
                if ground is not None:
                    for data in sent.ground:
                        ground.write(data)
                if flight.t_us - recorded_us >= RECORD_PERIOD_US:
                    recorded_us = flight.t_us
                    labels = flight.drain_labels()
                    battery.update(flight.simulation.truth)
                    recorder.write(flight.capture, labels, live.edits())
                    live.publish(flight.stats(), labels)
                    # A live viewer must not wait for a full batch.
                    if together or math.isfinite(pace.speed):
                        deliver(monitor.feed(b"", now=True))
                    active = ", ".join(flight.engine.active) or "no fault"
                    progress.show(flight.t_us * 1e-6, active)
        # A stop ends the faults just as the scenario's end does.
        deliver(monitor.feed(flight.finish().monitor, now=True))
        recorder.write(flight.capture, flight.drain_labels(), live.edits())
        recorder.close(flight.core.clock.t0_us, flight.now_us)


def open_ground_link(spec: str, pace: Pace) -> Link | None:
    """Open the ground station's link; None at full speed, which no ground station can follow."""
    if math.isinf(pace.speed) or spec == "off":
        return None
    return open_link(spec, bare_udp="udpout")


def write_flight_report(
    folder: Path, summary: dict[str, Any], columns: Columns, curves: Sequence[Signal] = ()
) -> None:
    """Write `report.html` from a run folder, the columns of `sent.tlog`, and further curves."""
    from analysis.report.run_report import write_run_report

    write_run_report(
        folder,
        summary=summary,
        labels=read_labels(folder / "labels.jsonl"),
        results=read_results(folder / "results.jsonl"),
        columns=columns,
        title=folder.name,
        beside=FlightData("", signals=list(curves)),
    )
