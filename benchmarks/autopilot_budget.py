"""Measure the time of a step under a real PX4, and the speed of a trivial simulator.

Run by hand: `python benchmarks/autopilot_budget.py PATH/px4 [--turns N]`. Each turn flies
`examples/px4_hover.yaml` as `run --autopilot px4` does, and then gives a second PX4 the bytes of
that flight: the same messages at the same steps, so that it arms and flies with the same sensors,
but from memory and as fast as it answers. Both are measured in hover, 25 s to 55 s of PX4's time.
"""

import argparse
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from analysis.autopilots import autopilot_run
from analysis.autopilots.px4.px4_process import (
    STARTUP_TEXT,
    free_udp_port,
    process_environment,
    stream_script,
)
from analysis.run.proxied_flight import HIL_COMPONENT
from mavproxy_fault import cli
from simvehicle.app.lockstep_loop import LockstepLoop
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Truth

SCENARIO = Path(__file__).parents[1] / "examples" / "px4_hover.yaml"
FROM_US, TO_US = 25_000_000, 55_000_000  # of PX4's time
STEP_US = 4_000
STEPS = (TO_US - FROM_US) // STEP_US
PORT = 4560
INSTANCE = 40  # not used by a run
TRUTH, GROUND_STATION = 115, 255  # message id, system id
ANSWER_S = 5.0
ABOVE_NS = 1_000 * STEPS  # threads with less than a microsecond per step are not listed

Spent = dict[tuple[str, str], int]


def spent(pid: int) -> Spent:
    """Return the processor time [ns] of each thread of a process."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):
            name = (task / "comm").read_text().strip()
            found[task.name, name] = int((task / "schedstat").read_text().split()[0])
    return found


def family() -> dict[str, Spent]:
    """Return the processor times of this process and its children, by role."""
    found = {"run": spent(os.getpid())}
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = (place / "stat").read_text().rpartition(")")[2].split()[1]
            if int(parent) == os.getpid():
                words = (place / "cmdline").read_bytes().split(b"\0")
                name = "PX4" if words[0].endswith(b"px4") else "monitor"
                found[name] = found.get(name, {}) | spent(int(place.name))
    return found


class Interval:
    """Measures the time between two simulation times; `at` is called at each step."""

    def __init__(self, count: Callable[[], dict[str, Spent]]) -> None:
        self._count = count
        self._marks: list[tuple[int, dict[str, Spent]]] = []

    def at(self, t_us: int) -> None:
        """Record the times at the beginning and the end of the interval."""
        if t_us >= (FROM_US, TO_US, TO_US * TO_US)[len(self._marks)]:
            self._marks.append((time.perf_counter_ns(), self._count()))

    def report(self, name: str) -> None:
        """Print the time per step in microseconds."""
        (from_ns, before), (to_ns, after) = self._marks
        wall = (to_ns - from_ns) / STEPS / 1e3
        load = os.getloadavg()[0]
        print(
            f"{name}: {wall:.0f} us a step, {STEP_US / wall:.1f} times real time, load {load:.1f}"
        )
        for who, threads in after.items():
            rows = [(now - before.get(who, {}).get(key, 0), key[1]) for key, now in threads.items()]
            parts = [f"{n} {ns / STEPS / 1e3:.0f}" for ns, n in sorted(rows)[::-1] if ns > ABOVE_NS]
            total = sum(ns for ns, _ in rows) / STEPS / 1e3
            print(f"  {who}: {total:.0f} us of processor time; {', '.join(parts)}")


class MeasuredLoop(LockstepLoop):
    """A lockstep loop that is measured."""

    interval: Interval

    def _flown(self, truth: Truth) -> None:
        super()._flown(truth)
        self.interval.at(self.t_us + self._hil.start_us)


def left_for_px4(log: bytes) -> list[tuple[int, bytes]]:
    """Return step and bytes of the frames for PX4 in a sent.tlog; step -1 for telemetry."""
    kept: list[tuple[int, bytes]] = []
    at, hil = 0, b""
    while at < len(log):
        raw = log[at + 8 : at + 20 + log[at + 9]]
        at += 8 + len(raw)
        if raw[6] == HIL_COMPONENT:
            hil += raw
            # The truth is the last frame of a step.
            if raw[7] == TRUTH:
                kept.append((int.from_bytes(raw[10:18], "little"), hil))
                hil = b""
        elif raw[5] == GROUND_STATION:
            kept.append((-1, raw))
    return kept


def fly(binary: str, folder: Path) -> list[tuple[int, bytes]]:
    """Fly as a user does; return the frames sent to PX4."""
    MeasuredLoop.interval = Interval(family)
    autopilot_run.LockstepLoop = MeasuredLoop
    cli.main([
        "run", str(SCENARIO), "--autopilot", "px4", "--binary", binary,
        "--out", str(folder / "flight"), "--no-report",
    ])  # fmt: skip
    MeasuredLoop.interval.report("flight")
    return left_for_px4((folder / "flight" / "sent.tlog").read_bytes())


@contextmanager
def px4(binary: str, place: Path, ports: tuple[int, int]) -> Iterator["subprocess.Popen[bytes]"]:
    """Start PX4 as a run does, with its MAVLink between two UDP ports."""
    place.mkdir()
    (place / "px4-rc.mavlink").write_text(stream_script(*ports))
    words = [binary, "-d", str(Path(binary).parents[1] / "etc"), "-w", str(place)]
    with (place / "px4.log").open("wb") as log:
        process = subprocess.Popen(
            [*words, "-i", str(INSTANCE)],
            env=process_environment(Simulation(read_scenario(SCENARIO)), place, {}),
            cwd=place, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
        )  # fmt: skip
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def replay(binary: str, folder: Path, kept: list[tuple[int, bytes]]) -> None:
    """Send the same bytes to another PX4, from memory."""
    place = folder / "replayed"
    with (
        socket.create_server(("127.0.0.1", PORT + INSTANCE)) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as telemetry,
    ):
        telemetry.bind(("127.0.0.1", 0))
        port = free_udp_port()
        with px4(binary, place, (port, telemetry.getsockname()[1])) as process:
            link = server.accept()[0]
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            interval = Interval(
                lambda: {"PX4": spent(process.pid), "simulator": spent(os.getpid())}
            )
            answering = started = False
            with link, autopilot_run.real_time_priority():
                for step_us, data in kept:
                    if step_us < 0:
                        telemetry.sendto(data, ("127.0.0.1", port))
                        continue
                    link.sendall(data)
                    answering = answered(link, step_us, ANSWER_S if answering else 0.004)
                    interval.at(step_us)
                    # The last lines of PX4's start script start its logger.
                    if answering and not started and step_us % 100_000 == 0:
                        time.sleep(0.02)
                        started = STARTUP_TEXT in (place / "px4.log").read_text(errors="replace")
            interval.report("its bytes from memory")


def answered(link: socket.socket, step_us: int, wait_s: float) -> bool:
    """Whether PX4 answers a step in time."""
    stamp = step_us.to_bytes(8, "little")
    if link.gettimeout() != wait_s:
        link.settimeout(wait_s)
    try:
        while stamp not in link.recv(65_536):
            pass
    except TimeoutError:
        return False
    return True


def main() -> None:
    """Fly and replay in turns."""
    parser = argparse.ArgumentParser()
    parser.add_argument("px4")
    parser.add_argument("--turns", type=int, default=1)
    args = parser.parse_args()
    for _ in range(args.turns):
        with tempfile.TemporaryDirectory() as folder:
            kept = fly(args.px4, Path(folder))
            replay(args.px4, Path(folder), kept)


if __name__ == "__main__":
    main()
