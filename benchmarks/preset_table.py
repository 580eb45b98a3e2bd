"""Effects of each preset on a fixed wing and a quad, and the verdicts of the monitor.

`python benchmarks/preset_table.py` flies all of them on all cores and writes docs/presets.md;
an interrupted run is resumed if no source has changed. With `--check` (and optionally names of
presets) it flies them and prints the differences from the page.
"""

import argparse
import functools
import hashlib
import math
import multiprocessing
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import read_setup
from analysis.scoring.criteria import Criteria
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.schedule.presets import preset_names
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.vision import Vision

START_S, ACTS_S, END_S = 6.0, 10.0, 20.0
RANGE_M = 150.0  # of the laser, so that the fixed wing at 100 m has one
IMU_HZ = 100.0  # enough for the tests, and a flight takes a second
BATCH_BYTES = 32_768  # that `run` hands to its monitor at once
ELEVATOR = "HIL_ACTUATOR_CONTROLS.controls[7]"  # of PX4's plane, which has no channel 0
ROOT = Path(__file__).parents[1]
# ArduPilot's auxiliary functions need an ArduPilot.
PRESETS = [name for name in preset_names() if not name.startswith("ardupilot-")]
PAGE = ROOT / "docs" / "presets.md"
VEHICLES = {"fixed wing": None, "quad": str(ROOT / "examples" / "hover.yaml")}
COLUMNS = "| preset | acted | verdict | isolated | wrongly isolated | delay, s | deviation, m |"
HEAD = f"""\
# Effects of the presets

Written by `python benchmarks/preset_table.py`; `--check` compares it with new flights, and a test
flies some of them. Each preset acts from {START_S:.0f} s to {START_S + ACTS_S:.0f} s of a flight of
{END_S:.0f} s, in the simulator, proxy and monitor of `run`, with all sensors that the presets need:
the demo's fixed wing, and the quad of examples/hover.yaml with the demo's receiver. The reference
flight is the same flight without the preset. The fixed wing's actuator is the elevator, the quad's
is motor 1.

*Acted* is the number of parts that matched a message: a preset lists every message that may carry
the sensor, and messages that are not sent are ignored. The *verdict* is that of docs/verdicts.md,
for each part if they differ; a fault that is missed within ten seconds may be detected in a longer
flight. *Delay* is the time from the start to the first alarm of a test that can detect the fault.
*Deviation* is the largest distance of the true position from that of the reference flight; a dash
means less than 0.1 m.

Faults of actuators with almost no effect on the motion are missed.
"""


class PresetFlight(NamedTuple):
    """True positions (n, 3) of a flight, and its faults in the summary."""

    r_ned_m: np.ndarray
    faults: list[dict[str, Any]]


class Row(msgspec.Struct, frozen=True):
    """The effect of a preset on one vehicle, as on the page."""

    vehicle: str
    preset: str
    cells: tuple[str, ...]

    @property
    def line(self) -> str:
        """The row of the table."""
        return f"| `{self.preset}` | {' | '.join(self.cells)} |"


@functools.cache
def setting(vehicle: str) -> tuple[Scenario, MonitorConfig]:
    """Return a vehicle with all sensors that presets need, and its monitor."""
    demo = read_setup(None)
    setup = read_setup(VEHICLES[vehicle])
    scenario = setup.scenario
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=IMU_HZ)
    sensors = msgspec.structs.replace(
        scenario.sensors, imu=imu, range=Rangefinder(max_m=RANGE_M), vision=Vision()
    )
    return (
        msgspec.structs.replace(
            scenario, sensors=sensors, gnss=demo.scenario.gnss, duration_s=END_S
        ),
        MonitorConfig(detector=demo.monitor.detector, actuators=setup.monitor.actuators),
    )


def fly_schedule(vehicle: str, schedule: Schedule) -> PresetFlight:
    """Fly a schedule through the proxy into the monitor, all in this process."""
    scenario, config = setting(vehicle)
    flight, monitor = ProxiedFlight(scenario, schedule), Monitor(config)
    places, batch = [], bytearray()
    while not flight.finished:
        batch += flight.advance([]).monitor
        places.append(flight.simulation.truth.r_ned_m.copy())
        if len(batch) >= BATCH_BYTES:
            monitor.push_bytes([bytes(batch)], datagrams=False)
            batch.clear()
    batch += flight.finish().monitor
    monitor.push_bytes([bytes(batch)], datagrams=False)
    flight.drain_labels()
    summary = monitor.summary(flight.completed_labels(), Criteria(), 0.0)
    return PresetFlight(np.array(places), summary["faults"])


@functools.cache
def fly_reference(vehicle: str) -> PresetFlight:
    """Fly the reference flight, without a preset."""
    return fly_schedule(vehicle, Schedule())


