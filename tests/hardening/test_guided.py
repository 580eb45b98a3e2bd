"""Coverage-guided fuzzing of traffic and schedules.

`python -m tests.hardening.test_guided traffic --seconds 600` is the long form, `schedule` the other
target; both need atheris (`pip install atheris`). The fast form calls the targets with the inputs
that the fuzzer starts from. The core and its compiled path get the same datagrams and must produce
the same output; at the end a mark that no fault acts on must leave once.
"""

import argparse
import contextlib
import gc
import mmap
import random
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import BinaryIO
from unittest.mock import patch

import pytest

from mavproxy_fault.compiled.object_file import Forward, load, make
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.udp import IS_LINUX
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.senders import new_senders
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from tests.hardening.test_mutated_traffic import LONGEST, NAMES, mark, mutated, sixteen

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST_S = 2.0  # of processor time per input, with the fuzzer's instrumentation
WALL_US, STEP_US = 1_700_000_000_000_000, 5_000
MARK = 12_345_678
# The code that a peer's bytes reach; instrumenting everything would be too slow.
WATCHED = {
    "traffic": ("wire.", "proxy.", "faults.", "fault_parts."),
    "schedule": ("",),
}
STREAM, FAULTS = 1, 2  # bits of an input's first byte


def pieces(data: bytes) -> list[bytes]:
    """Split an input into pieces: raw bytes, or the payload of a frame with a correct CRC.

    Each piece is a byte for its kind, a byte for its length, and that many bytes.
    """
    found: list[bytes] = []
    while len(data) > 1:
        kind, length, rest = data[0], data[1], data[2:]
        part, data = rest[:length], rest[length:]
        if kind % 2:
            described = message_layout(NAMES[kind // 2 % len(NAMES)])
            shell = build_frame(
                described, {}, seq=len(found) & 255, system=1 + kind // 128, component=1
            )
            payload = part[: described.length] or b"\0"
            part = Frame(shell, described).with_payload(payload).raw
        found.append(part)
    return found


@cache
def faults() -> Schedule:
    return parse_schedule(sixteen())


@cache
def initial_senders() -> BinaryIO:
    """A file with the initial senders array of a core."""
    file = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as the process lives
    file.write(new_senders().tobytes())
    file.flush()
    return file


def senders() -> memoryview:
    """Map the file copy-on-write.

    Copying six megabytes for each input would cost more than everything else.
    """
    return memoryview(mmap.mmap(initial_senders().fileno(), 0, flags=mmap.MAP_PRIVATE)).cast("q")


def core(data: bytes) -> tuple[Core, CaptureBuffer]:
    """A core with the options in an input's first byte."""
    engine, tape = Engine(faults()) if data[0] & FAULTS else None, CaptureBuffer()
    links = [
        LinkRole("vehicle", "from-vehicle", not data[0] & STREAM),
        LinkRole("station", "to-vehicle", datagrams=True),
    ]
    with patch("mavproxy_fault.proxy.core.new_senders", senders):
        return Core(links, engine, tape=tape), tape


@cache
def made() -> Forward | None:
    """The compiled code; its sources are checked only once."""
    make()
    return load()


def machine(one: Core, tape: CaptureBuffer) -> Passage | None:
    """The core's compiled path; None on systems without one."""
    if not IS_LINUX:
        return None
    with patch("mavproxy_fault.compiled.compiled_core.load", made):
        return Passage(one, tape)


def failures(one: Core) -> list[str]:
    """Errors inside faults, which the core survives."""
    state = {"faults": []} if one.engine is None else one.engine.state()
    return [fault["failure"] for fault in state["faults"] if fault.get("failure")]


def traffic(data: bytes) -> None:
    """Forward an input with the interpreted core and, where available, the compiled path."""
    if not data:
        return
    (reference, _), (other, tape) = core(data), core(data)
    passage = None if data[0] & STREAM else machine(other, tape)
    now_us, parts = WALL_US, [*pieces(data[1:])]
    for part in parts:
        now_us += STEP_US
        sends = reference.received(0, part, now_us)
        take = other if passage is None else passage
        again = take.received(0, part, now_us)
        # A datagram may leave in several.
        for link in range(2):
            one, two = (
                b"".join(send.data for send in out if send.link == link) for out in (sends, again)
            )
            assert one == two, (sends, again)
    for one in (reference, other):
        left = b"".join(
            send.data
            for data, late_us in ((bytes(LONGEST), 0), (mark(MARK), 2_000_000), (b"", 9_000_000))
            for send in (
                one.received(0, data, now_us + late_us) if data else one.due(now_us + late_us)
            )
        )
        assert left.count(mark(MARK)) == 1
        assert not failures(one)


def schedule(data: bytes) -> None:
    """Read a schedule: it is valid, or refused with a ConfigError."""
    with contextlib.suppress(ConfigError):
        parse_schedule(data.decode("utf-8", "replace"))


TARGETS = {"traffic": traffic, "schedule": schedule}


def seeds(target: str) -> list[bytes]:
    """The initial inputs."""
    if target == "schedule":
        texts = [path.read_bytes() for path in sorted(EXAMPLES.glob("*.yaml"))]
        return [sixteen().encode(), *texts]
    rng = random.Random(1)
    found = []
    for first in range(4):
        for _ in range(10):
            parts = [rng.randbytes(2)[:1] + _measured(mutated(rng, n)) for n in range(4)]
            found.append(bytes([first]) + b"".join(parts))
    return found


def _measured(data: bytes) -> bytes:
    data = data[:255]
    return bytes([len(data)]) + data


@pytest.mark.parametrize("target", list(TARGETS))
def test_the_seeds_of_the_fuzzer_pass(target: str) -> None:
    for seed in seeds(target):
        TARGETS[target](seed)


def main() -> None:
    """Run atheris until the time is over or an input fails."""
    import atheris

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--seconds", type=int, default=600)
    args = parser.parse_args()

    def called(data: bytes) -> None:
        begun_s = time.process_time()
        TARGETS[args.target](data)
        took_s = time.process_time() - begun_s
        assert took_s < MOST_S, took_s

    made()  # load the compiled code before timing starts
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(seeds(args.target)):
            Path(folder, f"{number}").write_bytes(seed)
        options = [f"-max_total_time={args.seconds}", "-max_len=4000", "-rss_limit_mb=4096"]
        instrumented = tuple(f"mavproxy_fault.{room}" for room in WATCHED[args.target])
        for one in gc.get_objects():
            if isinstance(one, FunctionType) and str(one.__module__).startswith(instrumented):
                atheris.instrument_func(one)
        atheris.Setup([sys.argv[0], *options, folder], called)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
