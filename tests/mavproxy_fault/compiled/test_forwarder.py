"""The compiled path does what the plain one does, byte for byte and count for count."""

import random
import socket
import threading
from typing import Any, NamedTuple

import pytest

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.replaying.playback import split_records
from mavproxy_fault.app.server import Server
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.object_file import load, make
from mavproxy_fault.links.link import enlarge_buffers
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import Label

SCHEDULE = """
seed: 4
faults:
  - {id: bias, fault: bias, target: [HIL_SENSOR.xgyro, HIL_SENSOR.yacc], value: [0.1, -0.5]}
  - {id: grows, fault: drift, target: ATTITUDE.roll, value: 0.3, limit: 0.4, at_s: 1}
  - {id: full, fault: scale, target: GLOBAL_POSITION_INT.vx, value: 900, where: {component: 1}}
  - {id: fixed, fault: constant, target: VFR_HUD.throttle, value: -7, at_s: 1, for_s: 1.5}
  - {id: noisy, fault: noise, target: HIL_GPS.lat, value: 10}
  - {id: gone, fault: drop, target: SYS_STATUS, probability: 0.5}
  - {id: hiss, fault: noise, target: [ATTITUDE.roll, ATTITUDE.yawspeed], value: [0.1, 0.2],
     distribution: uniform, where: {system: 1}}
  - id: pieces
    fault: scale
    target: ATTITUDE.yawspeed
    at_s: 0.5
    profile:
      segments:
        - {at_s: 0.5, for_s: 0.7, start: {uniform: [2, 3]}, rate: -1}
        - {at_s: 2, for_s: 1, start: 0}
  - {id: stuck, fault: freeze, target: [SCALED_IMU.xacc, SCALED_IMU.yacc], at_s: 0.5}
  - id: generated
    fault: constant
    target: SCALED_IMU.ymag
    profile:
      compat: param_gen
      otherwise: 7
      segments: [{at_s: 0.4, for_s: 0.5, start: 9, rate: 4}, {at_s: 1, for_s: 2, start: -5}]
  - {id: never, fault: bias, target: HIGHRES_IMU.xgyro, value: 1, at_s: 1000}
"""


class Run(NamedTuple):
    """What one server did."""

    got: list[bytes]
    labels: list[Label]
    figures: list[dict[str, Any]]
    taped: CaptureBuffer | None


def frame(name: str, seq: int, system: int = 1, component: int = 1, **values: object) -> bytes:
    return build_frame(
        message_layout(name), values, seq=seq & 255, system=system, component=component
    )


def traffic(count: int = 400, seed: int = 1) -> list[bytes]:
    """Datagrams of two vehicles and a simulator with everything that is hard in between."""
    rng = random.Random(seed)
    datagrams = [frame("ATTITUDE", 0, 1, time_boot_ms=1), frame("HEARTBEAT", 0, 2, type=2)]
    for n in range(count):
        ms = 10 + n * 10
        a = rng.uniform(-3, 3)
        choice = [
            frame("HIL_SENSOR", n, 1, 51, time_usec=ms * 1000, xgyro=a, yacc=2 * a, id=n & 1),
            frame("ATTITUDE", n, 1, time_boot_ms=ms, roll=a, yawspeed=1),
            frame("ATTITUDE", n, 2, time_boot_ms=900_000 + ms, roll=a, yawspeed=1),
            frame("GLOBAL_POSITION_INT", n, 1, n & 1, time_boot_ms=ms, vx=int(a * 30), hdg=9),
            frame("SCALED_IMU", n, 1, time_boot_ms=ms, xacc=int(a * 99), ymag=n, zmag=3),
            frame("VFR_HUD", n, 1, throttle=40, airspeed=a, climb=1),
            frame("HIL_GPS", n, 1, 51, time_usec=ms * 1000, lat=5, satellites_visible=9),
            frame("SYS_STATUS", n, 2, load=n),
            frame("COMMAND_LONG", n, 255, 190, target_system=rng.choice([0, 1, 9]), command=400),
            frame("STATUSTEXT", n + rng.randrange(2), 2, text=b"words"),
            Frame(frame("HEARTBEAT", n), message_layout("HEARTBEAT")).with_payload(bytes(9)).raw,
        ]
        datagram = b"".join(rng.choice(choice) for _ in range(rng.choice([1, 1, 1, 3])))
        if rng.random() < 0.1:
            place = rng.randrange(len(datagram))
            datagram = datagram[:place] + bytes((rng.randrange(256),)) + datagram[place + 1 :]
        if rng.random() < 0.05:
            datagram += rng.randbytes(rng.randrange(1, 20))
        datagrams.append(datagram)
    return datagrams


