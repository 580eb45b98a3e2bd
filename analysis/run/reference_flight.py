"""The fault-free reference flight of a run: the same scenario and seed, flown in parallel.

The same seed gives the same bytes, so any difference between the two flights is due to the faults.
"""

import signal
import sys
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from analysis.monitor.monitor import Monitor
from analysis.processes import spawn_context
from analysis.report.run_folder import ResultFile
from analysis.run.proxied_flight import ProxiedFlight, recorder_session
from analysis.run.run_setup import RunSetup
from mavproxy_fault.app.recorder import Recorder

REFERENCE_FOLDER = "clean"
BATCH_BYTES = 32_768  # the monitor is fastest on large batches
NO_LIMIT_US = 1 << 62


class ReferenceRun(NamedTuple):
    """The process of the reference flight, and its end time `until_us`, which the run may set."""

    process: BaseProcess
    until_us: Any

    def wait_until(self, until_us: int) -> bool:
        """Wait until it has flown to a time; return whether it succeeded."""
        self.until_us.value = until_us
        self.process.join()
        if self.process.exitcode:
            code = self.process.exitcode
            print(f"the fault-free reference flight failed with code {code}", file=sys.stderr)
        return self.process.exitcode == 0


def start_reference_flight(setup: RunSetup, folder: Path) -> ReferenceRun:
    """Start the reference flight in its own process, with its folder inside the run folder."""
    reference_folder = folder / REFERENCE_FOLDER
    # Created before the process starts, so that an error here is the run's.
    reference_folder.mkdir()
    context = spawn_context()
    until_us = context.Value("q", NO_LIMIT_US)
    process = context.Process(
        target=run_reference_flight, args=(setup, reference_folder, until_us), daemon=True
    )
    process.start()
    return ReferenceRun(process, until_us)


def run_reference_flight(setup: RunSetup, folder: Path, until_us: Any) -> None:
    """Fly a scenario without faults to its end or to `until_us`; write logs and results to a
    folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run handles Ctrl-C and ends this process
    schedule = msgspec.structs.replace(setup.schedule, faults=())
    flight, monitor = ProxiedFlight(setup.scenario, schedule), Monitor(setup.monitor)
    recorder = Recorder(folder, recorder_session(setup.scenario.name, schedule.seed, flight))
    batch = bytearray()
    with ResultFile(folder) as file:
        while not flight.finished and flight.now_us < until_us.value:
            batch += flight.advance([]).monitor
            if len(batch) >= BATCH_BYTES:
                file.write(monitor.push_bytes([bytes(batch)], datagrams=False))
                recorder.write(flight.capture, flight.drain_labels())
                batch.clear()
        # The last batch, and frames sent at the end of the flight.
        batch += flight.finish().monitor
        file.write(monitor.push_bytes([bytes(batch)], datagrams=False))
    recorder.write(flight.capture, flight.drain_labels())
    recorder.close(flight.core.clock.t0_us, flight.now_us)
