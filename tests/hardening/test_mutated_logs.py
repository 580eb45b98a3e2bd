"""Logs of all formats, broken at random: `report` reads them, or refuses them with their name.

`MUTANTS=10000 pytest -s tests/hardening/test_mutated_logs.py` is the long form.
"""

import os
import random
import time
from collections.abc import Callable
from pathlib import Path

from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.log_report import write_report
from analysis.report.recordings.flight_sources import read_flight
from mavproxy_fault.documents.errors import ConfigError
from tests.analysis.report.short_flights import FLIGHTS

MUTANTS = int(os.environ.get("MUTANTS", "30"))
MOST_BYTES = 300_000  # of a real log, from a random place on: a report on it takes a second
SLOWEST_S = 20.0  # of processor time
HEADER_BYTES = 16_000  # formats and definitions, without which a log is refused at once

Change = Callable[[bytearray, random.Random], bytes]


def part(data: bytes, rng: random.Random, most: int = 5000) -> tuple[int, int]:
    begin = rng.randrange(len(data))
    return begin, min(begin + rng.randint(1, most), len(data))


def truncated(data: bytearray, rng: random.Random) -> bytes:
    return bytes(data[: rng.randrange(len(data))])


def flipped(data: bytearray, rng: random.Random) -> bytes:
    for _ in range(rng.choice((1, 1, 3, 20, 200))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def replaced(data: bytearray, rng: random.Random) -> bytes:
    begin, end = part(data, rng)
    data[begin:end] = rng.choice((bytes(end - begin), b"\xff" * (end - begin),
                                  rng.randbytes(end - begin)))  # fmt: skip
    return bytes(data)


def spliced(data: bytearray, rng: random.Random) -> bytes:
    begin, _ = part(data, rng)
    other = FLIGHTS[rng.choice([*FLIGHTS])]()
    start, end = part(other, rng, 50_000)
    return bytes(data[:begin]) + other[start:end] + bytes(data[begin:])


def duplicated(data: bytearray, rng: random.Random) -> bytes:
    begin, end = part(data, rng, 50_000)
    at = rng.choice((end, rng.randrange(len(data))))
    return bytes(data[:at] + data[begin:end] + data[at:])


def swapped(data: bytearray, rng: random.Random) -> bytes:
    a, b, c, d = sorted(rng.randrange(len(data)) for _ in range(4))
    return bytes(data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:])


def removed(data: bytearray, rng: random.Random) -> bytes:
    begin, end = part(data, rng, 50_000)
    return bytes(data[:begin] + data[end:])


CHANGES: list[Change] = [truncated, flipped, replaced, spliced, duplicated, swapped, removed]


def sources(shared: Path | None) -> list[tuple[str, bytes]]:
    """Suffix and bytes of the logs to break: short ones, and the real ones of the data folder."""
    found = [(suffix, make()) for suffix, make in FLIGHTS.items()]
    if shared is not None:
        paths = [path for path in sorted(shared.rglob("*")) if path.suffix in FLIGHTS]
        found += [(path.suffix, path.read_bytes()) for path in paths]
    return found


def mutant(data: bytes, rng: random.Random) -> bytes:
    """A log, or its head and a random stretch of it, with one to three changes."""
    if len(data) > MOST_BYTES + HEADER_BYTES:
        begin = rng.randrange(HEADER_BYTES, len(data) - MOST_BYTES)
        data = data[:HEADER_BYTES] + data[begin : begin + MOST_BYTES]
    for _ in range(rng.randint(1, 3)):
        data = rng.choice(CHANGES)(bytearray(data or b"\0"), rng)
    return data


def test_a_broken_log_is_reported_or_refused_with_its_name(tmp_path: Path) -> None:
    data = os.environ.get("MAVPROXY_FAULT_DATA")
    logs = sources(Path(data) if data and MUTANTS > 1000 else None)
    seed = int(os.environ.get("MUTANTS_SEED", "1"))
    refused, nameless = 0, list[str]()
    for number in range(MUTANTS):
        rng = random.Random(seed * 1_000_000 + number)
        suffix, whole = logs[number % len(logs)]
        path = tmp_path / f"mutant{suffix}"
        path.write_bytes(mutant(whole, rng))
        began = time.thread_time()
        try:
            outcome = assess_flight(read_flight([path], ()), Thresholds())
            write_report(tmp_path, outcome, [])
        except ConfigError as error:
            nameless += [] if path.name in str(error) else [str(error)]
            refused += 1
        except Exception as error:
            raise AssertionError(f"mutant {number} of seed {seed} ({suffix})") from error
        else:
            failed = [check.name for check in outcome.checks if check.verdict == "FAIL"]
            assert bool(failed) == (outcome.verdict == "FAIL"), number
        assert time.thread_time() - began < SLOWEST_S, number
    assert nameless == []
    assert refused < MUTANTS / 2
    print(f"{MUTANTS} mutants, {refused} refused")