def fly_preset(job: tuple[str, str]) -> Row:
    """Fly one preset on one vehicle."""
    vehicle, preset = job
    entry: dict[str, Any] = {"preset": preset, "id": "it", "at_s": START_S, "for_s": ACTS_S}
    if vehicle == "fixed wing" and preset.startswith("actuator-"):
        entry["target"] = ELEVATOR
    seed = setting(vehicle)[0].seed
    schedule = parse_schedule({"seed": seed, "faults": [entry]}, via="simulator")
    base = fly_reference(vehicle)
    try:
        found = fly_schedule(vehicle, schedule)
    except ConfigError:  # the vehicle has no such part
        found = base
    rows = found.faults
    acted = len({row["id"] for row in rows})
    delays = [row["delay_s"] for row in rows if row["delay_s"] is not None]
    steps = min(len(found.r_ned_m), len(base.r_ned_m))
    away_m = np.linalg.norm(found.r_ned_m[:steps] - base.r_ned_m[:steps], axis=1).max()
    return Row(
        vehicle,
        preset,
        (
            f"{acted} of {len(schedule.faults)}",
            _listed((row["verdict"] for row in rows), "did not act"),
            _listed(name for row in rows for name in row["isolated"]),
            _listed(wrong["who"] for row in rows for wrong in row["wrongly"]),
            f"{min(delays):.1f}" if delays else "-",
            f"{away_m:.1f}" if math.isfinite(away_m) and away_m >= 0.1 else "-",
        ),
    )


def _listed(names: Iterable[str], otherwise: str = "-") -> str:
    return ", ".join(sorted(set(names))) or otherwise


def source_digest() -> str:
    """Return a digest of the sources, to recognise the rows of an interrupted run."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for package in ("mavproxy_fault", "simvehicle", "analysis"):
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in (".py", ".yaml"):
                digest.update(path.read_bytes())
    return digest.hexdigest()


def page_rows() -> list[Row]:
    """Read the rows of the existing page."""
    rows, vehicle = [], ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            vehicle = line[3:].lower()
        elif line.startswith("| `"):
            preset, *cells = (cell.strip() for cell in line.strip("|").split("|"))
            rows.append(Row(vehicle, preset.strip("`"), tuple(cells)))
    return rows


def page(rows: Iterable[Row]) -> str:
    """Return the complete page."""
    by_job = {(row.vehicle, row.preset): row for row in rows}
    parts = [HEAD]
    for vehicle in VEHICLES:
        lines = [by_job[vehicle, preset].line for preset in PRESETS]
        table = "\n".join((COLUMNS, "|" + "---|" * COLUMNS.count(" | ") + "---|", *lines))
        parts.append(f"## {vehicle.capitalize()}\n\n{table}\n")
    return "\n".join(parts)


def fly_jobs(jobs: Sequence[tuple[str, str]], kept: Path | None) -> list[Row]:
    """Fly all jobs and return their rows; those flown before an interruption are in `kept`."""
    rows: list[Row] = []
    if kept is not None and kept.exists():
        rows = [msgspec.json.decode(line, type=Row) for line in kept.read_bytes().splitlines()]
        print(f"{len(rows)} flights are already done, see {kept}", file=sys.stderr)
    done = {(row.vehicle, row.preset) for row in rows}
    missing = [job for job in jobs if job not in done]
    with multiprocessing.get_context("spawn").Pool() as pool:
        for row in pool.imap_unordered(fly_preset, missing):
            rows.append(row)
            print(f"{len(rows)}/{len(jobs)} {row.vehicle} {row.line}", file=sys.stderr)
            if kept is not None:
                with kept.open("ab") as file:
                    file.write(msgspec.json.encode(row) + b"\n")
    return rows


def main() -> int:
    """Write the page, or compare it with new flights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presets", nargs="*", help="only these (with --check)")
    parser.add_argument("--check", action="store_true", help="fly and compare, write nothing")
    args = parser.parse_args()
    if args.presets and not args.check:
        parser.error("the page needs all presets; give names with --check only")
    names = args.presets or PRESETS
    jobs = [(vehicle, preset) for preset in names for vehicle in VEHICLES]
    if args.check:
        existing = {(row.vehicle, row.preset): row for row in page_rows()}
        rows = fly_jobs(jobs, None)
        wrong = [row for row in rows if existing.get((row.vehicle, row.preset)) != row]
        for row in wrong:
            before = existing.get((row.vehicle, row.preset))
            print(f"{row.vehicle}\n  page  {before.line if before else '-'}\n  flown {row.line}")
        print(f"{len(rows) - len(wrong)} of {len(rows)} rows agree with the page")
        return 1 if wrong else 0
    kept = ROOT / "build" / f"presets-{source_digest()[:16]}.jsonl"
    kept.parent.mkdir(exist_ok=True)
    PAGE.write_text(page(fly_jobs(jobs, kept)))
    kept.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
