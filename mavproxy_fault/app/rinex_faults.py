"""Faults on a RINEX observation file: the schedule's engine on its epochs, one after the other."""

import argparse
from pathlib import Path
from typing import Any

import msgspec

from mavproxy_fault.app.recorder import encoded
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.satellite import Satellites
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rinex.observation_text import file_epochs, written
from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rinex.rinex_text import PACKED, header_of, read_rinex_text
from mavproxy_fault.schedule.entries import Schedule, read_schedule
from mavproxy_fault.wire.label import Label

BEGINNING = 120  # bytes that hold the first line, packed by Hatanaka's rules or not
FROM_RECEIVER = "from-vehicle"


def is_rinex(path: Path) -> bool:
    """Whether a file begins as a RINEX file does; no other log that is packed can be replayed."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(BEGINNING)
    return b"RINEX VERSION" in head or path.name.lower().endswith(PACKED)


def replay_rinex(args: argparse.Namespace) -> int:
    """`replay` of an observation file: another one with faults, labels beside it."""
    path = Path(args.log)
    if args.out is None or args.schedule is None:
        raise ConfigError(f"replay {path}: a RINEX file needs --schedule FILE and --out FILE")
    out = Path(args.out)
    if out.exists() and out.samefile(path):
        raise ConfigError(f"{out}: is the file that is replayed; allowed: another file")
    lines, labels = faulted_lines(path, read_schedule(args.schedule))
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace")
    beside = out.with_suffix(out.suffix + ".labels.jsonl")
    beside.write_bytes(encoded(labels))
    print(f"{out}\n{beside}")
    return 0


def faulted_lines(path: Path, schedule: Schedule) -> tuple[list[str], list[Label]]:
    """The lines of an observation file with the schedule's faults in them, and their labels.

    `at_s` counts from the first epoch.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a fault acts on something else than ranges.
    """
    for entry in schedule.faults:
        if not isinstance(entry.fault, Satellites):
            raise ConfigError(
                f"{entry.id}: {entry.name} on {', '.join(entry.targets) or 'the link'} cannot act"
                " on a RINEX file; PSEUDORANGE targets can"
            )
    lines = read_rinex_text(path)
    version, end = header_of(path, lines, "O", "an observation file")
    engine, last_us, labels = Engine(schedule), 0, []
    for epoch in file_epochs(lines, version, end + 1):
        last_us = max(last_us, epoch.t_us)
        before: Any = RangeEpoch(tuple(epoch.codes))  # to the engine it is a frame
        for sent in engine.apply(before, FROM_RECEIVER, epoch.t_us):
            if isinstance(sent.frame, RangeEpoch) and sent.frame is not before:
                written(lines, epoch, sent.frame)
        labels += engine.drain_labels()
    labels += engine.finish(last_us)
    return lines, [msgspec.structs.replace(label, recorded=True) for label in labels]
