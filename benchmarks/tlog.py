"""Speed and recovery of log readers: mavproxy-fault, fasttlogparser and pymavlink.

    python benchmarks/tlog.py [MEGABYTES]

The logs are real ones (see MAVPROXY_FAULT_DATA in tests/conftest.py), repeated to the size wanted.
Each reader runs in a process of its own, on one core, after the file has been read once; speed is
per second of processor time, so that other work on the machine counts little; memory is the growth
of the process's peak over what it had after importing. fasttlogparser (C++) is not on the wheel
index: `python -m pip install --no-build-isolation fasttlogparser` builds it.
"""

import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DATA = Path(os.environ.get("MAVPROXY_FAULT_DATA", "../shared/data"))
LOGS = (
    "tlog/dronekit_flight_replay.tlog",
    "px4_hil/hover_gps_jump_hil.tlog",
    "px4_hil/hover_gps_jump_gcs.tlog",
)
LEAST_MEMORY = 400_000_000  # bytes of data that the process reading block by block may hold
PYMAVLINK_MB = 8  # it would take minutes for more
READERS = ("mavproxy-fault", "fasttlogparser", "pymavlink")


def reset_peak() -> int:
    """Forget the peak of the start-up (Linux); the memory now."""
    Path("/proc/self/clear_refs").write_text("5")
    return peak_now()


def peak_now() -> int:
    """The most memory this process held since `reset_peak`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("no VmHWM: this measures memory on Linux only")


def read(reader: str, path: str) -> dict[str, float]:
    """Read a log with one reader: frames, processor seconds and memory."""
    if reader == "mavproxy-fault":
        from mavproxy_fault.wire.tlog import read_columns

        read_columns(DATA / LOGS[2])  # loads the compiled code

        def count() -> int:
            return sum(len(rows) for rows in read_columns(path).values())
    elif reader == "fasttlogparser":
        import fasttlogparser

        def count() -> int:
            messages, _ = fasttlogparser.parseTLog(path)
            return sum(len(next(iter(fields.values()))) for fields in messages.values())
    else:
        from pymavlink import mavutil

        def count() -> int:
            log = mavutil.mavlink_connection(path)
            frames = 0
            while (message := log.recv_match()) is not None:
                frames += message.get_type() != "BAD_DATA" and message.get_msgId() >= 0
            return frames

    before = reset_peak()
    start_s, wall_s = time.process_time(), time.perf_counter()
    frames = count()
    return {
        "frames": frames,
        "cpu_s": time.process_time() - start_s,
        "wall_s": time.perf_counter() - wall_s,
        "memory": peak_now() - before,
    }


def measured(reader: str, path: Path, times: int = 3) -> dict[str, float]:
    """The best of some runs, each in a process of its own."""
    best: dict[str, float] = {}
    for _ in range(times):
        command = [sys.executable, __file__, "--read", reader, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            return {}
        found = json.loads(done.stdout.splitlines()[-1])
        if not best or found["cpu_s"] < best["cpu_s"]:
            best = found
    return best


def damaged(data: bytes, drop: bool) -> bytes:
    """One byte in a thousand changed, or lost."""
    rng = random.Random(1)
    found = bytearray(data)
    for at in sorted(rng.sample(range(len(found)), len(found) // 1000), reverse=True):
        if drop:
            del found[at]
        else:
            found[at] ^= rng.randrange(1, 256)
    return bytes(found)


def speed(folder: Path, megabytes: int) -> None:
    print(f"| log ({megabytes} MB) | reader | frames | MB/s | memory / file |")
    print("|---|---|---:|---:|---:|")
    for name in LOGS:
        data = (DATA / name).read_bytes()
        for reader in READERS:
            size = PYMAVLINK_MB if reader == "pymavlink" else megabytes
            path = folder / "log.tlog"
            path.write_bytes(data * max(1, size * 1_000_000 // len(data)))
            found = measured(reader, path, 1 if reader == "pymavlink" else 3)
            show(Path(name).stem, reader, found, path.stat().st_size)


def show(name: str, reader: str, found: dict[str, float], size: int) -> None:
    if not found:
        print(f"| {name} | {reader} | fails | | |")
        return
    rate = size / 1e6 / found["cpu_s"]
    memory = found["memory"] / size
    print(f"| {name} | {reader} | {found['frames']:,} | {rate:.1f} | {memory:.1f} |", flush=True)


def beyond_memory(folder: Path) -> None:
    """Read a log in blocks in a process that may not hold as much as the log is long."""
    path = folder / "log.tlog"
    data = (DATA / LOGS[1]).read_bytes()
    path.write_bytes(data * (1_000_000_000 // len(data)))
    command = [sys.executable, __file__, "--blocks", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    size = path.stat().st_size
    print(
        f"\nA log of {size / 1e6:.0f} MB in blocks, in a process of {LEAST_MEMORY / 1e6:.0f} MB "
        f"of data: {found['frames']:,} frames, {size / 1e6 / found['cpu_s']:.0f} MB/s."
    )


def read_blocks(path: str) -> dict[str, float]:
    from mavproxy_fault.wire import tlog

    tlog.read_columns(DATA / LOGS[2])  # loads the compiled code
    resource.setrlimit(resource.RLIMIT_DATA, (LEAST_MEMORY, LEAST_MEMORY))
    start_s = time.process_time()
    frames = sum(len(rows) for block in tlog.read_blocks(path) for rows in block.values())
    return {"frames": frames, "cpu_s": time.process_time() - start_s}


def recovery(folder: Path) -> None:
    print("\n| corruption | reader | frames | of the entire log |")
    print("|---|---|---:|---:|")
    data = (DATA / LOGS[1]).read_bytes()
    path = folder / "log.tlog"
    path.write_bytes(data)
    complete = measured("mavproxy-fault", path, 1)["frames"]
    for drop in (False, True):
        path.write_bytes(damaged(data, drop))
        for reader in READERS:
            found = measured(reader, path, 1)
            what = "1 byte in 1,000 " + ("lost" if drop else "changed")
            share = f"{100 * found['frames'] / complete:.2f} %" if found else "fails"
            print(f"| {what} | {reader} | {found.get('frames', 0):,} | {share} |", flush=True)


def main() -> None:
    if sys.argv[1:2] == ["--read"]:
        print(json.dumps(read(sys.argv[2], sys.argv[3])))
        return
    if sys.argv[1:2] == ["--blocks"]:
        print(json.dumps(read_blocks(sys.argv[2])))
        return
    with tempfile.TemporaryDirectory() as folder:
        speed(Path(folder), int(sys.argv[1]) if sys.argv[1:] else 100)
        recovery(Path(folder))
        beyond_memory(Path(folder))


if __name__ == "__main__":
    main()
