"""PX4's side of a recorded lockstep flight, played against the simulator over TCP.

The log holds both directions of the HIL link of a real PX4 1.18 with another simulator, quad on the
ground until 13 s. What that PX4 got is compared with what our simulator sends it, step for step.
"""

import io
import math
import socket
import threading
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.tlog import read_frames
from simvehicle.actuators import motors
from simvehicle.hil import Hil
from simvehicle.inbox import Inbox
from simvehicle.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.progress import Progress
from simvehicle.scenario import read_scenario
from simvehicle.simulation import Simulation

LAST_US = 7_000_000  # six seconds: 1500 steps
SCENARIO = """
vehicle: {kind: multirotor, parameters: iris}
start: {lat_deg: 47.397742, lon_deg: 8.545594, alt_m: 488.0}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 50}
  airspeed: {preset: mpxv5004dp, rate_hz: 50}
  gps: {preset: ideal, rate_hz: 5}
"""


@cache
def recorded(path: Path) -> tuple[list[Frame], dict[int, bytes]]:
    """The simulator's frames until LAST_US, and PX4's words: by stamp, its first ones at 0."""
    simulator: list[Frame] = []
    answers: dict[int, bytes] = {0: b""}
    for _, frame in read_frames(path):
        if frame.component == 51:
            simulator.append(frame)
            if frame.layout.name == "HIL_STATE_QUATERNION" and frame.number("time_usec") >= LAST_US:
                break
        elif frame.layout.name == "HIL_ACTUATOR_CONTROLS":
            answers[int(frame.number("time_usec"))] = frame.raw
        else:
            answers[0] += frame.raw
    return simulator, answers


def play(answers: dict[int, bytes], folder: Path) -> list[Frame]:
    """What the simulator sends to a PX4 that answers as recorded, until LAST_US."""
    path = folder / "quad.yaml"
    path.write_text(SCENARIO)
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    progress = Progress(0.0, io.StringIO())
    simulation = Simulation(read_scenario(path), seed=3)
    loop = LockstepLoop(simulation, Hil(), Inbox(link), motors(4), math.inf, progress)
    until_us = LAST_US - 1_000_000
    thread = threading.Thread(target=lambda: serve_autopilot(loop, progress, until_us))
    thread.start()
    got: list[Frame] = []
    parser = Parser()
    with socket.create_connection(("127.0.0.1", link.port), timeout=60) as px4:
        px4.sendall(answers[0])
        while not got or got[-1].layout.name != "HIL_STATE_QUATERNION" or stamp(got[-1]) < LAST_US:
            for frame in parser.push(px4.recv(65536)):
                assert isinstance(frame, Frame)
                got.append(frame)
                if frame.layout.name == "HIL_SENSOR" and stamp(frame) in answers:
                    px4.sendall(answers[stamp(frame)])
    thread.join(20)
    link.close()
    return got


def stamp(frame: Frame) -> int:
    return int(frame.number("time_usec"))


@pytest.fixture(scope="module")
def both(
    shared_data: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[Frame], list[Frame]]:
    """What PX4 got then, from its second step on, and what it gets from us."""
    simulator, answers = recorded(shared_data / "px4_hil" / "hover_gps_jump_hil.tlog")
    first = next(i for i, f in enumerate(simulator) if f.layout.name == "HIL_STATE_QUATERNION")
    return simulator[first + 1 :], play(answers, tmp_path_factory.mktemp("px4"))


def named(frames: list[Frame], name: str) -> list[Frame]:
    return [f for f in frames if f.layout.name == name]


def column(frames: list[Frame], name: str, *fields: str) -> np.ndarray:
    return np.array([[f.number(field) for field in fields] for f in named(frames, name)])


def test_the_messages_come_in_the_same_order(both: tuple[list[Frame], list[Frame]]) -> None:
    then, now = ([f.layout.name for f in frames if f.id != 0] for frames in both)
    assert now == then


def test_heartbeats_come_once_a_second(both: tuple[list[Frame], list[Frame]]) -> None:
    # The recorded simulator's first one fell into the step that ours does not have.
    assert [len(named(frames, "HEARTBEAT")) for frames in both] == [6, 7]


@pytest.mark.parametrize("name", ["HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION"])
def test_the_stamps_are_the_same(both: tuple[list[Frame], list[Frame]], name: str) -> None:
    then, now = ([stamp(f) for f in named(frames, name)] for frames in both)
    assert now == then


def test_the_same_groups_of_fields_are_new_at_each_step(
    both: tuple[list[Frame], list[Frame]],
) -> None:
    then, now = (column(frames, "HIL_SENSOR", "fields_updated", "id") for frames in both)
    assert np.array_equal(now, then)


def test_at_rest_the_sensors_say_the_same_in_the_same_units(
    both: tuple[list[Frame], list[Frame]],
) -> None:
    then, now = both
    accel = ("xacc", "yacc", "zacc")
    for fields, tolerance in (
        (accel, 0.15),  # m/s^2: an accelerometer's bias
        (("xgyro", "ygyro", "zgyro"), 0.01),  # rad/s
        (("xmag", "ymag", "zmag"), 0.02),  # gauss: another year of the field's model
        (("abs_pressure",), 0.5),  # hPa: four metres
        (("diff_pressure",), 0.5),
        (("pressure_alt",), 4.0),
    ):
        means = [column(f, "HIL_SENSOR", *fields)[200:].mean(axis=0) for f in (then, now)]
        assert means[1] == pytest.approx(means[0], abs=tolerance), fields
    noise = [column(f, "HIL_SENSOR", *accel)[200:].std(axis=0) for f in (then, now)]
    assert (noise[1] > 0.2 * noise[0]).all()
    assert (noise[1] < 5.0 * noise[0]).all()


def test_the_position_is_the_same(
    both: tuple[list[Frame], list[Frame]],
) -> None:
    then, now = both
    fields = ("lat", "lon", "alt")
    for name, degrees, alt_mm in (("HIL_GPS", 200, 3_000), ("HIL_STATE_QUATERNION", 20, 300)):
        difference = np.abs(column(now, name, *fields) - column(then, name, *fields))
        assert (difference <= [degrees, degrees, alt_mm]).all(), name


def test_px4_may_use_the_fix(both: tuple[list[Frame], list[Frame]]) -> None:
    for frames in both:
        gps = column(frames, "HIL_GPS", "fix_type", "satellites_visible", "eph", "epv")
        assert (gps[:, 0] >= 3).all()
        assert (gps[:, 1] >= 6).all()
        assert (gps[:, 2] <= 300).all()  # cm
        assert (gps[:, 3] <= 500).all()


def test_no_sample_of_the_inertial_unit_repeats(both: tuple[list[Frame], list[Frame]]) -> None:
    rates = column(both[1], "HIL_SENSOR", "xacc", "xgyro")
    assert (np.diff(rates, axis=0) != 0).any(axis=1).all()
