"""Faults on a RINEX observation file: the schedule's engine on its epochs, one after the other."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mavproxy_fault.app.recorder import encode_lines
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.plant_fault import PlantFault
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rinex.rinex_text import PACKED, header_of, read_rinex_text
from mavproxy_fault.rinex.signal_change import Sky, needs_sky, signal_changes
from mavproxy_fault.rinex.signal_fields import write_change
from mavproxy_fault.schedule.entries import Entry, Schedule, never_acted, read_schedule
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.plant_names import SIGNALS

PROBE_BYTES = 120  # bytes that hold the first line, packed by Hatanaka's rules or not
FROM_RECEIVER = "from-vehicle"


def is_rinex(path: Path) -> bool:
    """Whether a file begins as a RINEX file does; no other log that is packed can be replayed."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(PROBE_BYTES)
    return b"RINEX VERSION" in head or path.name.lower().endswith(PACKED)


def replay_rinex(args: argparse.Namespace) -> int:
    """`replay` of an observation file: another one with faults, labels beside it."""
    path = Path(args.log)
    if args.out is None or args.schedule is None:
        raise ConfigError(f"replay {path}: a RINEX file needs --schedule FILE and --out FILE")
    out = Path(args.out)
    if out.exists() and out.samefile(path):
        raise ConfigError(f"{out}: is the file that is replayed; allowed: another file")
    schedule, navigation = read_schedule(args.schedule), [Path(name) for name in args.nav or ()]
    lines, labels = faulted_lines(path, schedule, navigation)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(lines) + "\n", encoding="ascii", errors="replace")
    beside = out.with_suffix(out.suffix + ".labels.jsonl")
    beside.write_bytes(encode_lines(labels))
    print(f"{out}\n{beside}")
    for word in never_acted(schedule, {label.id for label in labels}):
        print(f"never acted: {word}: it met nothing that it names", file=sys.stderr)
    return 0


def faulted_lines(
    path: Path, schedule: Schedule, navigation: Sequence[Path] = ()
) -> tuple[list[str], list[Label]]:
    """The lines of an observation file with the schedule's faults in them, and their labels.

    `at_s` counts from the first epoch. The navigation files are read where a fault pretends
    another place.

    Raises
    ------
    ConfigError
        If a file cannot be read or is missing, or a fault acts on something else than signals.
    """
    faults = tuple(_on_epochs(entry) for entry in schedule.faults)
    sky = None
    for entry in faults:
        if isinstance(entry.fault, PlantFault) and needs_sky(entry.fault.names) and sky is None:
            sky = _sky(path, navigation, entry)
    lines = read_rinex_text(path)
    version, end = header_of(path, lines, "O", "an observation file")
    engine, last_us = Engine(Schedule(schedule.seed, faults)), 0
    labels, rng = [], np.random.default_rng(schedule.seed)
    for epoch in file_epochs(lines, version, end + 1):
        last_us = max(last_us, epoch.t_us)
        before: Any = RangeEpoch(tuple(epoch.observations))  # to the engine it is a frame
        for sent in engine.apply(before, FROM_RECEIVER, epoch.t_us):
            if isinstance(sent.frame, RangeEpoch) and sent.frame is not before:
                for name, change in signal_changes(sent.frame, epoch.t_us, sky):
                    write_change(lines, epoch.observations[name], name, change, rng)
        labels += engine.drain_labels()
    labels += engine.finish(last_us)
    return lines, [msgspec.structs.replace(label, recorded=True) for label in labels]


def _on_epochs(entry: Entry) -> Entry:
    """The entry as it acts on the epochs of a file; a parameter of the plant rides on them."""
    if isinstance(entry.fault, SatelliteFault):
        return entry
    if isinstance(entry.fault, PlantFault) and all(_is_signal(name) for name in entry.fault.names):
        return msgspec.structs.replace(entry, ids=frozenset({RangeEpoch.id}))
    raise ConfigError(
        f"{entry.id}: {entry.name} on {', '.join(entry.targets) or 'the link'} cannot act"
        " on a RINEX file; PSEUDORANGE targets can, and PLANT targets of satellites"
    )


def _is_signal(name: str) -> bool:
    return name.startswith(tuple(f"{one}[" for one in SIGNALS))


def _sky(path: Path, navigation: Sequence[Path], entry: Entry) -> Sky:
    """Where the satellites stand, by the package that computes orbits."""
    if not navigation:
        raise ConfigError(
            f"{entry.id}: {', '.join(entry.targets)} pretends another place, which needs the"
            " satellites' orbits; give --nav FILE"
        )
    from importlib.metadata import entry_points

    found = list(entry_points(group="mavproxy_fault.skies"))
    if not found:
        raise ConfigError(f"{entry.id}: no installed package computes the satellites' orbits")
    sky: Sky = found[0].load()(path, navigation)
    return sky
