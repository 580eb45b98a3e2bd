"""RADIO_STATUS of the radio: to whom it goes, and that it fits the queue and the losses."""

from typing import Any

import pytest

from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.object_file import make
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle"))
WALL_US = 1_700_000_000_000_000
STATUS = message_layout("RADIO_STATUS")
DATA = message_layout("FILE_TRANSFER_PROTOCOL")


def reports(
    radio: dict[str, Any], rate_hz: int, seconds: int, *, compiled: bool = False
) -> tuple[list[tuple[int, dict[str, Any]]], int, list[int]]:
    """Time and values of each report, the frames that passed, and the times at which some wait."""
    core = Core(ROLES, Engine(parse_schedule({"seed": 2, "faults": [{"fault": "radio", **radio}]})))
    receive = CompiledCore(core, 0, None).received if compiled else core.received
    found, passed, waits_us = [], 0, []
    for n in range(rate_hz * seconds):
        now_us = WALL_US + n * 1_000_000 // rate_hz
        raw = build_frame(DATA, {"payload": [7] * 85}, seq=n & 255)
        sends = core.due(now_us) + receive(0, raw, now_us)
        for send in sends:
            if send.data[7:10] == STATUS.id.to_bytes(3, "little"):
                assert send.link == 0  # to the sender only
                frame = Frame(send.data, STATUS)
                assert (frame.system, frame.component) == (51, 68)
                found.append((now_us - WALL_US, dict(frame.values())))
            elif send.data[7:10] == DATA.id.to_bytes(3, "little"):
                passed += 1
        waits_us.append((core.next_due_us or now_us) - now_us)
    return found, passed, waits_us


@pytest.mark.parametrize("compiled", [False, True])
def test_the_reports_say_how_full_the_buffer_is(compiled: bool) -> None:
    if compiled:
        make()
    idle, passed, _ = reports({"value": 5000, "queue_bytes": 2000}, 10, 5, compiled=compiled)
    assert [t_us for t_us, _ in idle] == [n * 1_000_000 for n in range(5)]
    assert [values["txbuf"] for _, values in idle] == [95] * 5  # the frame itself is 100 bytes
    assert passed == 50 - 1  # the last is still on the air
    busy, passed, _ = reports({"value": 1000, "queue_bytes": 2000}, 20, 8, compiled=compiled)
    levels = [values["txbuf"] for _, values in busy]
    assert levels[:2] == [95, 45]  # it comes at twice the rate: 1000 bytes more after a second
    assert all(level <= 5 for level in levels[2:])
    assert passed == pytest.approx(80, abs=1)
    assert all(values["rxerrors"] == 0 for _, values in busy)


def test_frames_lost_on_the_air_are_counted_in_the_reports() -> None:
    radio = {"value": 1e6, "bit_error_rate": 5e-4, "rssi": 60, "noise": 33}
    found, passed, _ = reports(radio, 100, 10)
    _, last = found[-1]
    expected = 1000 * (1 - (1 - 5e-4) ** 800)
    assert last["rxerrors"] == pytest.approx(expected * 0.9, rel=0.15)
    assert 1000 - passed == pytest.approx(expected, rel=0.1)
    assert (last["rssi"], last["remrssi"], last["noise"]) == (60, 60, 33)
