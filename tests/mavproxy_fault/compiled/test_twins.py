"""Whatever passes, and whatever is scheduled: both ways give the same bytes, labels and counters.

Where a rule has a second form in `compiled`, this is what holds the two together.
"""

import contextlib
import json
import socket
import time
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.forwarder import Forwarder
from mavproxy_fault.compiled.object_file import load, make
from mavproxy_fault.compiled.passage import Passage
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core, LinkState
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.statistics import LatencyHistogram
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import INTEGER_LIMITS, build_frame
from mavproxy_fault.wire.label import Label

STAMPS = {
    "ATTITUDE": "time_boot_ms", "GLOBAL_POSITION_INT": "time_boot_ms", "SCALED_IMU": "time_boot_ms",
    "HIL_SENSOR": "time_usec", "HIL_GPS": "time_usec", "VFR_HUD": "", "SYS_STATUS": "",
    "BATTERY_STATUS": "",
}  # fmt: skip
FIELDS = {
    "ATTITUDE": ("roll", "yawspeed"), "GLOBAL_POSITION_INT": ("vx", "lat", "hdg"),
    "SCALED_IMU": ("xacc", "ymag"), "HIL_SENSOR": ("xgyro", "abs_pressure"),
    "HIL_GPS": ("lat", "vn", "cog"), "VFR_HUD": ("throttle", "airspeed"),
    "SYS_STATUS": ("load", "voltage_battery"), "BATTERY_STATUS": ("temperature",),
}  # fmt: skip
UNIX_US = 1_700_000_000_000_000
STEP_MS = 10
WALL_NS = 1_000_000_000

names = st.sampled_from(sorted(FIELDS))
numbers = st.sampled_from([0, 1, -1, 5.5, -3, 0.1, 1e9, -1e9, 127, 40000, 1e-3, 1e38, 1e300])
seconds = st.integers(0, 1500).map(lambda ms: ms / 1000)
wheres = st.sampled_from(
    [{}, {}, {"system": 1}, {"component": 1}, {"direction": "from-vehicle"},
     {"direction": "to-vehicle"}, {"system": 2, "component": 1}]
)  # fmt: skip


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """One fault that can be compiled, or one that cannot."""
    name = draw(names)
    kind = draw(st.sampled_from(["bias", "scale", "constant", "drift", "noise", "freeze", "drop"]))
    target = name if kind == "drop" else f"{name}.{draw(st.sampled_from(FIELDS[name]))}"
    entry: dict[str, Any] = {"fault": kind, "target": target, "at_s": draw(seconds)}
    entry["where"] = draw(wheres)
    if draw(st.booleans()):
        entry["for_s"] = draw(seconds) + 0.01
        if draw(st.booleans()):
            every_s = entry["for_s"] + draw(seconds) + 0.001
            entry["repeat"] = {"every_s": every_s, "times": draw(st.integers(1, 4))}
    if kind in ("bias", "scale", "constant") and draw(st.booleans()):
        entry["profile"] = draw(profiles())
    elif kind not in ("freeze", "drop"):
        value = draw(numbers)
        entry["value"] = abs(value) if kind == "noise" else value
    if kind == "noise":
        entry["distribution"] = draw(st.sampled_from(["gaussian", "uniform"]))
    return entry


@st.composite
def profiles(draw: st.DrawFn) -> dict[str, Any]:
    """Two segments, of which the second begins with a drawn number."""
    at_s, for_s = draw(seconds), draw(seconds)
    later = {"at_s": at_s + for_s + draw(seconds), "for_s": 0.5, "start": {"uniform": [0, 3]}}
    first = {"at_s": at_s, "for_s": for_s, "start": draw(numbers), "rate": draw(numbers)}
    profile: dict[str, Any] = {"segments": [first, later]}
    if draw(st.booleans()):
        profile["otherwise"] = draw(numbers)
    if draw(st.booleans()):
        profile["mode"] = draw(st.sampled_from(["add", "scale", "replace"]))
    return profile


def values(draw: st.DrawFn, name: str) -> dict[str, Any]:
    """Ordinary and extreme values of a message's fields."""
    found: dict[str, Any] = {}
    for field in FIELDS[name]:
        code = message_layout(name).fields[field].code
        extremes = INTEGER_LIMITS.get(code, (3e38, float("nan")))
        found[field] = draw(st.sampled_from([0, 1, 7, *extremes]))
    return found


