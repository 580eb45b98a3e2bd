"""What every flight under `run` has: monitor, bus, live control, logs, summary and report."""

import argparse
import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from analysis.monitor.publish import Publisher
from analysis.report.curves.fault_effects import measure_effects
from analysis.report.curves.recording import FlightData, Signal
from analysis.report.run_folder import ResultFile, write_summary
from analysis.results import Result, read_results
from analysis.run.monitor_process import MonitorProcess
from analysis.run.proxied_flight import ProxiedFlight, recorder_session
from analysis.run.run_setup import RunSetup
from analysis.run.terminal_summary import show_summary
from analysis.run.vehicle_judging import judge_vehicle_of_run, report_unmatched_faults
from mavproxy_fault.app.recorder import EDITS, LABELS, SENT, Recorder
from mavproxy_fault.links.bus import open_run_bus
from mavproxy_fault.live.edit_log import JOIN, EditLog, describe_edits, read_edits
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.schedule.entries import Schedule
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns

RECORD_PERIOD_US = 200_000  # simulated time between writes to the logs
# From the onset of time and a summary to the deviations from a reference flight, None without one
CurveReader = Callable[[int, dict[str, Any]], list[Signal] | None]


class FlightSession:
    """A flight of `schedule` with its logs in `folder`; the caller flies it.

    The monitor takes frames, or with `records` complete records of a log. Whatever has to be closed
    is on the `stack`.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        setup: RunSetup,
        folder: Path,
        schedule: Schedule,
        stack: contextlib.ExitStack,
        *,
        zenoh: str,
        records: bool = False,
    ) -> None:
        self.setup, self.folder = setup, folder
        self.loaded_schedule: str | None = None  # as it was loaded at a flight event
        # Before the bus, whose threads would prevent a fork.
        self.monitor = stack.enter_context(MonitorProcess(setup.monitor, records=records))
        bus = stack.enter_context(open_run_bus(zenoh, folder.name, config_file=args.zenoh_config))
        self._file = stack.enter_context(ResultFile(folder))
        self._publisher = Publisher(bus) if bus else None
        self.flight = ProxiedFlight(setup.scenario, schedule)
        self.edit_log = EditLog(self.flight.core, self.flight.capture)
        # From the first byte, so that a replay starts live control at the same place.
        self.edit_log.note(JOIN, b"", self.edit_log.begin(self.flight.now_us))
        live = LiveSession(
            self.flight.control, lambda: self.edit_log.begin(self.flight.now_us), self.edit_log
        )
        self._live = stack.enter_context(contextlib.closing(live))
        if bus is not None:
            live.offer(bus)
        session = recorder_session(setup.scenario.name, setup.schedule.seed, self.flight)
        self._recorder = Recorder(folder, session)
        self._started_s = time.monotonic()

    def serve(self) -> None:
        """Carry out live requests and publish changes; called at every step."""
        self._live.serve()
        # The wall clock only paces the page, not the flight.
        self._live.show(time.monotonic())

    def deliver(self, results: list[Result]) -> None:
        """Write results of the monitor, and publish them."""
        self._file.write(results)
        if self._publisher is not None:
            self._publisher.publish(results)

    def record(self) -> None:
        """Write to the logs what has passed since the last call, and publish faults and links."""
        labels = self.flight.drain_labels()
        self._recorder.write(self.flight.capture, labels, self._live.edits())
        self._live.publish(self.flight.stats(), labels)

    def close_logs(self) -> None:
        """Write what is still buffered, and close the logs."""
        self.record()
        self._recorder.close(self.flight.core.clock.t0_us, self.flight.now_us)

    def summarise(self) -> dict[str, Any]:
        """Wait for the monitor, and return its summary."""
        # Read while the monitor's process completes its backlog.
        self._columns = read_columns(self.folder / SENT)
        self.deliver(self.monitor.results())
        # The wall time excludes the report.
        wall_s = time.monotonic() - self._started_s
        return self.monitor.summary(self.flight.completed_labels(), self.setup.criteria, wall_s)

    def finish(
        self,
        args: argparse.Namespace,
        summary: dict[str, Any],
        read_curves: CurveReader,
        *,
        under_autopilot: bool = False,
    ) -> int:
        """Judge the vehicle after everything is closed, and write summary and report; return the
        verdict's exit code."""
        setup, labels = self.setup, self.flight.completed_labels()
        judge_vehicle_of_run(
            summary, self._columns, labels, setup, self.folder, under_autopilot=under_autopilot
        )
        report_unmatched_faults(summary, setup.schedule, labels)
        edits = read_edits(self.folder / EDITS)
        t0_us = self.flight.core.clock.t0_us or 0
        by_hand = [edit for edit in edits if edit.payload != self.loaded_schedule]
        summary["edited"] = describe_edits(by_hand, t0_us)
        curves = read_curves(t0_us, summary)
        if curves is not None:
            summary["effects"] = measure_effects(curves, labels, t0_us)
        write_summary(self.folder, summary)
        if args.report:
            self._write_report(summary, curves or [])
        return show_summary(args, summary, self.folder)

    def _write_report(self, summary: dict[str, Any], curves: Sequence[Signal]) -> None:
        from analysis.report.run_report import write_run_report

        write_run_report(
            self.folder,
            summary=summary,
            labels=read_labels(self.folder / LABELS),
            results=read_results(self.folder / "results.jsonl"),
            columns=self._columns,
            title=self.folder.name,
            beside=FlightData("", signals=list(curves)),
        )
