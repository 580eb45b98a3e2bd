"""The lockstep loop over real TCP on loopback, with stand-ins for vehicle and autopilot."""

import io
import math
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.wire.plant_messages import PlantChange, plant_frame
from simvehicle.app.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.sensors.flight_record import FLIGHT, SENSOR, Board
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.actuators import motor_mix
from simvehicle.vehicles.body import Controls, Truth


class Lift:
    """A vehicle that moves vertically only: 1.5 kg with four motors of 7.5 N each."""

    def __init__(self) -> None:
        self.t_us = -4000
        # One IMU
        self.board = Board(np.zeros(1, dtype=FLIGHT), np.zeros(1, dtype=SENSOR))
        self.height_m = self.climb_mps = 0.0
        self.controls: list[Controls] = []
        self.changes: list[tuple[str, float | None]] = []

    def prepare(self) -> None:
        """Nothing to prepare."""

    def step(self, controls: Controls) -> tuple[int, Truth, Sequence[Reading]]:
        self.t_us += 4000
        self.controls.append(controls)
        thrust = 7.5 * float(controls.values.sum()) / 1.5
        self.climb_mps += (thrust - 9.81) * 0.004
        self.height_m += self.climb_mps * 0.004
        grounded = self.height_m <= 0.0
        if grounded:
            self.height_m = self.climb_mps = 0.0
        force = np.array([0.0, 0.0, -9.81 if grounded else -thrust])
        truth = Truth(
            self.t_us, 0.8, 0.1, self.height_m, self.height_m, self.height_m,
            np.array([0.0, 0.0, -self.height_m]), np.array([0.0, 0.0, -self.climb_mps]),
            np.array([1.0, 0, 0, 0]), np.zeros(3), force, np.zeros(3), np.zeros(3),
            101325.0, 288.0, 1.225, 16.0, 1.0, 1.0,
        )  # fmt: skip
        self._put_truth(truth)
        return self.t_us, truth, []

    def _put_truth(self, truth: Truth) -> None:
        flight, imu = self.board.flight[0], self.board.sensors[0]
        flight["t_us"], flight["load"][:3] = truth.t_us, truth.specific_force_b_mps2
        flight["here"][:3] = truth.lat_rad, truth.lon_rad, truth.height_m
        flight["here"][6:13] = *truth.v_ned_mps, *truth.q_nb
        imu["values"][:3], imu["fresh"] = truth.specific_force_b_mps2, 1

    def plant(self, name: str, value: float | None) -> None:
        self.changes.append((name, value))


class Autopilot:
    """The remote end of the link: reads HIL frames and answers if enabled."""

    def __init__(self, port: int) -> None:
        self.sock = socket.create_connection(("127.0.0.1", port), timeout=20)
        self.mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.reader = dialect.MAVLink(None)
        self.send(self.mav.command_long_encode(0, 0, 511, 0, 115.0, 5000.0, 0, 0, 0, 0, 0))

    def send(self, message: dialect.MAVLink_message) -> None:
        self.sock.sendall(message.pack(self.mav))

    def messages(self) -> Iterator[dialect.MAVLink_message]:
        while data := self.sock.recv(65536):
            yield from self.reader.parse_buffer(data) or []

    def answer(self, t_us: int, motor: float) -> None:
        self.send(self.mav.hil_actuator_controls_encode(t_us, [motor] * 4 + [0] * 12, 129, 1))

    def close(self) -> None:
        self.sock.close()


@contextmanager
def served(
    vehicle: Lift, until_us: int | None, timeout_s: float = 20.0
) -> Iterator[tuple[Autopilot, list[int], io.StringIO, LockstepLoop]]:
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    said, codes = io.StringIO(), list[int]()
    progress = Progress(0.0, said)
    loop = LockstepLoop(
        vehicle, HilPacker(vehicle.board), Inbox(link), motor_mix(4), math.inf, progress
    )
    loop.lockstep = Lockstep(timeout_s, silence_s=20.0 * timeout_s)

    def serve() -> None:
        codes.append(serve_autopilot(loop, progress, until_us))
        link.close()

    thread = threading.Thread(target=serve)
    thread.start()
    autopilot = Autopilot(link.port)
    try:
        yield autopilot, codes, said, loop
    finally:
        autopilot.close()
        thread.join(20)


def test_an_autopilot_that_holds_its_height_hovers_in_lockstep() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=10_000_000) as (autopilot, codes, _, _):
        speed = 0.0
        height = 0.0
        for message in autopilot.messages():
            if message.get_type() == "HIL_STATE_QUATERNION":
                height, speed = message.alt * 1e-3, -message.vz * 1e-2
            elif message.get_type() == "HIL_SENSOR":
                thrust = 0.4905 + 0.1 * (5.0 - height) - 0.15 * speed
                autopilot.answer(message.time_usec, min(max(thrust, 0.0), 1.0))
                if message.time_usec >= 11_000_000:
                    break
    assert codes == [0]
    assert abs(vehicle.height_m - 5.0) < 0.1
    assert vehicle.t_us == 10_000_000


