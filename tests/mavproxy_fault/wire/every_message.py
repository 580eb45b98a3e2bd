"""Every message of MAVLink XML files as a target, in a recording and in a report.

    python tests/mavproxy_fault/wire/every_message.py FILE.xml [FILE.xml ...]

The judge is the Python module that pymavlink generates from the same XML. Each message passes the
proxy's core as MAVLink 1, 2 and signed, and must leave byte for byte as it came; then a fault on
one of its fields must change that field and nothing else, or a `drop` take it away. A report of
the recording must list it.
"""

import contextlib
import importlib.util
import io
import math
import os
import random
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

WALL_US = 1_700_000_000_000_000
SPACING_US = 1000
INTEGERS = {
    "int8_t",
    "uint8_t",
    "int16_t",
    "uint16_t",
    "int32_t",
    "uint32_t",
    "int64_t",
    "uint64_t",
}


def generate_judge(xml: Path, folder: Path) -> ModuleType:
    """Generate pymavlink's module of an XML file and import it."""
    from pymavlink.generator import mavgen

    options = mavgen.Opts(
        str(folder / "judge"), wire_protocol="2.0", language="Python", strict_units=False
    )
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        mavgen.mavgen(options, [str(xml)])
    spec = importlib.util.spec_from_file_location("judge", folder / "judge.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["judge"] = module
    spec.loader.exec_module(module)
    return module


def drawn_value(kind: str, count: int, rng: random.Random) -> Any:
    """A value of a field, away from its limits."""
    if kind == "char":
        return bytes(rng.choices(range(65, 90), k=max(count, 1)))
    one = (
        (lambda: rng.uniform(1, 9)) if kind in ("float", "double") else (lambda: rng.randint(1, 90))
    )
    return [one() for _ in range(count)] if count else one()


def packed_frames(judge: ModuleType, kind: Any, rng: random.Random) -> list[bytes]:
    """One message as MAVLink 1 (if it exists there), 2, and signed."""
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    drawn = {name: drawn_value(types[name], counts[name], rng) for name in kind.fieldnames}
    # A target would route it; the value 0 is everybody.
    drawn |= {name: 0 for name in ("target_system", "target_component") if name in drawn}
    if kind.msgname == "HEARTBEAT":
        drawn["type"] = 2
    frames = []
    for version in ("1", "2", "signed"):
        if version == "1" and kind.id > 255:
            continue
        sender = judge.MAVLink(None, srcSystem=1, srcComponent=1)
        sender.seq = rng.randrange(256)
        if version == "signed":
            sender.signing.secret_key = b"k" * 32
            sender.signing.sign_outgoing = True
            sender.signing.timestamp = 1
        names = [name for name in kind.fieldnames if name in drawn and name != "mavlink_version"]
        message = kind(
            *(drawn[name] for name in names), *([3] if "mavlink_version" in drawn else [])
        )
        frames.append(bytes(message.pack(sender, force_mavlink1=version == "1")))
    return frames


def target_field(kind: Any) -> tuple[str, float]:
    """A numeric field that is neither a time nor part of the routing, and a change of it."""
    for name, length, one in zip(kind.ordered_fieldnames, kind.array_lengths,
                                 [dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))[n]
                                  for n in kind.ordered_fieldnames], strict=True):  # fmt: skip
        if (
            one in INTEGERS | {"float", "double"}
            and "time" not in name
            and not name.startswith("target_")
        ):
            return f"{name}[0]" if length else name, 1.0
    return "", 0.0


def decoded(judge: ModuleType, raw: bytes) -> dict[str, Any]:
    """The values of a frame by the judge."""
    reader = judge.MAVLink(None)
    reader.robust_parsing = True
    (message,) = reader.parse_buffer(bytearray(raw))
    assert message.get_type() != "BAD_DATA", message
    values: dict[str, Any] = message.to_dict()
    return values


def differing(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """The fields, and elements of arrays, that differ."""
    found = []
    for name, value in before.items():
        other = after[name]
        if isinstance(value, list):
            found += [
                f"{name}[{i}]" for i, (a, b) in enumerate(zip(value, other, strict=True)) if a != b
            ]
        elif value != other and not (isinstance(value, float) and math.isnan(value)):
            found.append(name)
    return found


def check_proxy(judge: ModuleType, recording: Path) -> list[str]:
    """Pass every message through the core and write the recording; return what is wrong."""
    from mavproxy_fault.proxy.core import Core, LinkRole
    from mavproxy_fault.proxy.engine import Engine
    from mavproxy_fault.schedule.entries import parse_schedule

    rng, wrong = random.Random(1), []
    frames = {kind.msgname: packed_frames(judge, kind, rng) for kind in judge.mavlink_map.values()}
    roles = (LinkRole("vehicle", "from-vehicle"), LinkRole("others", "to-vehicle"))
    core, log = Core(roles), b""
    for i, (name, raws) in enumerate(frames.items()):
        for raw in raws:
            wall_us = WALL_US + i * SPACING_US
            # A signing key goes to the vehicle only.
            link = 1 if name == "SETUP_SIGNING" else 0
            if [send.data for send in core.received(link, raw, wall_us)] != [raw]:
                wrong.append(f"{name}: not forwarded as it came")
        log += struct.pack(">Q", wall_us) + raws[-2] + struct.pack(">Q", wall_us + 500) + raws[-2]
    recording.write_bytes(log)
    for kind in judge.mavlink_map.values():
        name, (field, change) = kind.msgname, target_field(kind)
        entry = {"id": "it", "fault": "drop", "target": name}
        if field:
            entry = {"id": "it", "fault": "bias", "target": f"{name}.{field}", "value": change}
        core = Core(roles, Engine(parse_schedule({"faults": [entry]})))
        for raw in frames[name][:-1]:
            # A notice of the fault may follow.
            sends = [one.data for one in core.received(name == "SETUP_SIGNING", raw, WALL_US)][:1]
            if not field:
                wrong += [f"{name}: not dropped"] if raw in sends else []
            elif not sends or differing(decoded(judge, raw), decoded(judge, sends[0])) != [field]:
                wrong.append(f"{name}.{field}: the fault changed something else, or nothing")
    return wrong


def check_report(judge: ModuleType, recording: Path) -> list[str]:
    """Write the report of the recording; return the messages that it does not list."""
    done = subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", "report", str(recording), "--out",
         str(recording.parent / "report"), "--data", "beside"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    (page,) = (recording.parent / "report").rglob("report.html")
    text = page.read_text().replace('": "', '":"')
    wrong = [f"report: {done.stderr[-300:]}"] if done.returncode not in (0, 1) else []
    names = [kind.msgname for kind in judge.mavlink_map.values()]
    return wrong + [
        f"{name}: not in the report" for name in names if f'"name":"{name}"' not in text
    ]


def main() -> int:
    """Check each file in a process of its own, as a dialect is read once."""
    if len(sys.argv) > 2:
        return max(subprocess.call([sys.executable, __file__, name]) for name in sys.argv[1:])
    xml = Path(sys.argv[1]).resolve()
    os.environ["MAVPROXY_FAULT_DIALECT"] = str(xml)
    with tempfile.TemporaryDirectory() as folder:
        judge = generate_judge(xml, Path(folder))
        recording = Path(folder) / "every.tlog"
        wrong = check_proxy(judge, recording) + check_report(judge, recording)
    print(f"{xml.name}: {len(judge.mavlink_map)} messages, {len(wrong)} wrong", flush=True)
    for line in wrong:
        print(f"  {line}")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
