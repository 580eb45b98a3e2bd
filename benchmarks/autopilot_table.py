"""Reactions of real autopilots to the presets: one flight of each, read from its run folder.

Run by hand: `python benchmarks/autopilot_table.py px4=PATH ardupilot=PATH [--only PRESET ...]`. A
quad takes off, hovers at 10 m, has the fault from 10 s to 20 s after take-off, and is commanded to
land at 40 s. A name with `@0` acts on the first of two instances only. Flights that are already in
the folder (`--runs`) are not repeated.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog

from analysis.flying.autopilot_evidence import collect_evidence
from analysis.flying.flight_evidence import PATH, Evidence
from analysis.scoring.vehicle_outcome import VehicleEvent
from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.wire.tlog import read_columns

HOVER = Path(__file__).parents[1] / "examples" / "autopilot_table.yaml"
IMU_HZ = {"px4": "250", "ardupilot": "400"}  # rate of each autopilot
AT_S, FOR_S = 10.0, 10.0
NO_FAULT = "none"
PRESETS = {
    "GPS": "gps-jump gps-spoof gps-freeze gps-search-failure gps-velocity-error gps-jamming",
    "Inertial sensors": "gyro-bias gyro-bias@0 gyro-drift gyro-noise gyro-nan gyro-stuck "
    "gyro-stuck@0 accel-bias accel-bias@0 accel-noise accel-stuck accel-scale imu-vibration "
    "imu-misalignment imu-impulse sensor-power-failure",
    "Barometer and compass": "baro-drift baro-freeze baro-off mag-offset mag-scale "
    "magnetic-interference",
    "Actuators, plant, air and clock": "actuator-stuck actuator-efficiency motor-efficiency "
    "motor-failure wind-gust clock-jump",
}
FLAGS = {10: "GPS glitch", 11: "accelerometer error", 15: "GPS glitch"}  # set; ESTIMATOR_STATUS
MESSAGES = ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
LOST = {0: "attitude", 1: "velocity", 4: "position", 5: "height"}  # no longer set
COUNTERS = {  # of PX4's log
    "position": ("vehicle_local_position", "xy_reset_counter"),
    "velocity": ("vehicle_local_position", "vxy_reset_counter"),
    "height": ("vehicle_local_position", "z_reset_counter"),
    "attitude": ("vehicle_attitude", "quat_reset_counter"),
}
COLUMNS = "preset, autopilot, flags, first warning, resets, lane switch, failsafe, off (m), end"
HEAD = "| " + COLUMNS.replace(", ", " | ") + " |\n" + "|---" * 9 + "|"


def main() -> None:
    """Fly the missing flights and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("autopilots", nargs="+", metavar="NAME=PATH")
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--runs", type=Path, default=Path("runs/autopilot_table"))
    args = parser.parse_args()
    binaries = dict(word.split("=", 1) for word in args.autopilots)
    groups = {"No fault": NO_FAULT, **PRESETS}
    for title, names in groups.items():
        chosen = [name for name in names.split() if args.only is None or name in args.only]
        rows = [
            row(name, kind, path, args.runs) for name in chosen for kind, path in binaries.items()
        ]
        if rows:
            print(f"## {title}\n\n{HEAD}\n" + "\n".join(rows) + "\n", flush=True)


def row(name: str, autopilot: str, binary: str, runs: Path) -> str:
    """Fly one preset and return its row."""
    folder = runs / f"{autopilot}-{name}"
    if not (folder / "summary.json").exists():
        fly(name, autopilot, binary, folder)
    evidence, _ = collect_evidence(folder)
    marks = [mark for mark in evidence.marks if mark.t_s >= AT_S - 0.1]
    return (
        f"| `{name}` | {autopilot} | "
        + " | ".join(
            (
                flags(folder),
                listed(warnings(marks)[:1]),
                resets(folder, marks),
                lane_switch(folder, marks),
                failsafe(folder, marks),
                excursion(evidence),
                end(folder, evidence),
            )
        )
        + " |"
    )


