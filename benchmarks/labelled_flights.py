"""Reports on labelled flights: per check and class of fault how many logs it speaks up in.

    python benchmarks/labelled_flights.py FOLDER [--split test]

FOLDER holds logs and `labels.csv` (file, class, split): `split` says whether a log was looked at
while checks were made (`tune`) or only judged (`test`). Prints the tables of docs/verdicts.md, and
whom of its motors the monitor blames in each log that is named after those which are off (`m1m3`).

With the columns target, from_s and to_s as well (HIL_SENSOR.xgyro, in the log's own time; empty
where nothing is wrong) the monitor is held to the definition of docs/verdicts.md: the outcome of
each class, and how often each name was blamed rightly and wrongly.
"""

import argparse
import csv
import re
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.recordings.flight_logs.log_condition import LogCondition
from analysis.recordings.read_recordings import read_log
from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, WARN
from analysis.report.recordings.flight_sources import read_flight
from analysis.results import SensorDecision
from analysis.scoring.criteria import Criteria
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.label import Label

UNREADABLE = "unreadable"
VERDICTS = ("isolated", "ambiguous", "detected", "late", "missed", "wrong", "not judged")


def main() -> None:
    """Judge every log of a split and print what spoke up."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="test")
    args = parser.parse_args()
    with (args.folder / "labels.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["split"] == args.split]
    flights = Counter(row["class"] for row in rows)
    if rows and "target" in rows[0]:
        print_monitor([(row["class"], summarise_log(args.folder, row)) for row in rows])
    named: dict[str, Counter[str]] = defaultdict(Counter)
    spoke: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        if motors := re.findall(r"m(\d)", Path(row["file"]).stem):
            named[row["class"]][word(args.folder / row["file"], motors)] += 1
        for name, verdict in verdicts(args.folder / row["file"]).items():
            spoke[name][row["class"]] += 1
            spoke[name][f"{row['class']} {verdict}"] += 1
    print("| check | " + " | ".join(f"{name} ({count})" for name, count in flights.items()) + " |")
    print("|---|" + "---|" * len(flights))
    for name, counts in sorted(spoke.items(), key=lambda item: (item[0] != "verdict", item[0])):
        cells = (_cell(counts, kind) for kind in flights)
        print(f"| {name} | " + " | ".join(cells) + " |")
    for kind, words in named.items():
        print(f"{kind}: motors named: " + ", ".join(f"{n} {w}" for w, n in words.items()))


def summarise_log(folder: Path, row: dict[str, str]) -> dict[str, Any]:
    """The monitor's summary of a log with its label."""
    labels = []
    if row["target"]:
        start_us, end_us = (round(float(row[name]) * 1e6) for name in ("from_s", "to_s"))
        labels.append(
            Label(
                id=row["class"],
                fault="bias",
                targets=tuple(row["target"].split()),
                t0_us=0,
                start_us=start_us,
                end_us=end_us,
                frames=1,
            )
        )
    monitor, condition = Monitor(MonitorConfig(link=False)), LogCondition()
    for block in read_log(folder / row["file"], condition):
        monitor.set_log_gaps(condition.lost_us)
        monitor.push(block)
    return monitor.summary(labels, Criteria(), 0.0)


def print_monitor(flown: list[tuple[str, dict[str, Any]]]) -> None:
    """The outcomes by class, and each sensor's flights with a correct or a wrong isolation."""
    flights = Counter(kind for kind, _ in flown)
    found: dict[str, Counter[str]] = defaultdict(Counter)
    rightly, wrongly, suspected = Counter[str](), Counter[str](), Counter[str]()
    hours = sum(summary["sim_s"] for _, summary in flown) / 3600.0
    for kind, summary in flown:
        for fault in summary["faults"]:
            found[kind][fault["verdict"]] += 1
            rightly.update(fault["isolated"])
        wrongly.update({who for row in summary["false_by_channel"] for who in row["blamed"]})
        for row in summary["false_by_channel"]:
            found[kind]["false"] += row["outside"] + row["inside"]
            suspected[row["channel"]] += row["outside"] + row["inside"]
    print(f"| fault | flights | {' | '.join(VERDICTS)} | false alarms |")
    print("|---|" + "---|" * (2 + len(VERDICTS)))
    for kind, count in flights.items():
        cells = [found[kind][verdict] or "" for verdict in (*VERDICTS, "false")]
        print(f"| {kind} | {count} | {' | '.join(map(str, cells))} |")
    print(f"\n{hours:.2f} h; false alarms by channel: {dict(suspected)}\n")
    print("| isolated | correctly, flights | wrongly, flights |\n|---|---|---|")
    for name in sorted(rightly | wrongly):
        print(f"| {name} | {rightly[name] or ''} | {wrongly[name] or ''} |")
    print()


def verdicts(path: Path) -> dict[str, str]:
    """The verdict on a log, and of each check that warned or failed."""
    try:
        found = assess_flight(read_flight([path], ()), Thresholds())
    except ConfigError:
        return {"verdict": UNREADABLE}
    bad = {check.name: check.verdict for check in found.checks if check.verdict in (WARN, FAIL)}
    return bad | ({"verdict": found.verdict} if found.verdict in (WARN, FAIL) else {})


def word(path: Path, motors: list[str]) -> str:
    """Whether the isolated actuators are the motors that are off."""
    off = {f"motor {number}" for number in motors}
    monitor = Monitor(MonitorConfig())
    results = [result for block in read_log(path) for result in monitor.push(block)]
    found = [r for r in results if isinstance(r, SensorDecision) and r.sensor == "actuators"]
    isolated = {result.suspect for result in found if result.isolated}
    if isolated - off:
        return "wrong"
    return "none" if not isolated else "all" if isolated == off else "one of two"


def _cell(counts: Counter[str], kind: str) -> str:
    fail, warn = counts[f"{kind} {FAIL}"], counts[f"{kind} {WARN}"]
    words = [f"{count} {word}" for count, word in ((fail, FAIL), (warn, WARN)) if count]
    return ", ".join(words)


if __name__ == "__main__":
    main()
