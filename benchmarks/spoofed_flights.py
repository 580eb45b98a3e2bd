"""A spoofer and a faulty IMU against the monitor, over many seeds, with raw ranges or without.

`python benchmarks/spoofed_flights.py position` flies the demo's fixed wing and the examples' quad
with a receiver that reports position and velocity only, `... ranges` with one that reports raw
ranges only, spoofs it from 20 s to 40 s of a flight of 50 s, and prints a table that compares each
row of a spoofer with the aims: no flight isolates the IMU alone, and all find the spoofer; a jump
within 3 s, a carry-off before the position is 25 m off; and where the position has a sigma, the
error at 95 % is at most 1.5 of that without a fault. `SEEDS` flights a row, WORKERS at once
(all cores without): some minutes.

    python benchmarks/spoofed_flights.py position|ranges [WORKERS [SEEDS]]
"""

import multiprocessing
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.results import Decision
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import read_setup
from analysis.scoring.criteria import Criteria
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from simvehicle.scenario.scenario_file import Scenario

RANGES = sys.argv[1:2] == ["ranges"]
WORKERS = int(sys.argv[2]) if sys.argv[2:] else None
SEEDS = int(sys.argv[3]) if sys.argv[3:] else 20
START_S, END_S, FLOWN_S = 20.0, 40.0, 50.0
IMU_HZ = 100.0
BATCH_BYTES = 32_768
HOVER = Path(__file__).parents[1] / "examples" / "hover.yaml"


def spoof(offset_m: float, velocity_mps: float) -> dict[str, Any]:
    """To the north, at once and on with a velocity."""
    if not RANGES:
        ned = {"offset_m": [offset_m, 0, 0], "velocity_mps": [velocity_mps, 0, 0]}
        return {"fault": "gps-spoof", **ned}
    segment = {"at_s": 0, "for_s": END_S - START_S, "start": offset_m, "rate": velocity_mps}
    profile = {"segments": [segment]}
    return {"fault": "plant", "target": "PLANT.spoof_north_m[all]", "profile": profile}


FAULTS: dict[str, dict[str, Any]] = {
    "none": {},
    "spoof 20 m at once": spoof(20, 0),
    "spoof 200 m at once": spoof(200, 0),
    **({"spoof 0.5 m/s": spoof(0, 0.5)} if RANGES else {}),
    "spoof 1 m/s": spoof(0, 1),
    "spoof 5 m/s": spoof(0, 5),
    "gyro 0.1 rad/s": {"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.1},
    "accelerometer 1 m/s2": {"fault": "bias", "target": "HIL_SENSOR.xacc", "value": 1.0},
    "accelerometer 8 m/s2": {"fault": "bias", "target": "HIL_SENSOR.xacc", "value": 8.0},
}


JUMPS = ("spoof 20 m at once", "spoof 200 m at once")


class Flown(NamedTuple):
    """The fault's row of the summary, how many decisions of the flight isolate the IMU alone, and
    from the fault's start to its end the position's error (n,) in m at each fix, with whether the
    monitor bounds it (n,) and whether the fix came before the first alarm or with it (n,)."""

    fault: dict[str, Any]
    imu_alone: int
    error_m: np.ndarray
    bounded: np.ndarray
    unnoticed: np.ndarray


def scenario_of(vehicle: str, seed: int) -> Scenario:
    """The vehicle with a receiver that reports ranges, or none."""
    hover, demo = read_setup(str(HOVER)).scenario, read_setup(None).scenario
    scenario = hover if vehicle == "quad" else demo
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=IMU_HZ)
    gps, gnss = (demo.sensors.gps, demo.gnss) if RANGES else (hover.sensors.gps, None)
    sensors = msgspec.structs.replace(scenario.sensors, imu=imu, gps=gps)
    return msgspec.structs.replace(
        scenario, seed=seed, sensors=sensors, gnss=gnss, duration_s=FLOWN_S
    )


