"""Stretches through sockets and the proxy: bytes and labels of the loop in Python."""

import math
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import StringIO
from pathlib import Path

import pytest

from analysis.autopilots.hil_exchange import AutopilotReceiver, AutopilotSender, ConnectionDeadline
from analysis.autopilots.stretches import open_stretches
from analysis.run.proxied_flight import ProxiedFlight
from mavproxy_fault.compiled.passage import new_passage
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, frame_payload
from mavproxy_fault.wire.parser import Parser
from simvehicle.app.lockstep_loop import LockstepLoop
from simvehicle.app.sim_progress import Progress
from simvehicle.app.sim_server import mav_type_and_mix
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.vehicles.actuators import ARMED_FLAG, CHANNEL_COUNT

ANSWER = message_layout("HIL_ACTUATOR_CONTROLS")
SENSORS = """
  imu: [{preset: consumer-mems, rate_hz: 250}, {preset: consumer-mems, rate_hz: 250, id: 1}]
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
"""
VEHICLES = {
    "quad": "vehicle: {kind: multirotor, parameters: iris}\nenvironment: {gusts: light}",
    "plane": "vehicle: {kind: fixedwing, parameters: aerosonde-2025}\nstart: {height_m: 200}",
}
RECEIVERS = {
    "gps": "  gps: {preset: consumer, rate_hz: 5}\n",
    "gnss": "gnss: {rate_hz: 2}\n",
}
# Some act on the frames of stretches, some on others; one on the answers.
FAULTS = [
    {"preset": "gyro-bias", "at_s": 0.3, "for_s": 0.5},
    {"preset": "accel-stuck", "at_s": 0.9, "for_s": 0.3},
    {"preset": "gyro-noise", "at_s": 1.3, "for_s": 0.3},
    {"preset": "gps-jump", "at_s": 0.5, "for_s": 1},
    {"fault": "scale", "target": "HIL_ACTUATOR_CONTROLS.controls[2]", "value": 0.5, "at_s": 1.7},
    {"fault": "drop", "target": "HIL_SENSOR", "probability": 0.02, "at_s": 2.0, "for_s": 0.2},
    {"fault": "delay", "target": "HIL_GPS", "value": 0.15, "at_s": 2.3, "for_s": 0.5},
]
STEPS = 750


def answer(stamp_us: int, number: int, kind: str) -> bytes:
    """Return the commands in the stand-in's n-th answer."""
    wave = [0.02 * math.sin(0.05 * number + n) for n in range(CHANNEL_COUNT)]
    values = [0.7 + value for value in wave] if kind == "quad" else [5.0 * value for value in wave]
    payload = struct.pack("<QQ16fB", stamp_us, 0, *values, ARMED_FLAG if number > 50 else 0)
    return frame_payload(ANSWER, payload, seq=number & 0xFF, system=1, component=1)


@contextmanager
def autopilot(port: int, kind: str) -> Iterator[None]:
    """Answers a number of HIL_SENSOR of id 0, then closes the link."""

    def work() -> None:
        parser, number = Parser(), 0
        with socket.create_connection(("127.0.0.1", port)) as link:
            link.sendall(
                frame_payload(message_layout("HEARTBEAT"), bytes(9), seq=0, system=1, component=1)
            )
            while number < STEPS and (data := link.recv(65_536)):
                for frame in parser.push(data):
                    if isinstance(frame, Frame) and frame.id == 107 and frame.number("id") == 0:
                        link.sendall(answer(int(frame.number("time_usec")), number, kind))
                        number += 1

    thread = threading.Thread(target=work)
    thread.start()
    yield
    thread.join()


def flown(
    scenario: Path, kind: str, faults: list, *, stretched: bool
) -> tuple[ProxiedFlight, list[int]]:
    """Fly with the stand-in; return the flight and the steps of each stretch."""
    entries = [{"id": str(n), **fault} for n, fault in enumerate(faults)]
    flight = ProxiedFlight(read_scenario(scenario), parse_schedule({"faults": entries}))
    passage = new_passage(flight.core, flight.capture)
    hil, lockstep = HilPacker(flight.simulation.board), Lockstep(timeout_s=60.0, silence_s=300.0)
    lockstep.locked = True  # from the first step on, independent of the clock
    outward = AutopilotSender(flight, hil, lambda _: None, passage=passage)
    stretches: list[int] = []
    with closing(TcpServer("127.0.0.1", 0)) as server, autopilot(server.port, kind):
        inward = AutopilotReceiver(
            outward, [server], ConnectionDeadline(server, None, 300.0), lockstep
        )
        steps = open_stretches(flight.simulation, hil, passage) if stretched else None
        if steps is not None:
            assert steps.join(outward, inward, lockstep)
            account = steps._account

            def counted() -> None:
                stretches.append(int(steps._now["steps"]))
                account()

            steps._account = counted  # type: ignore[method-assign]
        mix = mav_type_and_mix(flight.simulation)[1]
        progress = Progress(0.0, StringIO())
        loop = LockstepLoop(
            flight.simulation, outward, inward, mix, math.inf, progress, lockstep, steps
        )
        with pytest.raises(Exception, match="closed the link"):
            loop.run()
        outward.deliver_all()
    flight.core.finish(flight.now_us)
    if passage is not None:
        passage.count()
    return flight, stretches


@pytest.mark.parametrize(
    ("kind", "receiver", "faults"),
    [
        ("quad", "gps", []),
        ("quad", "gps", FAULTS),
        ("quad", "gnss", FAULTS[:3]),
        ("plane", "gps", FAULTS[:6]),
        ("plane", "gnss", []),
    ],
)
def test_stretches_send_the_same_bytes_as_the_loop(
    kind: str, receiver: str, faults: list, tmp_path: Path
) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(f"name: stretches\n{VEHICLES[kind]}\nsensors:{SENSORS}{RECEIVERS[receiver]}")
    ordinary, _ = flown(path, kind, faults, stretched=False)
    fast, stretches = flown(path, kind, faults, stretched=True)
    assert sum(stretches) > (0.4 if faults else 0.9) * STEPS
    for log in ("received", "sent", "index", "received_other", "sent_other"):
        assert getattr(fast.capture, log) == getattr(ordinary.capture, log), log
    assert fast.drain_labels() == ordinary.drain_labels()
    assert fast.stats() == ordinary.stats()
    assert fast.simulation.truth.t_us == ordinary.simulation.truth.t_us
