"""PX4's side of a recorded lockstep flight, replayed against the simulator, all 70 s of it.

The log holds both directions of the HIL link of a real PX4 1.18 with another simulator: on the
ground until 17 s, then take-off and hover. What that PX4 got is compared with what our simulator
sends it: messages, their order, stamps and groups of new fields at every step of the complete log,
values until the recorded vehicle leaves the ground. From then on the recorded commands answer the
motion of another vehicle, which is lighter for its motors than ours: ours goes on standing.
The first six seconds are played over TCP, all of it without a link, and both are the same bytes.
"""

import io
import math
import socket
import struct
import threading
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.app.lockstep_loop import LockstepLoop, serve_autopilot
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import motor_mix, read_controls
from simvehicle.vehicles.body import Controls
from simvehicle.vehicles.multirotor.multirotor import Multirotor

LIFT_OFF_US = 17_000_000  # the recorded vehicle is on the ground until then
LINK_US = 7_000_000  # timestamp up to which it is replayed over TCP
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
SIMULATOR, HEAD, CRC = 51, 10, 2
IDS = {name: message_layout(name).id for name in ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")}
ACTUATORS = message_layout("HIL_ACTUATOR_CONTROLS")


def split(data: bytes, gap: int) -> tuple[list[bytes], bytes]:
    """The complete MAVLink 2 frames in `data`, each after `gap` other bytes, and what is left."""
    frames, at = [], 0
    while at + gap + HEAD <= len(data):
        end = at + gap + HEAD + data[at + gap + 1] + CRC
        if end > len(data):
            break
        frames.append(data[at + gap : end])
        at = end
    return frames, data[at:]


def number(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


def stamp(frame: bytes) -> int:
    """The `time_usec` at the start of HIL messages."""
    return int(struct.unpack_from("<Q", frame, HEAD)[0])


@cache
def recorded(path: Path) -> tuple[list[bytes], dict[int, bytes]]:
    """The simulator's frames, and PX4's messages by timestamp, the first ones at 0."""
    frames, _ = split(path.read_bytes(), gap=8)  # a tlog: a stamp before each frame
    answers: dict[int, bytes] = {0: b""}
    for frame in frames:
        if frame[6] != SIMULATOR:
            at = stamp(frame) if number(frame) == ACTUATORS.id else 0
            answers[at] = answers.get(at, b"") + frame
    return [frame for frame in frames if frame[6] == SIMULATOR], answers


def vehicle(folder: Path) -> Simulation:
    """A quad on the ground at the recorded position."""
    path = folder / "quad.yaml"
    path.write_text(SCENARIO)
    return Simulation(read_scenario(path), seed=3)


def play(answers: dict[int, bytes], folder: Path) -> list[bytes]:
    """The simulator's frames for a PX4 that answers as recorded, to the end of the log."""
    simulation, mix = vehicle(folder), motor_mix(4)
    hil = HilPacker(simulation.board)
    controls = Controls(mix([0.0] * 16), armed=False)
    got: list[bytes] = []
    last_us = max(answers)
    while simulation.truth.t_us + hil.start_us < last_us:
        t_us, _, readings = simulation.step(controls)
        got += hil.frames(readings)
        answer = answers.get(t_us + hil.start_us)
        if answer:  # the recorded PX4 left one step unanswered
            _, controls = read_controls(Frame(answer, ACTUATORS), mix)
    return got


def play_over_tcp(answers: dict[int, bytes], folder: Path) -> list[bytes]:
    """The same over a link, until LINK_US."""
    link = open_link("tcpin:127.0.0.1:0")
    assert isinstance(link, TcpServer)
    progress = Progress(0.0, io.StringIO())
    simulation = vehicle(folder)
    hil = HilPacker(simulation.board)
    loop = LockstepLoop(simulation, hil, Inbox(link), motor_mix(4), math.inf, progress)
    loop.lockstep = Lockstep(timeout_s=60.0, silence_s=60.0)  # no timeout on a busy machine
    thread = threading.Thread(target=lambda: serve_autopilot(loop, progress, LINK_US - 1_000_000))
    thread.start()
    got: list[bytes] = []
    rest = b""
    with socket.create_connection(("127.0.0.1", link.port), timeout=60) as px4:
        px4.sendall(answers[0])
        while not got or number(got[-1]) != IDS["HIL_STATE_QUATERNION"] or stamp(got[-1]) < LINK_US:
            frames, rest = split(rest + px4.recv(65536), gap=0)
            got += frames
            for frame in frames:
                if number(frame) == IDS["HIL_SENSOR"] and stamp(frame) in answers:
                    px4.sendall(answers[stamp(frame)])
    thread.join(20)
    link.close()
    return got


@pytest.fixture(scope="module")
def log(shared_data: Path) -> tuple[list[bytes], dict[int, bytes]]:
    """The recorded simulator's frames and PX4's answers."""
    return recorded(shared_data / "px4_hil" / "hover_gps_jump_hil.tlog")


@pytest.fixture(scope="module")
def both(
    log: tuple[list[bytes], dict[int, bytes]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[bytes], list[bytes]]:
    """What PX4 received in the recording, from its second step on, and what it receives from us."""
    simulator, answers = log
    first = next(i for i, f in enumerate(simulator) if number(f) == IDS["HIL_STATE_QUATERNION"])
    return simulator[first + 1 :], play(answers, tmp_path_factory.mktemp("px4"))


def rows(frames: list[bytes], name: str, until_us: float = math.inf) -> np.ndarray:
    """The messages of a kind as a structured array."""
    layout = message_layout(name)
    fields = layout.fields.values()
    kind = np.dtype(
        {
            "names": [f.name for f in fields],
            "formats": [(f"<{f.code}", f.count) if f.count else f"<{f.code}" for f in fields],
            "offsets": [f.offset for f in fields],
            "itemsize": layout.length,
        }
    )
    payloads = [f[HEAD:-CRC].ljust(layout.length, b"\0") for f in frames if number(f) == layout.id]
    found = np.frombuffer(b"".join(payloads), kind)
    return found[found["time_usec"] < until_us]


def column(frames: list[bytes], name: str, *fields: str) -> np.ndarray:
    """Fields of the messages of a kind until the recorded lift-off, a column each."""
    found = rows(frames, name, LIFT_OFF_US)
    return np.stack([found[field].astype(float) for field in fields], axis=-1)


def test_every_step_of_the_log_is_flown(both: tuple[list[bytes], list[bytes]]) -> None:
    stamps = rows(both[1], "HIL_SENSOR")["time_usec"]
    assert (stamps[0], stamps[-1], len(stamps)) == (1_004_000, 71_000_000, 17_500)


def test_the_messages_come_in_the_same_order(both: tuple[list[bytes], list[bytes]]) -> None:
    names = {number: name for name, number in IDS.items()}
    then, now = ([names[number(f)] for f in frames if number(f) in names] for frames in both)
    assert now == then


def test_heartbeats_come_once_a_second(both: tuple[list[bytes], list[bytes]]) -> None:
    # The recorded simulator's first one belongs to a step that ours does not have.
    assert [sum(number(f) == 0 for f in frames) for frames in both] == [70, 71]


@pytest.mark.parametrize("name", list(IDS))
def test_the_stamps_are_the_same(both: tuple[list[bytes], list[bytes]], name: str) -> None:
    then, now = (rows(frames, name)["time_usec"] for frames in both)
    assert np.array_equal(now, then)


def test_the_same_groups_of_fields_are_new_at_each_step(
    both: tuple[list[bytes], list[bytes]],
) -> None:
    then, now = (rows(frames, "HIL_SENSOR")[["fields_updated", "id"]] for frames in both)
    assert np.array_equal(now, then)


def test_at_rest_the_sensors_agree_in_units_and_values(
    both: tuple[list[bytes], list[bytes]],
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
    both: tuple[list[bytes], list[bytes]],
) -> None:
    then, now = both
    fields = ("lat", "lon", "alt")
    for name, degrees, alt_mm in (("HIL_GPS", 200, 3_000), ("HIL_STATE_QUATERNION", 20, 300)):
        difference = np.abs(column(now, name, *fields) - column(then, name, *fields))
        assert (difference <= [degrees, degrees, alt_mm]).all(), name


def test_from_take_off_the_commands_differ_as_the_vehicle_does(
    log: tuple[list[bytes], dict[int, bytes]], both: tuple[list[bytes], list[bytes]]
) -> None:
    answers = [a for at, a in log[1].items() if at > 30_000_000]
    recorded_hover = rows(answers, "HIL_ACTUATOR_CONTROLS")["controls"][:, :4].mean()
    iris = Multirotor.read("iris")
    cruise = iris.cruise(np.zeros(3), 0.0, np.zeros(3), 5.0, 1.17, 9.81)
    motor = iris.parameters.motor
    own_hover = (cruise[13] - motor.idle_rps) / (motor.full_rps - motor.idle_rps)
    assert recorded_hover == pytest.approx(0.5, abs=0.02)
    assert own_hover > 0.7
    for frames, climbed_m in zip(both, (2.5, 0.0), strict=True):
        gps = rows(frames, "HIL_GPS")
        height_m = (gps["alt"] - gps["alt"][0].astype(float)) * 1e-3
        assert np.abs(height_m[gps["time_usec"] < LIFT_OFF_US]).max() < 0.05
        assert height_m[-1] == pytest.approx(climbed_m, abs=0.1)


def test_over_tcp_px4_gets_the_same_bytes(
    log: tuple[list[bytes], dict[int, bytes]],
    both: tuple[list[bytes], list[bytes]],
    tmp_path: Path,
) -> None:
    linked = play_over_tcp(log[1], tmp_path)
    assert linked == both[1][: len(linked)]
    assert stamp(linked[-1]) == LINK_US


def test_px4_may_use_the_fix(both: tuple[list[bytes], list[bytes]]) -> None:
    for frames in both:
        gps = rows(frames, "HIL_GPS")
        assert (gps["fix_type"] >= 3).all()
        assert (gps["satellites_visible"] >= 6).all()
        assert (gps["eph"] <= 300).all()  # cm
        assert (gps["epv"] <= 500).all()


def test_no_imu_sample_repeats(both: tuple[list[bytes], list[bytes]]) -> None:
    sensor = rows(both[1], "HIL_SENSOR")
    rates = np.stack([sensor["xacc"], sensor["xgyro"]], axis=-1)
    assert (np.diff(rates, axis=0) != 0).any(axis=1).all()
