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

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.forwarder import Forwarder
from mavproxy_fault.compiled.object_file import load, make
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core, LinkState
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.statistics import LatencyHistogram
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import INTEGER_LIMITS, Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.signing import Signing, derive_key
from tests.signed_frames import sign_frame

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
ROLES = [LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle")]

names = st.sampled_from(sorted(FIELDS))
numbers = st.sampled_from([0, 1, -1, 5.5, -3, 0.1, 1e9, -1e9, 127, 40000, 1e-3, 1e38, 1e300])
seconds = st.integers(0, 1500).map(lambda ms: ms / 1000)
wheres = st.sampled_from(
    [{}, {}, {"system": 1}, {"component": 1}, {"direction": "from-vehicle"},
     {"direction": "to-vehicle"}, {"system": 2, "component": 1}]
)  # fmt: skip


LINK_FAULTS: list[dict[str, Any]] = [
    {"fault": "drop"}, {"fault": "drop", "value": 0.5}, {"fault": "outage"},
    {"fault": "gilbert-elliott", "to_bad": 0.3}, {"fault": "burst-loss", "value": 0.2, "frames": 3},
    {"fault": "rate-limit", "value": 30}, {"fault": "rate-limit", "value": 50, "queue_s": 0.1},
    {"fault": "rate-limit", "value": 2000, "unit": "bytes", "queue_bytes": 300},
    {"fault": "rate-limit", "value": 9000, "unit": "bytes", "overhead_bytes": 9, "burst_bytes": 99},
    {"fault": "rate-limit", "value": 90, "queue_s": 0.3, "period_s": 0.07, "slot_s": 0.02},
    {"fault": "drop", "value": 0.3, "correlation": 0.5}, {"fault": "bit-errors", "value": 1e-3},
    {"fault": "delay", "value": 0.012}, {"fault": "delay", "value": 0.02, "keep_order": True},
    {"fault": "drop", "value": 0.4, "clock": "vehicle"},
    {"fault": "reorder", "value": 0.4, "by_s": 0.03}, {"fault": "reorder", "gap": 3, "value": 0.7},
    {"fault": "reorder", "value": 0.7, "by_s": 0.03, "correlation": 0.4, "gap": 3},
    {"fault": "four-state-loss", "p13": 0.2, "p31": 0.3, "p32": 0.4, "p23": 0.5, "p14": 0.1},
    {"fault": "jitter", "value": 0.02},
    {"fault": "jitter", "value": 0.01, "distribution": "normal"},
    {"fault": "jitter", "value": 0.01, "distribution": "normal", "correlation": 0.4},
    {"fault": "jitter", "value": 0.01, "distribution": "pareto", "keep_order": False},
    {"fault": "jitter", "value": 0.01, "distribution": "exponential", "correlation": 0.4},
    {"fault": "jitter", "value": 1, "distribution": "samples", "samples": [0.01, 0, 0.03]},
    {"fault": "jitter", "value": 0.01, "distribution": "pareto-normal", "correlation": 0.4},
    {"fault": "slots", "value": 0.03, "base_s": 0.01, "frames": 3, "bytes": 120},
    {"fault": "slots", "value": 0.02, "distribution": "normal", "base_s": 0.02},
    {"fault": "rate-limit", "value": 3000, "unit": "bytes", "overhead_bytes": -9, "cell_bytes": 32,
     "cell_overhead_bytes": 3, "least_bytes": 40, "queue_frames": 4},
    {"fault": "rate-limit", "value": 2000, "unit": "bytes", "burst_bytes": 200, "peak": 4000,
     "peak_burst_bytes": 60, "queue_s": 0.5},
    {"fault": "duplicate", "value": 0.4, "correlation": 0.6},
    {"fault": "corrupt", "value": 0.4, "count": 2, "part": "frame", "correlation": 0.5},
    {"fault": "duplicate", "copies": 2}, {"fault": "duplicate", "value": 0.3, "by_s": 0.02},
    {"fault": "sequence-gap", "value": 0.3}, {"fault": "truncate", "value": 0.5},
    {"fault": "slice"}, {"fault": "truncate", "count": 90},
    {"fault": "corrupt", "value": 0.6, "count": 3}, {"fault": "corrupt", "count": 200},
    {"fault": "corrupt", "count": 2, "crc": "redone"},
    {"fault": "time-jump", "value": -2}, {"fault": "time-drift", "value": 0.3},
]  # fmt: skip
VALUE_FAULTS: list[dict[str, Any]] = [
    {"fault": "bias"}, {"fault": "scale"}, {"fault": "constant"}, {"fault": "drift"},
    {"fault": "drift", "limit": 0.4}, {"fault": "noise"},
    {"fault": "noise", "distribution": "uniform"}, {"fault": "random-walk"}, {"fault": "freeze"},
    {"fault": "sample-hold", "value": 0.05}, {"fault": "slew-limit"},
    {"fault": "float", "settle_s": 0.2, "neutral": 3}, {"fault": "quantise", "value": 0.25},
    {"fault": "saturate"}, {"fault": "dead-band"}, {"fault": "sine", "frequency_hz": 3},
    {"fault": "impulse", "period_s": 0.2, "width_s": 0.05},
    {"fault": "cycle", "period_s": 0.05}, {"fault": "bit-flip", "value": 2},
    {"fault": "bit-flip", "bit": 23},
    {"fault": "lag", "value": 0.03},
]  # fmt: skip
POSITIVE = {"noise", "random-walk", "slew-limit", "saturate", "dead-band"}
FIXED = {"freeze", "float"}


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """One fault: most can be compiled, some cannot."""
    name = draw(names)
    entry: dict[str, Any] = {"at_s": draw(seconds), "where": draw(wheres)}
    if draw(st.integers(0, 2)) == 0:
        entry |= draw(st.sampled_from(LINK_FAULTS))
        if draw(st.booleans()):
            entry["target"] = name
    else:
        entry |= draw(st.sampled_from(VALUE_FAULTS))
        fields = draw(st.lists(st.sampled_from(FIELDS[name]), min_size=1, max_size=2, unique=True))
        entry["target"] = [f"{name}.{field}" for field in fields]
        kind, value = entry["fault"], draw(numbers)
        if kind in ("bias", "scale", "constant") and draw(st.booleans()):
            entry["profile"] = draw(profiles())
        elif kind not in FIXED and kind != "bit-flip":
            entry.setdefault("value", abs(value) if kind in POSITIVE else value)
    if draw(st.booleans()):
        entry["for_s"] = draw(seconds) + 0.01
        if draw(st.booleans()):
            every_s = entry["for_s"] + draw(seconds) + 0.001
            entry["repeat"] = {"every_s": every_s, "times": draw(st.integers(1, 4))}
    if draw(st.integers(0, 3)) == 0:
        entry["probability"] = 0.5
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
            raw = build_frame(
                message_layout(name), given_values, seq=n & 255, system=system, component=component
            )
            if draw(st.integers(0, 2)) == 0:  # sometimes with another key, or an old timestamp
                frame, key = (
                    Frame(raw, message_layout(name)),
                    draw(st.sampled_from([KEY, KEY, b""])),
                )
                raw = sign_frame(
                    frame, key, draw(st.integers(0, 1)), draw(st.integers(n, n + 2))
                ).raw
            data += raw
        damage = draw(st.integers(0, 39))
        if damage == 0:
            place = draw(st.integers(0, len(data) - 1))
            data = data[:place] + b"\x55" + data[place + 1 :]
        found.append(data + b"\xfdjunk" if damage == 1 else data)
    return found


KEY = derive_key("correct horse")
Policy = tuple[bytes | None, bool] | None  # the key for signatures, and whether to strip them
Edit = tuple[int, str, Any]  # before which datagram, what, and with what


@st.composite
def edits(draw: st.DrawFn) -> list[Edit]:
    """What a user changes while traffic flows."""
    ids = st.sampled_from(["f0", "f1", "f2", "new"])
    found: list[Edit] = []
    for _ in range(draw(st.integers(0, 5))):
        what = draw(st.sampled_from(["arm", "arm", "clear", "update", "update", "replace"]))
        content: Any = draw(ids)
        if what == "arm":
            content = {**draw(entries()), "id": content}
        elif what == "update":
            content = content, draw(numbers)
        elif what == "replace":
            content = draw(st.lists(entries(), max_size=3)), draw(st.booleans())
        found.append((draw(st.integers(0, 60)), what, content))
    return found


def apply_edits(core: Core, edits: Sequence[Edit], at: int, now_us: int) -> bytes:
    """Apply what is due before a datagram, as live control does; what leaves before."""
    wanted = [edit for edit in edits if edit[0] == at]
    data = b"".join(send.data for send in core.due(now_us)) if wanted else b""
    engine = core.engine
    assert isinstance(engine, Engine)
    for _, what, content in wanted:
        core.advance_link(now_us)
        engine.advance_time(now_us if core.clock.t0_us is None else core.clock.t_us)
        with contextlib.suppress(ConfigError):  # a fault without a value, or an unknown one
            if what == "arm":
                engine.arm(content)
            elif what == "clear":
                engine.clear(content)
            elif what == "update":
                engine.update(*content)
            else:
                engine.replace(parse_schedule(named_schedule(content[0])), anew=content[1])
    return data


def named_schedule(faults: Sequence[dict[str, Any]]) -> str:
    """A schedule of faults f0, f1 and so on."""
    named = [{"id": f"f{n}", **fault} for n, fault in enumerate(faults)]
    return json.dumps({"seed": 3, "faults": named})


def new_core(
    schedule: str,
    policy: Policy,
    roles: Sequence[LinkRole] = ROLES,
    tape: CaptureBuffer | None = None,
) -> Core:
    """A core with a schedule and a policy for signed frames."""
    signing = None if policy is None else Signing(policy[0], strip=policy[1])
    return Core(roles, Engine(parse_schedule(schedule)), signing=signing, tape=tape)


class Outcome(NamedTuple):
    """What one way made of the traffic: what left, the labels, and all that is remembered."""

    sent: bytes
    labels: list[bytes]
    states: list[LinkState]
    senders: "array[int]"
    streams: "array[int] | None"


def compiled(
    traffic: Sequence[bytes], schedule: str, edits: Sequence[Edit], policy: Policy
) -> tuple[Outcome, list[tuple[int, int]]]:
    """What the compiled form sends, the wall clock going on by 10 ms; and when edits were made and
    datagrams came."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        station.bind(("127.0.0.1", 0))
        station.setblocking(False)
        links = [UdpServer("127.0.0.1", 0), UdpClient(*station.getsockname())]
        core = new_core(schedule, policy, link_roles(links))
        forwarder = Forwarder(links, core, [LatencyHistogram(), LatencyHistogram()], WALL_NS)
        sent, times = [], []
        for n, datagram in enumerate(traffic):
            forwarder.loop[k.BASE] += STEP_MS * 1_000_000
            edited_us = (forwarder.loop[k.BASE] + time.monotonic_ns()) // 1000
            data = apply_edits(core, edits, n, edited_us)
            vehicle.sendto(datagram, ("127.0.0.1", links[0].port))
            arrived = forwarder.ports[0, k.DATAGRAMS] + 1
            while forwarder.ports[0, k.DATAGRAMS] < arrived:
                until_ns = time.monotonic_ns() + 100_000
                now_us = (forwarder.loop[k.BASE] + until_ns) // 1000 - 100
                data += b"".join(send.data for send in core.due(now_us))
                due_us = core.next_due_us
                if due_us is not None:
                    until_ns = min(until_ns, due_us * 1000 - forwarder.loop[k.BASE])
                forwarder.forward(until_ns, spin=False)
                with contextlib.suppress(BlockingIOError):
                    while True:
                        data += station.recv(65_535)
                data += b"".join(send.data for send in forwarder.take_sends())
            times.append((edited_us, (forwarder.loop[k.BASE] + forwarder.loop[k.CAME]) // 1000))
            sent.append(data)
        forwarder.count()
        for link in links:
            link.close()
    return finished(core, sent, times[-1][1]), times


def finished(core: Core, sent: list[bytes], now_us: int) -> Outcome:
    """What is left after the last datagram, with all delayed frames."""
    # As one: machine code may send a delayed frame before the core would, but in the same order.
    data = b"".join([*sent, *(send.data for send in core.due(now_us + 10_000_000))])
    core.finish(now_us + 10_000_000)
    streams = core.signing and core.signing.streams
    labels = [msgspec.json.encode(label) for label in core.drain_labels()]
    return Outcome(data, labels, core.states, core.senders, streams)


def interpreted(
    traffic: Sequence[bytes],
    schedule: str,
    edits: Sequence[Edit],
    policy: Policy,
    times: Sequence[tuple[int, int]],
    *,
    machine: bool,
) -> tuple[Outcome, CaptureBuffer]:
    """What the core makes of datagrams that come at given times, with machine code before it or
    without; and its tape."""
    tape = CaptureBuffer()
    core = new_core(schedule, policy, tape=tape)
    front = CompiledCore(core, 0, tape) if machine else None
    sent = []
    for n, (datagram, (edited_us, came_us)) in enumerate(zip(traffic, times, strict=True)):
        data = apply_edits(core, edits, n, edited_us)
        sends = (core if front is None else front).received(0, datagram, came_us)
        sent.append(data + b"".join(send.data for send in sends))
    if front is not None:
        front.count()
    return finished(core, sent, times[-1][1]), tape


@pytest.fixture(scope="module", autouse=True)
def _machine_code() -> None:
    make()
    assert load() is not None


def check(
    traffic: Sequence[bytes],
    faults: Sequence[dict[str, Any]],
    edits: Sequence[Edit] = (),
    policy: Policy = None,
) -> None:
    """Compare the two ways, the compiled one with and without sockets."""
    schedule = named_schedule(faults)
    fast, times = compiled(traffic, schedule, edits, policy)
    reference = interpreted(traffic, schedule, edits, policy, times, machine=False)
    assert reference[0] == fast
    assert reference == interpreted(traffic, schedule, edits, policy, times, machine=True)


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(
    st.booleans().flatmap(datagrams),
    st.lists(entries(), min_size=1, max_size=8),
    edits(),
    st.sampled_from([None, None, (KEY, False), (KEY, True), (None, True)]),
)
def test_both_ways_give_the_same(
    traffic: list[bytes], faults: list[dict[str, Any]], edits: list[Edit], policy: Policy
) -> None:
    check(traffic, faults, edits, policy)


@pytest.mark.parametrize("policy", [(KEY, False), (KEY, True), (None, True)])
def test_signed_frames_pass_in_machine_code_whatever_is_done_with_them(policy: Policy) -> None:
    layout = message_layout("ATTITUDE")
    fault = {"fault": "bias", "target": "ATTITUDE.roll", "value": 1}
    core = new_core(named_schedule([fault]), policy)
    machine = CompiledCore(core, 0, None)
    for n in range(100):
        raw = build_frame(layout, {"time_boot_ms": 10 * n + 10, "pitchspeed": n % 3}, seq=n)
        signed = sign_frame(Frame(raw, layout), KEY, 0, n)
        send, *_ = machine.received(0, signed.raw, 10_000 * n)  # before an announcement
        (item,) = Parser().push(send.data)
        assert isinstance(item, Frame)
        assert item.number("roll") == 1
        assert item.signed is not policy[1]
    by_core = core.states[0].frames
    machine.count()
    assert (by_core, core.states[0].frames) == (1, 100), "the core takes only the first"


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


def test_a_live_edit_loses_no_count_of_the_faults_already_acting() -> None:
    """What machine code counted in stretches without events was lost with the rows it rebuilt."""
    first, later = (
        {"id": f"f{n}", "fault": "bias", "target": "GLOBAL_POSITION_INT.vx", "value": n + 1}
        for n in range(2)
    )
    layout = message_layout("GLOBAL_POSITION_INT")
    traffic = [build_frame(layout, {"time_boot_ms": 10 * n + 10}, seq=n) for n in range(60)]
    check(traffic, [first], [(40, "arm", later)])