def run(
    datagrams: list[bytes],
    *,
    fast: bool,
    spin: bool = False,
    tape: bool = False,
    schedule: str = SCHEDULE,
) -> Run:
    """Push datagrams through a server on loopback, in both directions in turn."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        for sock in (station, vehicle):
            sock.bind(("127.0.0.1", 0))
            sock.settimeout(20)
            enlarge_buffers(sock)
        master = UdpServer("127.0.0.1", 0)
        links = [master, UdpClient(*station.getsockname())]
        kept = CaptureBuffer() if tape else None
        core = Core(link_roles(links), Engine(parse_schedule(schedule)), tape=kept)
        server = Server(links, core, tape=kept, busy_poll=spin)
        if fast:
            server.use_compiled()
        loop = threading.Thread(target=server.run)
        loop.start()
        got = []
        vehicle.sendto(b"here", ("127.0.0.1", master.port))  # or the first mark has no receiver
        assert station.recv(99) == b"here"
        for number, datagram in enumerate([*datagrams, b"the end"]):
            vehicle.sendto(datagram, ("127.0.0.1", master.port))
            if number % 20 == 0 or datagram == b"the end":
                # The station answers a mark, so that both directions keep their order.
                station.sendto(b"mark %d" % number, links[1].sock.getsockname())
                while (data := vehicle.recv(65_535)) != b"mark %d" % number:
                    got.append(data)
        while (data := station.recv(65_535)) != b"the end":
            got.append(data)
        server.stop()
        loop.join(20)
        for link in links:
            link.close()
        figures = server.stats()
    for point in figures:
        # A datagram may leave in several if the core takes one of its frames.
        for key in ("name", "chunks_out", "p50_us", "p99_us", "p99.9_us"):
            del point[key]
    return Run(got, core.drain_labels(), figures, kept.drain() if kept else None)


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    make()
    assert load() is not None


@pytest.mark.parametrize("spin", [False, True])
def test_the_compiled_path_equals_the_plain_one(spin: bool) -> None:
    datagrams = traffic()
    plain, fast = run(datagrams, fast=False), run(datagrams, fast=True, spin=spin)
    assert b"".join(fast.got) == b"".join(plain.got)
    assert fast.labels == plain.labels
    assert fast.figures == plain.figures
    assert {label.id for label in plain.labels} == {
        "bias", "grows", "full", "fixed", "noisy", "gone", "hiss", "pieces", "stuck", "generated",
    }  # fmt: skip
    assert any(label.saturated for label in plain.labels)


def test_the_compiled_path_records_the_same() -> None:
    datagrams = traffic(seed=2)
    plain, fast = run(datagrams, fast=False, tape=True), run(datagrams, fast=True, tape=True)
    assert plain.taped is not None
    assert fast.taped is not None
    assert fast.taped.index == plain.taped.index
    for one, other in (
        (fast.taped.received, plain.taped.received),
        (fast.taped.sent, plain.taped.sent),
    ):
        assert [raw for _, raw in split_records(one)] == [raw for _, raw in split_records(other)]
        stamps = [t_us for t_us, _ in split_records(one)]
        assert stamps == sorted(stamps)


FIVE_ON_EACH = """
faults:
  - {id: bias, fault: bias, target: HIL_SENSOR.xgyro, profile: {segments: [
      {at_s: 0.0002, for_s: 9, start: {uniform: [0.1, 0.2]}, rate: 0.1}]}}
  - {id: noise, fault: noise, target: [HIL_SENSOR.xacc, HIL_SENSOR.yacc], value: 1}
  - {id: stuck, fault: stuck, target: HIL_SENSOR.abs_pressure}
  - {id: scale, fault: scale, target: HIL_SENSOR.xmag, value: 1.3}
  - {id: drift, fault: drift, target: HIL_SENSOR.zgyro, value: 0.1}
