"""Every fault and every preset from log to log by `replay`, checked with pymavlink's decoder."""

import argparse
from pathlib import Path
from typing import Any

import pytest
import yaml
from pymavlink import mavutil

from mavproxy_fault.app.preview import RANGE_M, healthy_frame
from mavproxy_fault.app.replaying.replay import main
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.proxy.announcements import COMPONENT
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.schedule.entries import Entry, parse_schedule
from mavproxy_fault.schedule.presets import preset_names
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import read_labels

UNIX_US = 1_700_000_000_000_000
FRAMES, STEP_S = 100, 0.02
START_S, END_S = 0.4, 1.6  # of the fault, from the first stamp on
TIMES = {"at_s": START_S, "for_s": END_S - START_S}
MOST = 12  # satellites of a system in one message
# A recording cannot follow commands, which have their own tests.
EXAMPLES = {name: kind.example for name, kind in known_faults().items() if name != "command"}
FAULTS = [{"fault": name, **example} for name, example in EXAMPLES.items()]
NAMES = [name for name in preset_names() if not name.startswith("ardupilot-")]
STATIONS = {255, 245}  # system ids of ground stations
LATE = ("iridium-sbd",)  # frames arrive up to a minute after the fault
PRESETS = [{"preset": name} for name in NAMES]


def healthy(entries: tuple[Entry, ...], path: Path) -> None:
    """Write a log of HIL_SENSOR and the messages of the entries at 50 Hz."""
    messages = {"HIL_SENSOR"}
    satellites: set[str] = set()
    stations = sorted({entry.where.system for entry in entries} & STATIONS)
    for entry in entries:
        if isinstance(entry.fault, SatelliteFault):
            satellites |= set(entry.fault.names)
        named = entry.targets or getattr(entry.fault, "messages", ())
        heads = {name.split(".")[0] for name in named}
        messages |= heads - {"PLANT", "PSEUDORANGE"}
    with path.open("wb") as log:
        for n in range(FRAMES):
            t_s = 1.0 + n * STEP_S
            frames = [healthy_frame(name, t_s) for name in sorted(messages)]
            heartbeat = message_layout("HEARTBEAT")
            frames += [
                Frame(build_frame(heartbeat, {"type": 6}, seq=n, system=system), heartbeat)
                for system in stations
            ]
            if satellites and n % 5 == 0:
                for system in sorted({name[0] for name in satellites}):
                    names = sorted(name for name in satellites if name[0] == system)[:MOST]
                    names.append(f"{system}31")
                    zeros = [0.0] * len(names)
                    (one,) = encode_epoch(t_s, names, [RANGE_M] * len(names), zeros, zeros)
                    parts = tunnel_frames(one, n)
                    frames += [Frame(raw, message_layout("TUNNEL")) for raw in parts]
            for frame in frames:
                log.write((UNIX_US + round(t_s * 1e6)).to_bytes(8, "big") + frame.raw)


def decoded(path: Path) -> list[str]:
    """Return timestamp and content of pymavlink's messages in a log, without our announcements."""
    log: Any = mavutil.mavlink_connection(str(path), dialect="all")
    found = []
    while (message := log.recv_msg()) is not None:
        if message.get_type() != "STATUSTEXT" or message.get_srcComponent() != COMPONENT:
            found.append(f"{log.timestamp:.6f} {message.get_seq()} {message.to_dict()}")
    log.close()
    return found


@pytest.mark.parametrize("entry", [*FAULTS, *PRESETS], ids=[*EXAMPLES, *NAMES])
def test_a_log_shows_what_a_fault_did_and_nothing_else(
    entry: dict[str, Any], tmp_path: Path
) -> None:
    schedule = {"seed": 2, "faults": [{"id": "it", **entry, **TIMES}]}
    file, log, out = (tmp_path / part for part in ("faults.yaml", "in.tlog", "out.tlog"))
    file.write_text(yaml.safe_dump(schedule))
    healthy(parse_schedule(schedule).faults, log)
    main(
        argparse.Namespace(
            log=str(log), schedule=str(file), out=str(out), link=None,
            signing_key=None, strip_signatures=False,
        )
    )  # fmt: skip
    before, after = decoded(log), decoded(out)
    start, end = (f"{(UNIX_US + round((1.0 + s) * 1e6)) * 1e-6:.6f}" for s in (START_S, END_S))
    assert [line for line in after if line < start] == [line for line in before if line < start]
    # Pieces of a stream are no frames of a log.
    assert (after != before) == (entry.get("fault") != "slice")
    labels = read_labels(out.with_suffix(".labels.jsonl"))
    assert labels
    assert {label.id.split(".")[0] for label in labels} == {"it"}
    assert all(label.frames for label in labels if label.end_us is not None)
    if entry.get("preset") in LATE:
        return
    late = [line for line in after if line > f"{float(end) + 0.3:.6f}"]
    assert late == [line for line in before if line > f"{float(end) + 0.3:.6f}"]
