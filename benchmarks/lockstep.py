"""Speed of a flight in lockstep with a stand-in for PX4 over TCP, through the proxy.

Run `python benchmarks/lockstep.py [--steps N] [--faults]`. The stand-in is another process that
answers each HIL_SENSOR of id 0 at once, so what is measured is the loop: simulator, proxy, link.
It reports microseconds a step, by the clock and of this process' processor time, best of five.
"""

import argparse
import math
import multiprocessing
import socket
import struct
import tempfile
import time
from contextlib import closing, suppress
from io import StringIO
from pathlib import Path

from analysis.autopilots.autopilot_run import real_time_priority
from analysis.autopilots.hil_exchange import AutopilotReceiver, AutopilotSender, ConnectionDeadline
from analysis.run.proxied_flight import ProxiedFlight
from mavproxy_fault.compiled.passage import new_passage
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import frame_payload
from simvehicle.app.lockstep_loop import LockstepLoop, PeerGoneError
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import mav_type_and_mix
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.scenario.scenario_file import read_scenario

SCENARIO = """
name: lockstep
vehicle: {kind: multirotor, parameters: iris}
environment: {gusts: light}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
  gps: {preset: consumer, rate_hz: 5}
  battery: {rate_hz: 2}
"""
FAULTS = {"faults": [{"preset": "gyro-bias", "at_s": 1}, {"preset": "gps-jump", "at_s": 1}]}
ANSWER = message_layout("HIL_ACTUATOR_CONTROLS")
HEARTBEAT = message_layout("HEARTBEAT")
SENSOR_ID, WHOLE = 107, 65  # HIL_SENSOR; that of id 0 is shorter, as its last byte is cut


def answer(port: int, steps: int) -> None:
    """Answer so many steps, then close the link."""
    with socket.create_connection(("127.0.0.1", port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.sendall(frame_payload(HEARTBEAT, bytes(9), seq=0, system=1, component=1))
        data, number = b"", 0
        while number < steps and (more := link.recv(65_536)):
            data += more
            while len(data) >= 12 and len(data) >= 12 + data[1]:
                frame, data = data[: 12 + data[1]], data[12 + data[1] :]
                if frame[7] == SENSOR_ID and frame[1] < WHOLE:
                    values = [0.72] * 4 + [0.0] * 12
                    payload = frame[10:18] + struct.pack("<Q16fB", 0, *values, 128)
                    link.sendall(
                        frame_payload(ANSWER, payload, seq=number & 255, system=1, component=1)
                    )
                    number += 1


def fly(path: Path, steps: int, schedule: dict) -> tuple[float, float]:
    """Fly so many steps; return the wall and the processor time of one [us]."""
    flight = ProxiedFlight(read_scenario(path), parse_schedule(schedule))
    passage = new_passage(flight.core, flight.capture)
    simulation, lockstep = flight.simulation, Lockstep(timeout_s=20.0)
    lockstep.locked = True
    hil = HilPacker(simulation.board)
    sender = AutopilotSender(flight, hil, lambda _: None, passage=passage)
    with closing(TcpServer("127.0.0.1", 0)) as server:
        peer = multiprocessing.get_context("fork").Process(target=answer, args=(server.port, steps))
        peer.start()
        deadline = ConnectionDeadline(server, None, 20.0)
        receiver = AutopilotReceiver(sender, [server], deadline, lockstep)
        mix = mav_type_and_mix(simulation)[1]
        progress = Progress(0.0, StringIO())
        loop = LockstepLoop(simulation, sender, receiver, mix, math.inf, progress, lockstep)
        wall_s, spent_s = time.perf_counter(), time.thread_time()
        with suppress(PeerGoneError, ConnectionResetError), real_time_priority():
            loop.run()
        wall_s, spent_s = time.perf_counter() - wall_s, time.thread_time() - spent_s
        peer.join()
    return wall_s / steps * 1e6, spent_s / steps * 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--faults", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "scenario.yaml")
        path.write_text(SCENARIO)
        schedule = FAULTS if args.faults else {}
        fly(path, 1_000, schedule)  # compiles
        tries = [fly(path, args.steps, schedule) for _ in range(5)]
    wall_us, spent_us = (min(column) for column in zip(*tries, strict=True))
    print(f"{wall_us:.0f} us a step, {spent_us:.0f} us of processor time")


if __name__ == "__main__":
    main()
