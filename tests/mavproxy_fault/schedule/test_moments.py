"""Times that count from a flight event seen on a ground link."""

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

STEP_US = 100_000
HEARTBEAT = {"type": 2, "autopilot": 3}


def frame(name: str, **values: float) -> Frame:
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def flight(number: int) -> list[Frame]:
    """Return a vehicle's messages every 0.1 s: armed at 5 s, airborne at 8 s, item 2 at 12 s."""
    t_s = number * 0.1
    said = [
        frame("HEARTBEAT", **HEARTBEAT, base_mode=0x80 if t_s >= 5.0 else 0),
        frame("GLOBAL_POSITION_INT", relative_alt=2000 if t_s >= 8.0 else 100),
    ]
    return said + ([frame("MISSION_ITEM_REACHED", seq=2)] if t_s >= 12.0 else [])


def acted(entry: str) -> tuple[float, float]:
    """Return start and end of a fault of VFR_HUD, in seconds after the first frame."""
    it = Engine(parse_schedule(f"faults: [{{id: f, fault: drop, target: VFR_HUD, {entry}}}]"))
    lost = []
    for number in range(300):
        t_us = 1_000_000 + number * STEP_US
        for one in flight(number):
            it.apply(one, "from-vehicle", t_us)
        if not it.apply(frame("VFR_HUD", throttle=40), "from-vehicle", t_us):
            lost.append(number * 0.1)
    return round(lost[0], 1), round(lost[-1] + 0.1, 1)


@pytest.mark.parametrize(
    ("entry", "span"),
    [
        ("at_s: 2, for_s: 1", (2.0, 3.0)),
        ("from: first-stamp, at_s: 2, for_s: 1", (2.0, 3.0)),
        ("from: arming, at_s: 2, for_s: 1", (7.0, 8.0)),
        ("from: take-off, for_s: 1", (8.0, 9.0)),
        ("from: mission-item:1, at_s: 0.5, for_s: 2", (12.5, 14.5)),
        ("from: arming, at_s: 1, for_s: 1, when: altitude_m > 1", (8.0, 9.0)),
    ],
)
def test_times_count_from_the_flight_event(entry, span):
    assert acted(entry) == span


def test_live_edits_and_saving_keep_the_flight_event():
    text = "seed: 3\nfaults: [{id: f, fault: drop, target: VFR_HUD, from: take-off, at_s: 2}]"
    it = Engine(parse_schedule(text))
    it.apply(frame("VFR_HUD"), "from-vehicle", 1_000_000)
    it.apply(frame("VFR_HUD"), "from-vehicle", 9_000_000)
    it.arm({"id": "g", "fault": "drop", "target": "VFR_HUD", "from": "arming"})
    first, second = parse_schedule(it.save()).faults
    assert (first.moment, first.at_s) == (parse_schedule(text).faults[0].moment, 2.0)
    assert (second.written["from"], second.at_s) == ("arming", 0.0)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("from: landing", "from = landing is not a flight event; give first-stamp, arming"),
        ("from: mission-item:x", "mission-item:N"),
        ("from: arming, after: g", "from and after exclude each other; give one of them"),
    ],
)
def test_an_unknown_flight_event_is_refused(entry, said):
    other = "{id: g, fault: drop, target: HIL_GPS}"
    with pytest.raises(ConfigError, match=said):
        parse_schedule(f"faults: [{other}, {{id: f, fault: drop, target: VFR_HUD, {entry}}}]")