@st.composite
def datagrams(draw: st.DrawFn, stamped: bool) -> list[bytes]:
    """Frames of two systems, several in a datagram, with reboots, wrong stamps and junk."""
    kinds = st.sampled_from([name for name in sorted(FIELDS) if stamped or not STAMPS[name]])
    offset_ms = {1: 0, 2: draw(st.sampled_from([0, 5, 900_000]))}
    found = [build_frame(message_layout("HEARTBEAT"), {"type": 2}, system=2)]
    for n in range(draw(st.integers(10, 60))):
        if draw(st.integers(0, 19)) == 0:
            system = draw(st.sampled_from([1, 2]))
            offset_ms[system] += draw(st.sampled_from([-30_000, -5_000, 9_000, 20_000]))
        data = b""
        for _ in range(draw(st.sampled_from([1, 1, 2, 4]))):
            name, system = draw(kinds), draw(st.sampled_from([1, 1, 2]))
            given_values = values(draw, name)
            if STAMPS[name]:
                ms = max(STEP_MS * (n + 1) + offset_ms[system], 0)
                unix_us = draw(st.sampled_from([0, 0, 0, UNIX_US, 1 << 63]))
                stamp = ms if STAMPS[name] == "time_boot_ms" else ms * 1000 + unix_us
                given_values[STAMPS[name]] = stamp
            component = draw(st.sampled_from([1, 1, 51]))
            data += build_frame(
                message_layout(name), given_values, seq=n & 255, system=system, component=component
            )
        damage = draw(st.integers(0, 39))
        if damage == 0:
            place = draw(st.integers(0, len(data) - 1))
            data = data[:place] + b"\x55" + data[place + 1 :]
        found.append(data + b"\xfdjunk" if damage == 1 else data)
    return found


class Outcome(NamedTuple):
    """What one way made of the traffic: what left, the labels, and all that is remembered."""

    sent: list[list[bytes]]
    labels: list[Label]
    states: list[LinkState]
    senders: "array[int]"


