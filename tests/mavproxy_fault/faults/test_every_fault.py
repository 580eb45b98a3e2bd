"""The contract of every registered fault, and each fault end to end.

The frames run through an engine and are judged by pymavlink's decoder.
"""

import importlib.metadata
import math
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as pymavlink

from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.faults import registry
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.plant_messages import plant_change

START_US = 1_000_000
STEP_US = 4_000
FRAMES = 200  # 0.8 s; the fault acts from 0.2 s to 0.6 s
FIRST, LAST = 50, 150
EXAMPLES = {name: kind.example for name, kind in known_faults().items()}


def frames() -> list[tuple[int, Frame]]:
    """HIL_SENSOR at 250 Hz; with every tenth HIL_GPS and an autopilot's messages."""
    made = []
    for i in range(FRAMES):
        t_us = START_US + i * STEP_US
        sensor = {
            "time_usec": t_us,
            "xgyro": math.sin(i / 9),
            "ygyro": 0.2,
            "zgyro": -0.1,
            "zacc": -9.81,
            "abs_pressure": 950.0,
            "fields_updated": 0x1FFF,
        }
        gps = {"time_usec": t_us, "lat": 473977418, "lon": 85455939, "alt": 488_000, "vn": 100}
        for name, values in [("HIL_SENSOR", sensor)] + [("HIL_GPS", gps)] * (i % 10 == 0):
            layout = message_layout(name)
            made.append(
                (t_us, Frame(build_frame(layout, values, seq=i % 256, component=51), layout))
            )
        place = {"time_boot_ms": t_us // 1000, "alt": 488_000, "relative_alt": 0}
        for name, values in [
            ("GLOBAL_POSITION_INT", place),
            ("HEARTBEAT", {"type": 2, "autopilot": 12}),
        ] * (i % 10 == 0):
            layout = message_layout(name)
            made.append((t_us, Frame(build_frame(layout, values, component=1), layout)))
    return made


def schedule(name: str) -> Engine:
    entry = {"id": "it", "fault": name, "at_s": 0.2, "for_s": 0.4, **EXAMPLES[name]}
    return Engine(parse_schedule({"seed": 3, "faults": [entry]}))


def sent(engine: Engine) -> list[tuple[int, Outgoing]]:
    return [
        (t_us, out) for t_us, frame in frames() for out in engine.apply(frame, "to-vehicle", t_us)
    ] + [(0, out) for out in engine.due(10**9)]


def raw(out: Outgoing) -> bytes:
    return out.frame if isinstance(out.frame, bytes) else out.frame.raw


@pytest.mark.parametrize("name", EXAMPLES)
def test_no_frame_is_due_before_it_arrived(name: str) -> None:
    assert all(out.due_us >= t_us for t_us, out in sent(schedule(name)))


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_same_seed_gives_the_same_output(name: str) -> None:
    one, two = sent(schedule(name)), sent(schedule(name))
    assert [(out.due_us, raw(out)) for _, out in one] == [(out.due_us, raw(out)) for _, out in two]


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_returned_state_does_not_change_the_previous_one(name: str) -> None:
    entry = schedule(name)._schedule.faults[0]
    outcomes = []
    for _ in range(2):
        rng = np.random.default_rng(7)
        state = entry.fault.new_state(START_US)
        found: list[tuple[int, object]] = []
        for t_us, frame in frames():
            if entry.ids is not None and frame.id not in entry.ids:
                continue
            sends, state = entry.fault.apply(frame, t_us, state, rng)
            found += [(out.due_us, raw(out)) for out in sends]
        outcomes.append(found)
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("name", EXAMPLES)
def test_frames_outside_the_fault_are_the_same_object(name: str) -> None:
    engine = schedule(name)
    for t_us, frame in frames():
        outs = [out for out in engine.apply(frame, "to-vehicle", t_us) if not out.back]
        i = (t_us - START_US) // STEP_US
        if not FIRST <= i < LAST:
            assert [(out.frame is frame, out.due_us) for out in outs] == [(True, t_us)]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_label_covers_the_fault_and_counts_every_frame(name: str) -> None:
    engine = schedule(name)
    touched = 0
    for t_us, frame in frames():
        outs = engine.apply(frame, "to-vehicle", t_us)
        touched += not (len(outs) == 1 and outs[0].frame is frame and outs[0].due_us == t_us)
    labels = [label for label in engine.drain_labels() if label.end_us is not None]
    assert len(labels) == 1
    label = labels[0]
    begin_us, end_us = START_US + FIRST * STEP_US, START_US + LAST * STEP_US
    assert begin_us <= label.start_us < begin_us + 110_000
    assert label.end_us == end_us
    assert label.frames > 0
    extra = name == "plant"  # the message that restores the healthy value
    assert label.frames == touched - extra


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - {"truncate", "outage"}))
def test_pymavlink_reads_the_sent_frames(name: str) -> None:
    decoder = pymavlink.MAVLink(None)
    read = [decoder.decode(bytearray(raw(out))) for _, out in sent(schedule(name))]
    assert len(read) > FRAMES // 3


def test_a_plant_fault_is_sent_to_the_simulator_and_reset_at_the_end() -> None:
    messages = [out for _, out in sent(schedule("plant")) if out.back]
    changes = [plant_change(out.frame) for out in messages if isinstance(out.frame, Frame)]
    assert changes[0] is not None
    assert (changes[0].name, changes[0].value) == ("mass_kg_add", 0.5)
    assert changes[-1] is not None
    assert changes[-1].value is None
    assert len(changes) == 3  # at the start, after 0.2 s, at the end


LAYOUTS = [
    message_layout(name)
    for name in ("HIL_SENSOR", "HIL_GPS", "GPS_INPUT", "ODOMETRY", "GPS_RAW_INT")
]


@pytest.mark.parametrize("name", EXAMPLES)
@settings(max_examples=15)
@given(data=st.data())
def test_a_fault_works_with_any_payload(name: str, data: st.DataObject) -> None:
    engine = Engine(parse_schedule({"seed": 3, "faults": [{"fault": name, **EXAMPLES[name]}]}))
    for step in range(3):
        layout = data.draw(st.sampled_from(LAYOUTS))
        payload = data.draw(st.binary(min_size=1, max_size=layout.length))
        frame = Frame(build_frame(layout, {}, component=51), layout).with_payload(payload)
        for out in engine.apply(frame, "to-vehicle", START_US + step * 100_000):
            assert out.due_us >= START_US + step * 100_000
            if isinstance(out.frame, Frame):
                assert out.frame.with_payload(out.frame.payload).raw == out.frame.raw


def test_another_package_adds_a_fault_by_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint(
        "double", "mavproxy_fault.faults.profile_faults:Scale", "mavproxy_fault.faults"
    )
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point])
    registry.known_faults.cache_clear()
    try:
        entry = {"fault": "double", "target": "HIL_SENSOR.xgyro", "value": 2}
        assert parse_schedule({"faults": [entry]}).faults[0].name == "double"
    finally:
        registry.known_faults.cache_clear()
