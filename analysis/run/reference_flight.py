"""The twin of a run: the same scenario and seed without the faults, flown beside it.

The same seed gives the same bytes, so whatever differs between the two flights is what the faults
did.
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
BATCH_BYTES = 32_768
NO_LIMIT_US = 1 << 62


class ReferenceRun(NamedTuple):
    """The process that flies the twin, and the time `until_us` it flies, which may change."""

    process: BaseProcess
    until_us: Any

    def wait_until(self, until_us: int) -> bool:
        """Wait until it has come as far as the run did; whether it came there."""
        self.until_us.value = until_us
        self.process.join()
        if self.process.exitcode:
            code = self.process.exitcode
            print(f"the twin without the faults ended with code {code}", file=sys.stderr)
        return self.process.exitcode == 0


def start_reference_flight(setup: RunSetup, folder: Path) -> ReferenceRun:
    """Begin to fly the twin in a process of its own, into a folder inside the run's."""
    own = folder / REFERENCE_FOLDER
    # Made here, before the process: a folder that cannot be made is the run's error.
    own.mkdir()
    spawned = spawn_context()
    until_us = spawned.Value("q", NO_LIMIT_US)
    process = spawned.Process(target=run_reference_flight, args=(setup, own, until_us), daemon=True)
    process.start()
    return ReferenceRun(process, until_us)


def run_reference_flight(setup: RunSetup, folder: Path, until_us: Any) -> None:
    """Fly a scenario without its faults to the end, or until a time that the run tells; logs and
    results go to the folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the run's, which ends this one
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
        # The last portion, and what the faults' end still sends.
        batch += flight.finish().monitor
        file.write(monitor.push_bytes([bytes(batch)], datagrams=False))
    recorder.write(flight.capture, flight.drain_labels())
    recorder.close(flight.core.clock.t0_us, flight.now_us)
