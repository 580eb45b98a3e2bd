"""Faults between the simulator and an autopilot act in vehicle time."""

import math
import select
import socket
import threading
from contextlib import closing, contextmanager
from io import StringIO

import pytest

from analysis.autopilots.hil_exchange import (
    BRIDGE_STEP,
    PX4_STEP,
    AutopilotReceiver,
    AutopilotSender,
    ConnectionDeadline,
)
from analysis.run.proxied_flight import VEHICLE, ProxiedFlight
from mavproxy_fault.compiled.passage import new_passage
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.links.udp import UdpServer
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.plant_messages import PlantChange, plant_change
from simvehicle.app import lockstep_loop
from simvehicle.app.lockstep_loop import LockstepLoop
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.hil_frames import START_US, HilPacker
from simvehicle.hil.lockstep import Lockstep
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.sensors.readings import BatteryReading
from simvehicle.vehicles.actuators import motor_mix

SCENARIO = """
name: on the ground
vehicle: {kind: multirotor, parameters: iris}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  gps: {preset: consumer, rate_hz: 5}
"""


@pytest.fixture
def scenario(tmp_path):
    file = tmp_path / "scenario.yaml"
    file.write_text(SCENARIO)
    return read_scenario(str(file))


@pytest.fixture
def flight_of(scenario):
    def make(**fault) -> ProxiedFlight:
        return ProxiedFlight(
            scenario, parse_schedule({"faults": [{"id": "f", "at_s": 0, **fault}]})
        )

    return make


def sender_of(flight, step=PX4_STEP):
    return AutopilotSender(
        flight, HilPacker(flight.simulation.board), listener=lambda sends: None, step=step
    )


def fly(exchange, steps):
    """Return the frames for the autopilot, each with the simulated time of its step."""
    parser, found = Parser(), []
    for _ in range(steps):
        t_us, _, readings = exchange.flight.simulation.step(None)
        for raw in exchange.frames(readings):
            found += [(t_us, item) for item in parser.push(raw) if isinstance(item, Frame)]
    return found


def test_a_delay_is_in_vehicle_time(flight_of):
    flight = flight_of(fault="delay", target="HIL_GPS", value=0.5, for_s=10)
    late_us = [
        t_us + START_US - frame.number("time_usec")
        for t_us, frame in fly(sender_of(flight), 400)
        if frame.layout.name == "HIL_GPS" and frame.number("time_usec") > START_US + 200_000
    ]
    assert len(late_us) >= 3
    assert late_us == pytest.approx([500_000] * len(late_us), abs=4_000)  # of a step


