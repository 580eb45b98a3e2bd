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
from analysis.processes import spawning
from analysis.report.run_folder import ResultFile
from analysis.run.proxied_flight import Flight, session
from analysis.run.setup import Setup
from mavproxy_fault.app.recorder import Recorder

FOLDER = "clean"
BATCH_BYTES = 32_768
ENDLESS_US = 1 << 62


class Twin(NamedTuple):
    """The process that flies the twin, and the time `until_us` it flies, which may change."""

    process: BaseProcess
    until_us: Any

    def flown(self, until_us: int) -> bool:
        """Wait until it has come as far as the run did; whether it came there."""
        self.until_us.value = until_us
        self.process.join()
        if self.process.exitcode:
            code = self.process.exitcode
            print(f"the twin without the faults ended with code {code}", file=sys.stderr)
        return self.process.exitcode == 0


def start_twin(setup: Setup, folder: Path) -> Twin:
    """Begin to fly the twin in a process of its own, into a folder inside the run's."""
    own = folder / FOLDER
    # Made here, before the process: a folder that cannot be made is the run's error.
    own.mkdir()
    spawned = spawning()
    until_us = spawned.Value("q", ENDLESS_US)
    process = spawned.Process(target=fly_twin, args=(setup, own, until_us), daemon=True)
    process.start()
    return Twin(process, until_us)


def fly_twin(setup: Setup, folder: Path, until_us: Any) -> None:
    """Fly a scenario without its faults to the end, or until a time that the run tells; logs and
    results go to the folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the run's, which ends this one
    schedule = msgspec.structs.replace(setup.schedule, faults=())
    flight, monitor = Flight(setup.scenario, schedule), Monitor(setup.monitor)
    recorder = Recorder(folder, session(setup.scenario.name, schedule.seed, flight))
    batch = bytearray()
    with ResultFile(folder) as file:
        while not flight.over and flight.now_us < until_us.value:
            batch += flight.advance([]).monitor
            if len(batch) >= BATCH_BYTES:
                file.write(monitor.push_bytes([bytes(batch)], datagrams=False))
                recorder.write(flight.tape, flight.drain_labels())
                batch.clear()
        # The last portion, and what the faults' end still sends.
        batch += flight.finish().monitor
        file.write(monitor.push_bytes([bytes(batch)], datagrams=False))
    recorder.write(flight.tape, flight.drain_labels())
    recorder.close(flight.core.clock.t0_us, flight.now_us)
