"""What each preset does on a fixed wing and a quad, and what the monitor says of it.

Run by hand: `python benchmarks/preset_table.py`, or with names of presets. Every
preset acts from 3 s to 7 s of a flight of 9 s, all with the same seed; a flight without faults is
what it is compared to.
"""

import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.run.proxied_flight import Flight
from analysis.scoring.criteria import Criteria
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.schedule.presets import preset_names, read_preset
from simvehicle.scenario.scenario_file import Scenario, read_scenario
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.vision import Vision

START_S, ACTS_S, END_S = 3.0, 4.0, 9.0
IMU_HZ = 100.0  # enough to tell, and two flights a second
HOVER = Path(__file__).parents[1] / "examples" / "hover.yaml"
HEAD = """\
# What the presets do

Made by `python benchmarks/preset_table.py`. Each preset acts from 3 s to 7 s of a flight of 9 s,
in the simulator, proxy and monitor of `run`; the same flight without it is the comparison. *Acted*
are the parts that met a message: a preset names every message in which the sensor speaks, and those
that are not sent are not used. *Moved* is how far the true position came to lie from that of the
clean flight, at most, in metres; a dash means below a decimetre.

| preset | what it is | fixed wing | | | quad | | |
|---|---|---|---|---|---|---|---|
| | | acted | verdict | moved | acted | verdict | moved |
"""


class Flown(NamedTuple):
    """True positions (n, 3) of a flight, and the rows of its faults in the summary."""

    r_ned_m: np.ndarray
    faults: list[dict[str, Any]]


def scenarios() -> list[Scenario]:
    """The demo's fixed wing and the examples' quad, with all the sensors that presets need."""
    demo = read_scenario(None)
    hover = read_scenario(HOVER)
    both = []
    for scenario in (demo, hover):
        imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=IMU_HZ)
        sensors = msgspec.structs.replace(
            scenario.sensors, imu=imu, range=Rangefinder(), vision=Vision()
        )
        both.append(
            msgspec.structs.replace(scenario, sensors=sensors, gnss=demo.gnss, duration_s=END_S)
        )
    return both


def flown(scenario: Scenario, schedule: Schedule) -> Flown:
    """Fly a scenario through the proxy into the monitor, all in this process."""
    flight, monitor = Flight(scenario, schedule), Monitor(MonitorConfig())
    places = []
    while not flight.over:
        monitor.push_bytes([flight.advance([]).monitor])
        places.append(flight.simulation.truth.r_ned_m.copy())
    monitor.push_bytes([flight.finish().monitor])
    flight.drain_labels()
    summary = monitor.summary(flight.completed_labels(), Criteria(), 0.0)
    return Flown(np.array(places), summary["faults"])


def cells(name: str, scenario: Scenario, clean: Flown) -> str:
    """The three cells of a preset on one vehicle."""
    entry = {"preset": name, "id": "it", "at_s": START_S, "for_s": ACTS_S}
    schedule = parse_schedule({"seed": scenario.seed, "faults": [entry]}, via="simulator")
    found = flown(scenario, schedule)
    parts = len(schedule.faults)
    acted = f"{len({row['id'] for row in found.faults})} of {parts}"
    verdicts = sorted({str(row["verdict"]) for row in found.faults}) or ["did not act"]
    steps = min(len(found.r_ned_m), len(clean.r_ned_m))
    away_m = np.linalg.norm(found.r_ned_m[:steps] - clean.r_ned_m[:steps], axis=1).max()
    moved = f"{away_m:.1f}" if math.isfinite(away_m) and away_m >= 0.1 else "-"
    return f"{acted} | {', '.join(verdicts)} | {moved}"


def main() -> None:
    """Print the page."""
    both = scenarios()
    clean = [flown(scenario, Schedule()) for scenario in both]
    print(HEAD, end="")
    for name in sys.argv[1:] or preset_names():
        row = [cells(name, scenario, base) for scenario, base in zip(both, clean, strict=True)]
        print(f"| `{name}` | {read_preset(name)['about']} | {' | '.join(row)} |", flush=True)
        print(name, file=sys.stderr)


if __name__ == "__main__":
    main()
