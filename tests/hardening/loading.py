"""How long frames wait while 1,000 entries are loaded: `python -m tests.hardening.loading`.

Frames are sent one by one; the slowest during a load is compared with the slowest of as many frames
without one, which shows the effect of other work on the machine. Measured once with the entries'
times in the future and once in the past.
"""

import json
import statistics
import threading
import time

from mavproxy_fault.links.bus import Bus, choose_free_port, open_bus
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from tests.hardening.proxy_process import Driven, driven

ENTRIES, LOADS = 1000, 15
FIELDS = ["xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag", "abs_pressure"]


def schedule(number: int, at_s: float) -> bytes:
    """Entries that no earlier schedule had."""
    faults = [
        {
            "id": f"load{number}-{n}", "fault": ["bias", "scale", "drift", "constant"][n % 4],
            "target": f"HIL_SENSOR.{FIELDS[n % 10]}", "value": 0.1 + n, "at_s": at_s + 0.01 * n,
            "for_s": 0.005,
        }
        for n in range(ENTRIES)
    ]  # fmt: skip
    return json.dumps({"seed": 1, "faults": faults}).encode()


def slowest_s(
    proxy: Driven, count: int, loading: threading.Thread | None = None
) -> tuple[float, int]:
    """The slowest of `count` frames, or of those that pass during a load, and how many."""
    slowest, passed = 0.0, 0
    while passed < count or (loading is not None and loading.is_alive()):
        begun_s = time.perf_counter()
        proxy.pass_frame()
        slowest, passed = max(slowest, time.perf_counter() - begun_s), passed + 1
    return slowest, passed


def measure(proxy: Driven, bus: Bus, at_s: float) -> str:
    """The median of some loads."""
    rows = []
    for number in range(LOADS):
        payload = schedule(number, at_s)
        load = threading.Thread(target=bus.query, args=("@ctl/schedule/load", payload, 60.0))
        load.start()
        loading_s, passed = slowest_s(proxy, 1, load)
        rows.append((loading_s, slowest_s(proxy, passed)[0]))
    with_load, without = (1e3 * statistics.median(row) for row in zip(*rows, strict=True))
    return f"slowest frame {with_load:.1f} ms with a load, {without:.1f} ms without (medians)"


def computed_ms(at_s: float) -> float:
    """What the loop's thread computes for a load, at the median; the rest is the asker's."""
    engine = Engine(parse_schedule(schedule(LOADS, at_s).decode()))
    engine.start_at(0)
    engine.advance_time(round(100e6))
    times = []
    for number in range(LOADS):
        following = parse_schedule(schedule(number, at_s).decode())
        prepared = engine.prepare_entries(following)
        begun_s = time.thread_time()
        before = engine.replace(following, prepared=prepared)
        times.append(1e3 * (time.thread_time() - begun_s))
        del before
    return statistics.median(times)


def main() -> None:
    """Measure and print."""
    print(f"computed in the loop: {computed_ms(1e6):.1f} ms (times ahead), {computed_ms(0.0):.1f}")
    url = choose_free_port("tcp/127.0.0.1:0")
    with driven("--zenoh", url, "--run", "loads") as proxy, open_bus(url, run="loads") as bus:
        slowest_s(proxy, 2000)
        print("times ahead: ", measure(proxy, bus, 1e6), flush=True)
        print("times passed:", measure(proxy, bus, 0.0))
        proxy.end()


if __name__ == "__main__":
    main()