def test_each_step_is_taken_on_the_answer_to_the_step_before() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=2_000_000) as (autopilot, codes, _, _):
        answered: list[int] = []
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                # The motor command has the number of the step.
                answered.append(message.time_usec)
                autopilot.answer(message.time_usec, (len(answered) % 100) / 100)
                if message.time_usec >= 3_000_000:
                    break
    assert codes == [0]
    assert np.diff(answered).tolist() == [4000] * (len(answered) - 1)
    sent = [round(float(c.values[0]) * 100) for c in vehicle.controls]
    first = next(i for i, value in enumerate(sent) if value)
    after = sent[first + 30 :]  # a few steps are still on the way after the free-running start
    assert {(b - a) % 100 for a, b in pairwise(after)} == {1}


def test_before_the_first_answer_steps_run_in_real_time_without_waiting() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=None) as (autopilot, _, _, loop):
        seen = 0
        for message in autopilot.messages():
            seen += message.get_type() == "HIL_SENSOR"
            if seen == 25:
                break
        assert not loop.lockstep.answered
    assert not any(controls.armed or controls.values.any() for controls in vehicle.controls)


def test_a_missing_answer_is_reported_and_skipped() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=None, timeout_s=0.5) as (autopilot, _, said, _):
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                if message.time_usec != 1_200_000:
                    autopilot.answer(message.time_usec, 0.0)
                if said.getvalue().count("in lockstep from") == 2:
                    break
    lines = said.getvalue().splitlines()
    missed = lines.index(
        "no answer to the step at 1.200 s; continuing in real time with the last commands"
    )
    assert lines[missed + 1].startswith("in lockstep from ")


def test_a_period_without_answers_costs_one_timeout() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=800_000, timeout_s=1.0) as (autopilot, codes, said, _):
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                if not 1_200_000 <= message.time_usec < 1_400_000:
                    autopilot.answer(message.time_usec, 0.0)
                if message.time_usec >= 1_800_000:
                    break
    assert codes == [0]
    assert said.getvalue().count("no answer to the step") == 1


def test_an_autopilot_that_falls_silent_ends_the_flight_with_a_reason() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=None, timeout_s=0.02) as (autopilot, codes, said, _):
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                autopilot.answer(message.time_usec, 0.0)
                break
        for _ in autopilot.messages():  # until the simulator closes the link
            pass
    assert codes == [1]
    assert "the autopilot has not answered for 0.4 s after" in said.getvalue()


def test_a_lost_autopilot_is_reported() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=10_000_000_000) as (autopilot, codes, said, _):
        next(autopilot.messages())
    assert codes == [1]
    assert "the autopilot closed the link after" in said.getvalue()


@pytest.mark.parametrize(("motor_mode", "code"), [(1, 0), (129, 1)])
def test_a_link_that_closes_in_flight_is_a_failure_with_advice(motor_mode, code) -> None:
    with served(Lift(), until_us=None) as (autopilot, codes, said, _):
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                channels = [0.0] * 16
                autopilot.send(
                    autopilot.mav.hil_actuator_controls_encode(
                        message.time_usec, channels, motor_mode, 1
                    )
                )
                if message.time_usec > 1_100_000:
                    break
    assert codes == [code]
    assert ("with the motors on" in said.getvalue()) == bool(code)
    assert "restart simulator, proxy and autopilot together" in said.getvalue()


def test_an_autopilot_that_ran_before_must_be_restarted() -> None:
    with served(Lift(), until_us=None) as (autopilot, _, said, _):
        for message in autopilot.messages():
            if message.get_type() == "HIL_SENSOR":
                autopilot.answer(message.time_usec, 0.5)  # armed
                if message.time_usec > 1_100_000:
                    break
    assert said.getvalue().count("the motors are already armed; if the autopilot ran before") == 1


def test_a_missing_first_answer_is_reported_once(monkeypatch) -> None:
    monkeypatch.setattr("simvehicle.app.lockstep_loop.FIRST_ANSWER_TIMEOUT_S", 0.05)
    with served(Lift(), until_us=200_000) as (autopilot, _, said, _):
        for _ in autopilot.messages():
            pass
    assert said.getvalue().count("no answer for 0.05 s; if the autopilot ran before") == 1


def test_a_plant_fault_reaches_the_vehicle() -> None:
    vehicle = Lift()
    with served(vehicle, until_us=None) as (autopilot, _, _, _):
        autopilot.sock.sendall(plant_frame(PlantChange("motor_efficiency[0]", 0.5)))
        autopilot.sock.sendall(plant_frame(PlantChange("motor_efficiency[0]", None)))
        for message in autopilot.messages():
            if len(vehicle.changes) == 2 and message.get_type() == "HIL_SENSOR":
                break
    assert vehicle.changes == [("motor_efficiency[0]", 0.5), ("motor_efficiency[0]", None)]