FAULTS = [
    {"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.1, "at_s": 0.1, "for_s": 0.3},
    {"fault": "noise", "target": "HIL_SENSOR.zacc", "value": 0.1, "at_s": 0.3, "for_s": 0.2},
    {"fault": "delay", "target": "HIL_GPS", "value": 0.1, "at_s": 0.2, "for_s": 0.5},
    {"fault": "drop", "target": "HIL_SENSOR", "at_s": 0.6, "for_s": 0.1},
    {"fault": "freeze", "target": "HIL_ACTUATOR_CONTROLS.controls[0]", "at_s": 0.4, "for_s": 0.2},
]


def run_exchange(scenario, compiled):
    """Return the frames sent to an autopilot that answers all steps, its commands, and logs."""
    faults = [{"id": f"f{n}", **fault} for n, fault in enumerate(FAULTS)]
    flight = ProxiedFlight(scenario, parse_schedule({"seed": 5, "faults": faults}))
    passage = new_passage(flight.core, flight.capture) if compiled else None
    sender, lockstep = (
        AutopilotSender(
            flight, HilPacker(flight.simulation.board), lambda sends: None, passage=passage
        ),
        Lockstep(),
    )
    left, steps, commanded = [], [], []
    with closing(TcpServer("127.0.0.1", 0)) as link, connected(link) as autopilot:
        receiver = AutopilotReceiver(sender, [link], ConnectionDeadline(link, None, 5.0), lockstep)
        for step in range(250):
            left.append(b"".join(sender.frames(flight.simulation.step(None)[2])))
            steps.append(sender.step_us)
            values = {"time_usec": START_US + 4_000 * (step + 1), "controls": [step] * 16}
            raw = build_frame(message_layout("HIL_ACTUATOR_CONTROLS"), values, seq=step & 0xFF)
            for part in (raw[:20], raw[20:]) if step % 7 == 3 else (raw,):
                autopilot.sendall(part)
                select.select(link.filenos(), [], [], 5.0)
                commanded += [frame.raw for frame in receiver.frames()]
    if passage is not None:
        passage.count()
    core = flight.core
    return left, steps, commanded, flight.capture, core.drain_labels(), core.states, core.senders


def test_compiled_code_and_the_core_pass_the_same_bytes(scenario):
    assert run_exchange(scenario, True) == run_exchange(scenario, False)


def test_steps_continue_while_their_sensor_frames_are_withheld(flight_of):
    flight = flight_of(fault="delay", target="HIL_SENSOR", value=0.1, for_s=10)
    frames = fly(sender_of(flight), 100)
    truths = [t_us for t_us, frame in frames if frame.layout.name == "HIL_STATE_QUATERNION"]
    assert len(truths) == 100
    sensors = [
        t_us + START_US - frame.number("time_usec")
        for t_us, frame in frames
        if frame.layout.name == "HIL_SENSOR"
    ]
    assert sensors[-1] == pytest.approx(100_000, abs=4_000)


def test_a_plant_fault_reaches_the_simulated_vehicle(flight_of):
    flight = flight_of(fault="plant", target="PLANT.motor_efficiency[0]", value=0.25, for_s=10)
    exchange = sender_of(flight)
    fly(exchange, 50)
    changes = [plant_change(frame) for frame in exchange.returned]
    assert PlantChange("motor_efficiency[0]", 0.25) in changes


@pytest.mark.parametrize(("step", "answered"), [(PX4_STEP, 0), (BRIDGE_STEP, 100)])
def test_an_answer_is_awaited_only_for_a_step_that_reached_the_autopilot(flight_of, step, answered):
    exchange = sender_of(flight_of(fault="drop", target="HIL_SENSOR", for_s=10), step)
    awaited = []
    for _ in range(100):
        fly(exchange, 1)
        awaited.append(exchange.step_us)
    assert len([stamp for stamp in awaited if stamp is not None]) == answered


def test_a_delayed_step_is_answered_with_the_timestamp_that_reached_the_autopilot(flight_of):
    exchange = sender_of(flight_of(fault="delay", target="HIL_SENSOR", value=0.1, for_s=10))
    fly(exchange, 100)
    assert exchange.step_us == pytest.approx(START_US + 300_000, abs=4_000)  # now at 400 ms


def test_a_delayed_answer_releases_the_step_and_acts_later(flight_of):
    flight = flight_of(fault="delay", target="HIL_ACTUATOR_CONTROLS", value=0.1, for_s=10)
    sender, lockstep = sender_of(flight), Lockstep()
    with closing(TcpServer("127.0.0.1", 0)) as link, connected(link) as autopilot:
        receiver = AutopilotReceiver(sender, [link], ConnectionDeadline(link, None, 5.0), lockstep)
        acted = []
        for _ in range(100):
            fly(sender, 1)
            lockstep.sent(sender.step_us, 0.0)
            autopilot.sendall(answer(sender.step_us))
            select.select(link.filenos(), [], [], 5.0)
            found = [f for f in receiver.frames() if f.layout.name == "HIL_ACTUATOR_CONTROLS"]
            acted.append([int(frame.number("time_usec")) for frame in found])
            assert lockstep.wait_s(0.0) == 0.0
    assert acted[0] == []
    assert acted[-1] == [pytest.approx(sender.step_us - 100_000, abs=4_000)]


def test_the_first_frame_of_an_autopilot_begins_the_flight_on_any_link(flight_of, monkeypatch):
    # Only a frame can begin the flight.
    monkeypatch.setattr(lockstep_loop, "FIRST_MESSAGE_TIMEOUT_S", math.inf)
    sender, lockstep = sender_of(flight_of(fault="drop", target="HIL_GPS", for_s=1)), Lockstep()
    with closing(TcpServer("127.0.0.1", 0)) as link:
        receiver = AutopilotReceiver(sender, [link], ConnectionDeadline(link, None, 5.0), lockstep)
        simulation, progress = sender.flight.simulation, Progress(0.0, StringIO())
        loop = LockstepLoop(
            simulation, sender, receiver, motor_mix(4), float("inf"), progress, lockstep
        )
        flying = threading.Thread(target=loop.run, args=[4_000])
        flying.start()
        with socket.create_connection(("127.0.0.1", link.port), timeout=5) as autopilot:
            # PX4's first frame, which the proxy does not forward to the simulator.
            autopilot.sendall(build_frame(message_layout("HEARTBEAT"), {"mavlink_version": 3}))
            flying.join(20)
    assert loop.t_us == 4_000


def test_only_links_with_data_are_read(flight_of):
    sender = sender_of(flight_of(fault="drop", target="HIL_GPS", for_s=1))
    with closing(TcpServer("127.0.0.1", 0)) as link, connected(link) as autopilot:
        idle = IdleLink()
        receiver = AutopilotReceiver(
            sender, [link, idle], ConnectionDeadline(link, None, 5.0), Lockstep()
        )
        autopilot.sendall(answer(START_US))
        assert [frame.layout.name for frame in receiver.frames(5.0)] == ["HIL_ACTUATOR_CONTROLS"]
        idle.close()


def test_an_answer_is_read_before_telemetry(flight_of):
    delivered = []
    flight = flight_of(fault="drop", target="HIL_GPS", for_s=1)
    sender = AutopilotSender(
        flight,
        HilPacker(flight.simulation.board),
        delivered.extend,
        passage=new_passage(flight.core, flight.capture),
    )
    with (
        closing(TcpServer("127.0.0.1", 0)) as link,
        closing(UdpServer("127.0.0.1", 0)) as telemetry,
        connected(link) as autopilot,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        receiver = AutopilotReceiver(
            sender, [link, telemetry], ConnectionDeadline(link, None, 5.0), Lockstep()
        )
        other.sendto(
            build_frame(message_layout("ATTITUDE"), {"time_boot_ms": 5}),
            ("127.0.0.1", telemetry.port),
        )
        autopilot.sendall(answer(START_US))
        for one in (link, telemetry):
            assert select.select(one.filenos(), [], [], 5.0)[0]
        assert [frame.layout.name for frame in receiver.frames(5.0)] == ["HIL_ACTUATOR_CONTROLS"]
        attitude = message_layout("ATTITUDE").id
        assert attitude not in [send.data[7] for send in sender.undelivered]
        assert receiver.frames(5.0) == []
        sender.deliver_all()
    assert attitude in [send.data[7] for send in delivered]


class NotingLink:
    """A telemetry link that keeps what is written."""

    def __init__(self):
        self.written = b""

    def write(self, data):
        self.written += data


def test_a_battery_reaches_the_autopilot_by_its_telemetry(flight_of):
    flight, telemetry = flight_of(fault="drop", target="HIL_GPS", for_s=1), NotingLink()
    sender = AutopilotSender(
        flight, HilPacker(flight.simulation.board), lambda sends: None, telemetry=telemetry
    )
    out = Parser().push(b"".join(sender.frames([BatteryReading(0, 15.8, 12.0, 0.9)])))
    names = {frame.layout.name for frame in out}
    assert "HIL_STATE_QUATERNION" in names
    assert "BATTERY_STATUS" not in names
    assert [frame.layout.name for frame in Parser().push(telemetry.written)] == ["BATTERY_STATUS"]


def test_the_operator_runs_once_per_step_while_the_autopilot_computes(flight_of):
    calls = []
    flight = flight_of(fault="drop", target="HIL_GPS", for_s=1)
    sender = AutopilotSender(
        flight,
        HilPacker(flight.simulation.board),
        lambda sends: None,
        lambda: calls.append(1) or [],
    )
    fly(sender, 1)
    assert calls == []
    sender.work_between_steps()
    sender.work_between_steps()
    assert calls == [1]


class IdleLink(UdpServer):
    """A link without data."""

    def __init__(self):
        super().__init__("127.0.0.1", 0)

    def read(self):
        raise AssertionError("read without data")


def answer(stamp_us):
    return build_frame(message_layout("HIL_ACTUATOR_CONTROLS"), {"time_usec": stamp_us, "flags": 1})


@contextmanager
def connected(link):
    with socket.create_connection(("127.0.0.1", link.port), timeout=5) as autopilot:
        while not link.peer_count:
            select.select(link.filenos(), [], [], 5.0)
            link.read()
        yield autopilot


def test_a_command_of_the_schedule_leaves_for_the_autopilot_with_the_next_step(flight_of):
    exchange = sender_of(flight_of(fault="command", do="arm"))
    fly(exchange, 2)  # the schedule counts from the first timestamp
    heartbeat = Frame(
        build_frame(message_layout("HEARTBEAT"), {"autopilot": 3, "type": 2}),
        message_layout("HEARTBEAT"),
    )
    returned: list[Frame] = []
    flight = exchange.flight
    for send in flight.core.received(VEHICLE, heartbeat.raw, flight.now_us):
        exchange.route_send(send, returned, heartbeat)
    commands = [
        (frame.number("command"), frame.number("param1"))
        for _, frame in fly(exchange, 2)
        if frame.layout.name == "COMMAND_LONG"
    ]
    assert commands == [(400, 1)]
    assert returned == []
