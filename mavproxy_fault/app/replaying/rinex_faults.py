"""Faults on a RINEX observation file: applies the engine to its epochs."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.recorder import encode_lines
from mavproxy_fault.documents.atomic_file import write_private
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.faults.plant_fault import PlantFault
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rinex.observation_text import file_epochs
from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rinex.rinex_text import PACKED, check_header, read_rinex_text
from mavproxy_fault.rinex.signal_change import Sky, needs_sky, signal_changes
from mavproxy_fault.rinex.signal_fields import has_range, write_change
from mavproxy_fault.schedule.entries import Entry, Schedule, never_acted, read_schedule
from mavproxy_fault.wire.label import Label
from mavproxy_fault.wire.plant_names import SIGNALS

PROBE_BYTES = 120  # contains the first line, Hatanaka-compressed or not
FROM_RECEIVER = "from-vehicle"
ON_SIGNALS = tuple(f"{one}[" for one in SIGNALS)  # beginnings of names


def is_rinex(path: Path) -> bool:
    """Whether a file is RINEX; compressed files are taken for RINEX."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(PROBE_BYTES)
    return b"RINEX VERSION" in head or path.name.lower().endswith(PACKED)


def replay_rinex(args: argparse.Namespace) -> int:
    """Write an observation file with faults, and the labels beside it."""
    path = Path(args.log)
    if args.out is None or args.schedule is None:
        raise ConfigError(f"replay {path}: a RINEX file needs --schedule FILE and --out FILE")
    out = Path(args.out)
    if out.exists() and out.samefile(path):
        raise ConfigError(f"{out}: is the replayed file itself; give another file")
    schedule, navigation = read_schedule(args.schedule), [Path(name) for name in args.nav or ()]
    lines, labels = faulted_lines(path, schedule, navigation)
    labels_path = out.with_suffix(out.suffix + ".labels.jsonl")
    with users_path(f"--out {out}", "give a file that can be written"):
        out.parent.mkdir(parents=True, exist_ok=True)
        write_private(out, ("\n".join(lines) + "\n").encode("ascii", "replace"))
        write_private(labels_path, encode_lines(labels))
    print_result(args, {"log": out, "labels": labels_path}, f"{out}\n{labels_path}")
    for word in never_acted(schedule, {label.id for label in labels}):
        print(f"fault {word} matched no observation", file=sys.stderr)
    return 0


def faulted_lines(
    path: Path, schedule: Schedule, navigation: Sequence[Path] = ()
) -> tuple[list[str], list[Label]]:
    """Apply a schedule to an observation file; return its lines and the labels.

    `at_s` counts from the first epoch. The navigation files are needed by faults that spoof
    another position.

    Raises
    ------
    ConfigError
        If a file cannot be read or is missing, or a fault does not act on satellite signals.
    """
    faults = tuple(_adapt_entry(entry) for entry in schedule.faults)
    sky = None
    for entry in faults:
        if isinstance(entry.fault, PlantFault) and needs_sky(entry.fault.names) and sky is None:
            sky = _sky(path, navigation, entry)
    lines = read_rinex_text(path)
    check_header(path, lines, "O", "an observation file")
    engine, last_us = Engine(Schedule(schedule.seed, faults)), 0
    labels, rng = [], np.random.default_rng(schedule.seed)
    for epoch in file_epochs(lines):
        last_us = max(last_us, epoch.t_us)
        observations = {name: epoch.fields(name) for name in epoch.rows}
        # Without a range, a label would claim a change that no one can measure.
        ranged = tuple(name for name, own in observations.items() if has_range(lines, own))
        before: Any = RangeEpoch(ranged)  # a frame to the engine
        for sent in engine.apply(before, FROM_RECEIVER, epoch.t_us):
            if isinstance(sent.frame, RangeEpoch) and sent.frame is not before:
                for name, change in signal_changes(sent.frame, epoch.t_us, sky):
                    write_change(lines, observations[name], name, change, rng)
        labels += engine.drain_labels()
    labels += engine.finish(last_us)
    return lines, [msgspec.structs.replace(label, recorded=True) for label in labels]


def _adapt_entry(entry: Entry) -> Entry:
    """Adapt an entry to the epochs of a file, which then carry plant parameters too."""
    if isinstance(entry.fault, SatelliteFault):
        return entry
    if isinstance(entry.fault, PlantFault) and all(
        name.startswith(ON_SIGNALS) for name in entry.fault.names
    ):
        return msgspec.structs.replace(entry, ids=frozenset({RangeEpoch.id}))
    raise ConfigError(
        f"{entry.id}: {entry.name} on {', '.join(entry.targets) or 'the link'} cannot act"
        " on a RINEX file; give a PSEUDORANGE target or a PLANT target of satellites"
    )


def _sky(path: Path, navigation: Sequence[Path], entry: Entry) -> Sky:
    """Load the satellite positions from the plugin that computes orbits."""
    if not navigation:
        raise ConfigError(
            f"{entry.id}: {', '.join(entry.targets)} spoofs another position, which needs the"
            " satellites' orbits; give --nav FILE"
        )
    from importlib.metadata import entry_points

    plugins = list(entry_points(group="mavproxy_fault.skies"))
    if not plugins:
        raise ConfigError(f"{entry.id}: no mavproxy_fault.skies plugin; install one for orbits")
    sky: Sky = plugins[0].load()(path, navigation)
    return sky
