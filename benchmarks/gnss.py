"""What a GNSS epoch costs: the sensor with its receiver, RTCM in and out, TUNNEL.

Run by hand: `python benchmarks/gnss.py`. Each figure is the best of 30 rounds; the last column
compares with a fixed piece of Python work done in the same run, as machines and their load differ.
"""

import math
import platform
import time
from collections.abc import Callable

import numpy as np

from mavproxy_fault.rtcm.ephemeris_messages import decode_ephemeris
from mavproxy_fault.rtcm.msm7 import decode_msm7, encode_epoch, patch_msm7
from mavproxy_fault.rtcm.transport import tunnel_frames
from simvehicle.gnss.constellation import build_constellation
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.gnss_sensor import GnssSensor
from simvehicle.sensors.readings import EphemerisReading, PseudorangeReading, Reading
from simvehicle.vehicles.body import Truth

ROUNDS = 30
HOME = (math.radians(47.4), math.radians(8.5))


def best_us(action: Callable[[], object], repeats: int) -> float:
    """Best time of one call in microseconds."""
    best = math.inf
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(repeats):
            action()
        best = min(best, time.perf_counter() - start)
    return best / repeats * 1e6


def truth_at(t_us: int) -> Truth:
    """At rest over the home."""
    zero = np.zeros(3)
    return Truth(
        t_us, *HOME, 500.0, 453.0, 0.0, zero, zero, np.array([1.0, 0.0, 0.0, 0.0]), zero, zero,
        zero, zero, 95_000.0, 285.0, 1.16, 16.0, 0.0, 1.0,
    )  # fmt: skip


class Flight:
    """A sensor that goes on epoch by epoch."""

    def __init__(self) -> None:
        self.sensor = GnssSensor(GnssConfig(), build_constellation(GnssConfig(), *HOME))
        self.rng = np.random.default_rng(1)
        self.state = self.sensor.new_state(self.rng)
        self.t_us = 0
        self.readings = self.sample()

    def sample(self) -> list[Reading]:
        """The next epoch."""
        self.readings, self.state = self.sensor.sample(truth_at(self.t_us), self.state, self.rng)
        self.t_us += 200_000
        return self.readings


def main() -> None:
    """Print the table."""
    flight = Flight()
    first = [r for r in flight.readings if isinstance(r, EphemerisReading)]
    (raw,) = [r for r in flight.sample() if isinstance(r, PseudorangeReading)]

    def encode() -> list[bytes]:
        return encode_epoch(
            raw.tow_s,
            raw.satellites,
            raw.pseudorange_m.tolist(),
            raw.doppler_mps.tolist(),
            raw.cn0_dbhz.tolist(),
        )

    messages = encode()
    rows: dict[str, tuple[Callable[[], object], int]] = {
        "fixed work: sum of 1000 squares": (lambda: sum(i * i for i in range(1000)), 20),
        f"sensor and receiver, {len(raw.satellites)} satellites": (flight.sample, 20),
        "MSM7 of both systems, encode": (encode, 20),
        "MSM7 of both systems, decode": (lambda: [decode_msm7(m) for m in messages], 20),
        "MSM7 of GPS, patch one satellite": (lambda: patch_msm7(messages[0], {"G17": 9.0}), 20),
        "TUNNEL frames of both": (lambda: [tunnel_frames(m, 0) for m in messages], 20),
        "ephemeris, decode": (lambda: decode_ephemeris(first[0].rtcm), 20),
    }
    times = {name: best_us(action, repeats) for name, (action, repeats) in rows.items()}
    unit = next(iter(times.values()))
    print(f"{platform.processor() or platform.machine()}, Python {platform.python_version()}\n")
    print("| step | us | of the fixed work |\n|---|---|---|")
    for name, us in times.items():
        print(f"| {name} | {us:.0f} | {us / unit:.1f} |")


if __name__ == "__main__":
    main()