def compiled(traffic: Sequence[bytes], schedule: str) -> tuple[Outcome, list[int]]:
    """What the compiled form sends, the wall clock going on by 10 ms; and when each came."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        station.bind(("127.0.0.1", 0))
        station.setblocking(False)
        links = [UdpServer("127.0.0.1", 0), UdpClient(*station.getsockname())]
        core = Core(link_roles(links), Engine(parse_schedule(schedule)))
        forwarder = Forwarder(links, core, [LatencyHistogram(), LatencyHistogram()], WALL_NS)
        sent, came_us = [], []
        for datagram in traffic:
            forwarder.loop[k.BASE] += STEP_MS * 1_000_000
            vehicle.sendto(datagram, ("127.0.0.1", links[0].port))
            arrived = forwarder.ports[0, k.DATAGRAMS] + 1
            while forwarder.ports[0, k.DATAGRAMS] < arrived:
                forwarder.forward(time.monotonic_ns() + 100_000, spin=False)
            came_us.append((forwarder.loop[k.BASE] + forwarder.loop[k.CAME]) // 1000)
            if forwarder.pending:
                number, data, _ = forwarder.handed_over()
                sent.append([send.data for send in core.received(number, data, came_us[-1])])
            else:
                sent.append([])
                with contextlib.suppress(BlockingIOError):
                    while True:
                        sent[-1].append(station.recv(65_535))
        forwarder.count()
        for link in links:
            link.close()
    core.finish(came_us[-1])
    return Outcome(sent, core.drain_labels(), core.states, core.senders), came_us


def interpreted(traffic: Sequence[bytes], schedule: str, came_us: Sequence[int]) -> Outcome:
    """What the core sends for datagrams that come at given times."""
    links = [LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle")]
    core = Core(links, Engine(parse_schedule(schedule)))
    sent = [
        [send.data for send in core.received(0, datagram, now_us)]
        for datagram, now_us in zip(traffic, came_us, strict=True)
    ]
    core.finish(came_us[-1])
    return Outcome(sent, core.drain_labels(), core.states, core.senders)


def lent(traffic: Sequence[bytes], schedule: str, came_us: Sequence[int]) -> Outcome:
    """What becomes of the same without sockets; the tape holds what the core's would."""
    links = [LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle")]
    cores = [Core(links, Engine(parse_schedule(schedule)), tape=CaptureBuffer()) for _ in range(2)]
    core, reference = cores
    tape = core._capture
    assert tape is not None
    passage, sent = Passage(core, tape), []
    for datagram, now_us in zip(traffic, came_us, strict=True):
        passed = passage.passed(0, datagram, now_us)
        if passed is None:
            sent.append([send.data for send in core.received(0, datagram, now_us)])
        else:
            sent.append([passed.data] if passed.links else [])
        reference.received(0, datagram, now_us)
    passage.count()
    for one in cores:
        one.finish(came_us[-1])
    assert tape == reference._capture
    return Outcome(sent, core.drain_labels(), core.states, core.senders)


@pytest.fixture(scope="module", autouse=True)
def _machine_code() -> None:
    make()
    assert load() is not None


def check(traffic: Sequence[bytes], faults: Sequence[dict[str, Any]]) -> None:
    """Compare the two ways."""
    named = [{"id": f"f{n}", **fault} for n, fault in enumerate(faults)]
    schedule = json.dumps({"seed": 3, "faults": named})
    fast, came_us = compiled(traffic, schedule)
    reference = interpreted(traffic, schedule, came_us)
    assert reference == fast
    assert reference == lent(traffic, schedule, came_us)


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(st.booleans().flatmap(datagrams), st.lists(entries(), min_size=1, max_size=8))
def test_both_ways_give_the_same(traffic: list[bytes], faults: list[dict[str, Any]]) -> None:
    check(traffic, faults)


def test_faults_begin_on_a_link_without_stamps() -> None:
    hud = [
        build_frame(message_layout("VFR_HUD"), {"throttle": 40, "climb": 1}, seq=n)
        for n in range(100)
    ]
    faults = [{"fault": "constant", "target": "VFR_HUD.throttle", "value": 7, "at_s": 0.5}]
    check(hud, faults)


def test_a_frame_without_a_stamp_is_judged_by_the_one_before_it_in_its_datagram() -> None:
    traffic = [
        build_frame(
            message_layout("ATTITUDE"),
            {"time_boot_ms": 10 * n + 10, "yawspeed": 1},
            seq=2 * n & 255,
        )
        + build_frame(message_layout("VFR_HUD"), {"throttle": 40, "climb": 1}, seq=2 * n + 1 & 255)
        for n in range(100)
    ]
    faults = [{"fault": "constant", "target": "VFR_HUD.throttle", "value": 7, "at_s": 0.5}]
    check(traffic, faults)


def test_clocks_that_leap_within_a_datagram_are_followed_alike() -> None:
    stamps_ms = [1000, 1010, 50_000, 1020, 51_000, 51_010, 51_020, 1000, 1010, 1020, 30_000, 1030]
    frames = [
        build_frame(message_layout("ATTITUDE"), {"time_boot_ms": ms, "yawspeed": 1}, seq=n)
        for n, ms in enumerate([10, 20, *stamps_ms])
    ]
    traffic = [frames[0], frames[1], b"".join(frames[2:8]), b"".join(frames[8:])]
    check(traffic, [{"fault": "drift", "target": "ATTITUDE.roll", "value": 0.1}])


def test_the_first_simulated_sample_restarts_the_timeline_in_both_ways() -> None:
    uptimes = [
        build_frame(message_layout("ATTITUDE"), {"time_boot_ms": 11_000_000 + n}, seq=n)
        for n in range(3)
    ]
    simulated = [
        build_frame(
            message_layout("HIL_SENSOR"), {"time_usec": 10_000 * n, "xgyro": 1}, seq=n, component=51
        )
        for n in range(1, 40)
    ]
    known = build_frame(message_layout("HEARTBEAT"), {"type": 2}, component=51)
    faults = [{"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 1, "at_s": 0.1}]
    check([*uptimes, known, *simulated], faults)


def test_what_is_left_of_a_batch_after_a_count_is_counted_too() -> None:
    """The count came between a datagram that was handed over and the rest of its batch."""
    links = [UdpServer("127.0.0.1", 0), UdpClient("127.0.0.1", 9)]
    core = Core(link_roles(links))
    forwarder = Forwarder(links, core, [LatencyHistogram(), LatencyHistogram()], WALL_NS)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        for seq in range(3):
            frame = build_frame(message_layout("HEARTBEAT"), {"type": 2}, seq=seq)
            vehicle.sendto(frame, ("127.0.0.1", links[0].port))
    while not forwarder.pending:
        forwarder.forward(time.monotonic_ns() + 100_000, spin=False)
    number, data, came_ns = forwarder.handed_over()
    core.received(number, data, came_ns // 1000)
    forwarder.count()
    while forwarder.pending:
        forwarder.forward(time.monotonic_ns() + 100_000, spin=False)
    forwarder.count()
    assert core.states[0].frames == 3
    for link in links:
        link.close()
