"""Simulation speed of one vehicle with all sensors, with HIL frames packed and sent.

Run `python benchmarks/sim_link.py`. It reports the best simulated second of each column in CPU time
of this process, which a busy machine disturbs little; each row starts with a fixed piece of work to
compare machines and their load. Frames go by UDP to an unread loopback socket.
"""

import argparse
import math
import socket
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mavproxy_fault.links.spec import open_link
from simvehicle.app.sim_server import join_datagrams
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation

SENSORS = """
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
  airspeed: {preset: mpxv5004dp, rate_hz: 50}
  gps: {preset: beard-mclain, rate_hz: 5}
  range: {preset: consumer-laser, rate_hz: 20, max_m: 200}
  flow: {preset: consumer-flow, rate_hz: 20, max_m: 200}
  vision: {preset: visual-odometry, rate_hz: 30}
  battery: {preset: power-module, rate_hz: 2}
"""
GNSS = "gnss: {rate_hz: 5, systems: [GPS, Galileo]}\n"
VEHICLES = {
    "multirotor iris": "vehicle: {kind: multirotor, parameters: iris}\n"
    "mission: [{shape: circle, size_m: 60, height_m: 20, speed_mps: 5}]\n",
    "fixed wing aerosonde-2025": "vehicle: {kind: fixedwing, parameters: aerosonde-2025}\n"
    "mission: [{shape: eight, size_m: 800, height_m: 100, speed_mps: 25}]\n",
}
START = "start: {height_m: 100}\nenvironment: {wind_ned_mps: [2, -3, 0], gusts: light}\n"


def simulation(text: str) -> Simulation:
    """A simulation after 500 steps, with compiled kernels."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(text)
        flight = Simulation(read_scenario(path))
    for _ in range(500):
        flight.step()
    return flight


def times_real(seconds: float, step: Callable[[], object]) -> float:
    """Best ratio of simulated seconds to CPU seconds, at 250 steps per simulated second."""
    best = math.inf
    for _ in range(round(seconds)):
        start = time.process_time()
        for _ in range(250):
            step()
        best = min(best, time.process_time() - start)
    return 1.0 / best


def measure(text: str, seconds: float, port: int) -> tuple[float, float, float]:
    """Multiples of real time of the steps only, with frames packed, and with frames sent."""
    flight = simulation(text)
    hil = HilPacker(flight.board)
    link = open_link(f"udpout:127.0.0.1:{port}")

    def pack() -> list[bytes]:
        _, _, readings = flight.step()
        return hil.frames(readings)

    def send() -> None:
        for chunk in join_datagrams(pack()):
            link.write(chunk)

    speeds = (
        times_real(seconds, flight.step),
        times_real(seconds, pack),
        times_real(seconds, send),
    )
    link.close()
    return speeds


def fixed_work_us() -> float:
    """Best CPU time [us] of a fixed piece of Python, to compare machines and loads."""
    best = math.inf
    for _ in range(300):
        start = time.process_time()
        sum(i * i for i in range(1000))
        best = min(best, time.process_time() - start)
    return best * 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=30.0, help="simulated, per measurement")
    seconds = parser.parse_args().seconds
    print("| vehicle, all sensors, IMU 250 Hz | fixed work, us | steps | + packed | + sent |")
    print("|---|---|---|---|---|")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        port = sink.getsockname()[1]
        for name, vehicle in VEHICLES.items():
            for gnss in ("", GNSS):
                text = vehicle + START + "sensors:" + SENSORS + gnss
                speeds = measure(text, seconds, port)
                label = name + (", GNSS 5 Hz" if gnss else "")
                figures = [fixed_work_us(), *speeds]
                print(f"| {label} | " + " | ".join(f"{s:.0f}" for s in figures) + " |", flush=True)


if __name__ == "__main__":
    main()