def fly(name: str, autopilot: str, binary: str, folder: Path) -> None:
    """Run one flight, with its schedule beside the folder."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    preset, _, instance = name.partition("@")
    fault: dict[str, Any] = {"id": "f", "preset": preset, "at_s": AT_S, "for_s": FOR_S}
    if instance:
        fault["where"] = {"id": int(instance)}
    schedule = folder.with_suffix(".yaml")
    schedule.write_text(write_yaml({"faults": [] if preset == NO_FAULT else [fault]}))
    scenario = folder.with_suffix(".scenario.yaml")
    scenario.write_text(HOVER.read_text().replace("rate_hz: 250", f"rate_hz: {IMU_HZ[autopilot]}"))
    words = ["run", str(scenario), "--autopilot", autopilot, "--binary", binary]
    words += ["--schedule", str(schedule), "--out", str(folder), "--zenoh", "off"]
    done = subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", *words], capture_output=True, text=True
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{folder.name}: {done.stderr}")


def fault_us(folder: Path) -> tuple[int, int]:
    """Return the autopilot's time of the fault's onset and of the command to land."""
    events_s = json.loads((folder / "summary.json").read_text())["autopilot"]["moments_s"]
    begin_s = events_s.get("take-off", 0.0) + AT_S
    return round(begin_s * 1e6), round(events_s.get("landing", begin_s + 90.0) * 1e6)


def flags(folder: Path) -> str:
    """List the estimator flags raised between the fault and the landing."""
    columns = read_columns(folder / "sent.tlog")
    truth = columns["HIL_STATE_QUATERNION"]
    shift_us = int(truth["t_us"][0]) - int(truth["time_usec"][0])
    begin_us, end_us = fault_us(folder)
    found: dict[str, float] = {}
    for message in MESSAGES:
        if message not in columns:
            continue
        rows = columns[message]
        t_us = rows["t_us"] - shift_us
        rows, t_us = rows[t_us < end_us], t_us[t_us < end_us]
        bits = rows["flags"].astype(np.int64)
        for number, word in (*FLAGS.items(), *((bit, f"no {what}") for bit, what in LOST.items())):
            raised = bits >> number & 1 != (1 if word.startswith("no ") else 0)
            new = np.flatnonzero(raised[1:] & ~raised[:-1] & (t_us[1:] >= begin_us))
            if len(new):
                found.setdefault(word, (t_us[new[0] + 1] - begin_us) * 1e-6)
    return listed(found.items())


def resets(folder: Path, marks: list[VehicleEvent]) -> str:
    """List resets of the estimate: PX4's counters, ArduPilot's texts."""
    found = said(marks, "reset")
    for word, (topic, counter) in COUNTERS.items():
        times = changes(folder, topic, counter)
        if times:
            found.append((f"{word} {len(times)}x", times[0]))
    return listed(found)


def lane_switch(folder: Path, marks: list[VehicleEvent]) -> str:
    """List changes of the primary estimator."""
    times = changes(folder, "estimator_selector_status", "primary_instance")
    return listed([*said(marks, "lane switch"), *(("to another", t_s) for t_s in times[:1])])


def failsafe(folder: Path, marks: list[VehicleEvent]) -> str:
    """List uncommanded changes of mode, and the texts that name a failsafe."""
    begin_us, landing_us = fault_us(folder)
    until_s = AT_S + (landing_us - begin_us) * 1e-6 - 0.1
    modes = [
        (mark.text.partition(": ")[0], mark.t_s - AT_S)
        for mark in marks
        if mark.kind == "failsafe" and mark.t_s < until_s
    ]
    return listed([*modes, *said(marks, "failsafe")])


def excursion(evidence: Evidence) -> str:
    """Return the largest horizontal distance from hover, during the fault and until the landing."""
    north, east = (evidence.curves[name] for name in PATH[:2])
    t_s = np.array(north.t_s)
    if not len(t_s) or t_s[-1] < AT_S:
        return ""
    place = np.flatnonzero(t_s <= AT_S)[-1]
    off_m = np.hypot(
        np.array(north.value) - north.value[place], np.array(east.value) - east.value[place]
    )
    spans = ((AT_S, AT_S + FOR_S), (AT_S + FOR_S, np.inf))
    parts = [off_m[(t_s >= low) & (t_s < high)] for low, high in spans]
    return ", ".join(f"{part.max():.1f}" if len(part) else "-" for part in parts)


def end(folder: Path, evidence: Evidence) -> str:
    """Describe the end of the flight."""
    crashes = [mark for mark in evidence.marks if mark.kind == "crashed"]
    early = json.loads((folder / "summary.json").read_text())["autopilot"]["ended_early"]
    begin_us, landing_us = fault_us(folder)
    if crashes:
        return f"{crashes[0].text} after {crashes[0].t_s - AT_S:.1f} s"
    landed = [mark for mark in evidence.marks if mark.kind == "landed uncommanded"]
    if landed and landed[0].t_s < AT_S + (landing_us - begin_us) * 1e-6:
        return f"landed by itself after {landed[0].t_s - AT_S:.0f} s"
    return early.split(" at ")[0].split(";")[0] if early else "landed"


def changes(folder: Path, topic: str, name: str) -> list[float]:
    """Return the times [s] at which a value of PX4's log changed, from onset to landing."""
    begin_us, end_us = fault_us(folder)
    times: list[float] = []
    for log in folder.glob("autopilot/log/*/*.ulg"):
        for data in ULog(str(log), [topic]).data_list:
            values, t_us = data.data[name], data.data["timestamp"].astype(np.int64)
            at = np.flatnonzero(np.diff(values.astype(np.int64))) + 1
            times += [(t - begin_us) * 1e-6 for t in t_us[at].tolist() if begin_us <= t < end_us]
    return sorted(times)


def said(marks: list[VehicleEvent], word: str) -> list[tuple[str, float]]:
    """Return the first warning that contains a word."""
    return [(text, t_s) for text, t_s in warnings(marks) if word in text.lower()][:1]


def warnings(marks: list[VehicleEvent]) -> list[tuple[str, float]]:
    """Return the autopilot's warnings, each with its time since the onset [s]."""
    return [
        (mark.text.strip(), mark.t_s - AT_S)
        for mark in marks
        if mark.kind == "detected" and not mark.text.startswith(MESSAGES)
    ]


def listed(found: Any) -> str:
    """Join texts with their seconds since the onset."""
    return ", ".join(f"{word} {t_s:.1f}" for word, t_s in found)


if __name__ == "__main__":
    main()