def flown(job: tuple[str, str, int]) -> Flown:
    """One flight."""
    vehicle, fault, seed = job
    scenario = scenario_of(vehicle, seed)
    entry = {"id": "it", "at_s": START_S, "for_s": END_S - START_S, **FAULTS[fault]}
    faults = [entry] if FAULTS[fault] else []
    schedule = parse_schedule({"seed": seed, "faults": faults}) if faults else Schedule()
    flight, monitor = ProxiedFlight(scenario, schedule), Monitor(MonitorConfig())
    results, truth, batch = [], {}, bytearray()
    while not flight.finished:
        batch += flight.advance([]).monitor
        now = flight.simulation.truth
        truth[round(now.t_us, -4)] = ecef_from_geodetic(now.lat_rad, now.lon_rad, now.height_m)
        if len(batch) >= BATCH_BYTES:
            results += monitor.push_bytes([bytes(batch)], datagrams=False)
            batch.clear()
    results += monitor.push_bytes([bytes(batch) + flight.finish().monitor], datagrams=False)
    flight.drain_labels()
    summary = monitor.summary(flight.completed_labels(), Criteria(), 0.0)
    decisions = [r for r in results if isinstance(r, Decision)]
    imu_alone = sum(r.hypothesis == "imu" for r in decisions)
    fixes = [
        (r, truth[round(r.t_us - 1_000_000, -4)])
        for r in decisions
        if r.position_ecef_m is not None
        and START_S <= r.t_us * 1e-6 - 1.0 < END_S
        and round(r.t_us - 1_000_000, -4) in truth
    ]
    errors = np.array([np.linalg.norm(np.subtract(r.position_ecef_m, at)) for r, at in fixes])
    bounded = np.array([r.position_sigma_m is not None for r, _ in fixes])
    alarms = np.array([r.alarm for r, _ in fixes])
    unnoticed = np.cumsum(alarms) - alarms == 0
    row = summary["faults"][0] if faults else {"verdict": "-", "delay_s": None, "wrongly": []}
    return Flown(row, imu_alone, errors, bounded, unnoticed)


def line(vehicle: str, fault: str, flights: list[Flown], clean_m: float) -> str:
    """A row of the table; `clean_m` is the error at 95 % without a fault."""
    verdicts = Counter(flight.fault["verdict"] for flight in flights)
    delays = [f.fault["delay_s"] for f in flights if f.fault["delay_s"] is not None]
    wrong = Counter(row["who"] for f in flights for row in f.fault["wrongly"])
    bounded = np.concatenate([f.error_m[f.bounded] for f in flights])
    share = np.concatenate([f.bounded for f in flights]).mean()
    unnoticed_m = max(f.error_m[f.unnoticed].max() for f in flights)
    imu_alone = sum(f.imu_alone > 0 for f in flights)
    ratio = np.quantile(bounded, 0.95) / clean_m if len(bounded) else 0.0
    aims = {
        "no imu": imu_alone == 0,
        "found": len(delays) == len(flights),
        "3 s": max(delays, default=np.inf) <= 3.0 or fault not in JUMPS,
        "25 m": unnoticed_m < 25.0,
        "1.5": ratio <= 1.5,
    }
    missed = ", ".join(name for name, met in aims.items() if not met)
    cells = (
        ", ".join(f"{count} {name}" for name, count in sorted(verdicts.items())),
        f"{imu_alone}",
        ", ".join(f"{count} {name}" for name, count in sorted(wrong.items())) or "-",
        f"{np.median(delays):.1f} / {max(delays):.1f}" if delays else "-",
        f"{unnoticed_m:.1f}" if delays else "-",
        f"{np.median(bounded):.1f} / {np.quantile(bounded, 0.95):.1f}" if len(bounded) else "-",
        f"{ratio:.2f}",
        f"{100.0 * (1.0 - share):.0f} %",
        (f"missed: {missed}" if missed else "met") if fault.startswith("spoof") else "-",
    )
    return f"| {vehicle} | {fault} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    print(
        "| vehicle | fault | verdicts | flights with `imu` alone | others isolated wrongly |",
        end="",
    )
    print(" delay, s: median / most | largest error until the alarm, m |", end="")
    print(" error where bounded, m: 50 % / 95 % | over clean at 95 % | unbounded | aims |")
    print(f"|{11 * '---|'}")
    with multiprocessing.get_context("spawn").Pool(WORKERS) as pool:
        for vehicle in ("fixed wing", "quad"):
            clean_m = np.inf
            for fault in FAULTS:
                jobs = [(vehicle, fault, seed) for seed in range(1, SEEDS + 1)]
                flights = pool.map(flown, jobs, chunksize=1)
                if fault == "none":
                    clean_m = float(np.quantile(np.concatenate([f.error_m for f in flights]), 0.95))
                print(line(vehicle, fault, flights, clean_m), flush=True)


if __name__ == "__main__":
    main()