"""


@pytest.mark.parametrize(("schedule", "announced"), [(SCHEDULE, 1), (FIVE_ON_EACH, 3)])
def test_most_traffic_never_reaches_the_plain_path(
    schedule: str, announced: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    process = Core._process

    def counted(self: Core, *args: Any) -> Any:
        seen.append(args)
        return process(self, *args)

    monkeypatch.setattr(Core, "_process", counted)
    sensors = [
        frame("HIL_SENSOR", n, 1, 51, time_usec=10**6 + n, xgyro=1, xmag=1, fields_updated=63)
        for n in range(500)
    ]
    outcome = run(sensors, fast=True, schedule=schedule)
    assert sum(map(len, outcome.got)) > 500 * len(sensors[0]) + announced
    assert len(seen) < 80  # the marks, and what is new at first


def watch(datagrams: list[bytes], *, machine: bool) -> tuple[list[Watched], int]:
    """What a viewer of six messages gets, some of them delayed; and the frames the core took."""
    schedule = SCHEDULE + "  - {id: late, fault: delay, target: [ATTITUDE, VFR_HUD], value: 0.2}"
    control = LiveControl(Engine(parse_schedule(schedule)))
    roles = (LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle"))
    core = Core(roles, control.engine, control=control)
    control.watch(
        b'["HIL_SENSOR", "ATTITUDE", "SCALED_IMU", "VFR_HUD", "SYS_STATUS", "HIL_GPS"]', 0.0
    )
    front = CompiledCore(core, 0, None) if machine else core
    for n, datagram in enumerate(datagrams):
        front.received(0, datagram, 9_000_000 + 10_000 * n)
    taken = core.states[0].frames
    if isinstance(front, CompiledCore):
        front.count()
    return sorted(control.watched(0.0), key=repr), taken


def test_viewers_get_the_same_samples_from_machine_code() -> None:
    datagrams = traffic(200)
    (by_core, all_frames), (samples, taken) = (
        watch(datagrams, machine=machine) for machine in (False, True)
    )
    assert samples == by_core
    assert {one.message for one in samples} >= {"HIL_SENSOR", "ATTITUDE", "VFR_HUD", "SYS_STATUS"}
    assert taken < 0.7 * all_frames


def test_ranges_are_whole_where_frames_pass_in_machine_code() -> None:
    control = LiveControl(Engine(parse_schedule("faults: []")))
    roles = (LinkRole("simulator", "to-vehicle"), LinkRole("vehicle", "from-vehicle"))
    machine = CompiledCore(Core(roles, control.engine, control=control), 0, None)
    control.watch(b'["PSEUDORANGE"]', 0.0)
    names = tuple(f"G{n:02}" for n in range(1, 12))
    zeros = [0.0] * len(names)
    for n in range(5):
        sample = frame("HIL_SENSOR", n, 1, 51, time_usec=200_000 * n + 1)
        machine.received(0, sample, 9_000_000 + 200_000 * n)
        (message,) = encode_epoch(1000.0 + 0.2 * n, names, [2.1e7] * len(names), zeros, zeros)
        for raw in tunnel_frames(message, n):  # several frames of one time
            machine.received(0, raw, 9_000_100 + 200_000 * n)
    machine.count()
    (samples,) = control.watched(0.0)
    assert [sum(value is not None for value in row) for row in samples.received] == [12] * 5


def test_delayed_frames_leave_without_the_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    released = []
    release = CompiledCore._release

    def counted(self: CompiledCore, now_us: int) -> Any:
        released.append(release(self, now_us))
        return released[-1]

    monkeypatch.setattr(CompiledCore, "_release", counted)
    frames = [frame("VFR_HUD", n, throttle=1 + n % 90) for n in range(400)]
    outcome = run(frames, fast=True, schedule="faults: [{fault: jitter, value: 0.002}]")
    assert [data for data in outcome.got if len(data) == len(frames[0])] == frames
    assert sum(map(len, released)) < 200  # before what is junk, the core releases them
