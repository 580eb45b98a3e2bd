"""Score the reports of a folder of flight logs against a table of what is true of each.

    python benchmarks/flight_logs.py FOLDER [TABLE]

TABLE (`benchmarks/flight_logs.csv`) has a row per log: its MD5, repository, part, class, whether it
crashed, and the checks that are true of it. The first part was used for development and held
against numbers that pymavlink and pyulog give, the second only where a report looked wrong. The
third and fourth were judged from numbers of pymavlink and numpy before their reports were read, the
fourth behind all changes that the third led to. The fifth and seventh were judged in the same way
and led to changes, the sixth and eighth were opened behind them. Of the logs themselves nothing is
stored here.
"""

import csv
import hashlib
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.recordings.flight_sources import read_flight
from mavproxy_fault.documents.errors import ConfigError

LOGS = (".bin", ".ulg", ".tlog", ".log")
ALARMS = ("WARN", "FAIL")


def read_table(path: Path) -> dict[str, dict[str, str]]:
    """The rows of a truth table by MD5."""
    with path.open(newline="", encoding="utf-8") as file:
        return {row["md5"]: row for row in csv.DictReader(file)}


def assess_log(path: Path) -> dict[str, Any]:
    """Verdict, alarming checks, outcome and chain of a log."""
    try:
        found = assess_flight(read_flight([path], ()), Thresholds())
    except ConfigError as error:
        return {"verdict": f"refused: {error}", "alarms": [], "outcome": "", "chain": []}
    alarms = [check.name for check in found.checks if check.verdict in ALARMS]
    outcome, chain = found.summary["outcome"]["outcome"], found.summary["chain"]
    return {"verdict": found.verdict, "alarms": alarms, "outcome": outcome, "chain": chain}


def main() -> None:
    """Print true and false alarms of each check, missed crashes, and clean flights that warn."""
    folder = Path(sys.argv[1])
    table = read_table(Path(sys.argv[2] if len(sys.argv) > 2 else "benchmarks/flight_logs.csv"))
    true: Counter[str] = Counter()
    false: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    crashes = failed = clean = warned = 0
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in LOGS):
        row = table.get(hashlib.md5(path.read_bytes()).hexdigest())
        if row is None:
            print(f"{path.name}: not in the table")
            continue
        found = assess_log(path)
        right = set(filter(None, row["findings"].split("; ")))
        true.update(right & set(found["alarms"]))
        false.update(set(found["alarms"]) - right)
        missed.update(right - set(found["alarms"]))
        if row["crash"] == "yes":
            crashes += 1
            failed += found["verdict"] == "FAIL"
        elif not right:
            clean += 1
            warned += found["verdict"] in ALARMS
        wrong = sorted(set(found["alarms"]) ^ right)
        if wrong:
            print(f"{path.name} ({found['verdict']}, {found['outcome']}): {', '.join(wrong)}")
    for name in sorted({*true, *false, *missed}):
        print(f"{name}: {true[name]} true, {false[name]} false, {missed[name]} missed")
    print(f"crashes that fail: {failed} of {crashes}")
    print(f"clean flights that warn or fail: {warned} of {clean}")


if __name__ == "__main__":
    main()
