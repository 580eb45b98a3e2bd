"""Several faults on one frame act in sequence."""

import math
from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.fault_parts.elements import (
    locate_element,
    patch_frame,
    read_elements,
    write_elements,
)
from mavproxy_fault.faults.profile_faults import Bias
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import latest_labels

# A link fault in between: the frame continues in several copies.
RULES = {n: k.example for n, k in known_faults().items() if k.acts_on == "fields"}
OTHERS = {"duplicate": {"copies": 2}, "drop": {"value": 0.3}, "time-jump": {"value": 1}}
FRAMES, STEP_US = 30, 20_000


def sensor(n: int, **values: float) -> Frame:
    layout = message_layout("HIL_SENSOR")
    fields = {"time_usec": 1_000_000 + n * STEP_US, "xgyro": n / 7, "fields_updated": 7, **values}
    return Frame(build_frame(layout, fields, seq=n), layout)


def entry(n: int, name: str) -> dict[str, Any]:
    return {"id": f"it-{n}", "fault": name, **{**RULES, **OTHERS}[name]}


def through(engine: Engine, frames: list[tuple[int, Frame]]) -> list[tuple[int, Frame]]:
    """Return the output of an engine in order of time."""
    found = []
    for t_us, frame in frames:
        for out in engine.apply(frame, "to-vehicle", t_us):
            assert isinstance(out.frame, Frame)
            found.append((t_us, out.frame))
    return found


@given(st.lists(st.sampled_from(sorted(RULES) * 2 + sorted(OTHERS)), min_size=2, max_size=8))
def test_faults_on_one_message_act_as_one_after_the_other(names: list[str]) -> None:
    entries = [entry(n, name) for n, name in enumerate(names)]
    together = Engine(parse_schedule({"seed": 3, "faults": entries}))
    alone = [Engine(parse_schedule({"seed": 3, "faults": [one]})) for one in entries]
    for engine in (together, *alone):
        engine.start_at(0)  # even if the first frame is dropped before
    frames = [(n * STEP_US, sensor(n)) for n in range(FRAMES)]
    left = through(together, frames)
    for engine in alone:
        frames = through(engine, frames)
    assert [(t_us, frame.raw) for t_us, frame in left] == [(t_us, f.raw) for t_us, f in frames]
    labels = [latest_labels(engine.finish(FRAMES * STEP_US)) for engine in (together, *alone)]
    assert labels[0] == latest_labels(label for one in labels[1:] for label in one)


def test_a_fault_that_fails_keeps_the_changes_of_the_others() -> None:
    class Broken(Bias, frozen=True, kw_only=True):
        def after(self, *_: object) -> tuple[list[Any], None]:
            return [1.0, "text"], None

    bias, two = parse_schedule({"faults": [
        {"fault": "bias", "target": "HIL_SENSOR.zgyro", "value": 1.0},
        {"fault": "bias", "target": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro"], "value": 1.0},
    ]}).faults  # fmt: skip
    broken = msgspec.structs.replace(two, fault=Broken(elements=two.fault.elements, value=1.0))
    frame = sensor(0)
    [(_, left)] = through(Engine(Schedule(1, (broken,))), [(0, frame)])
    assert left is frame
    [(_, left)] = through(Engine(Schedule(1, (bias, broken))), [(0, frame)])
    assert left.raw == patch_frame(frame, {locate_element(frame.layout, "zgyro"): 1.0}).raw


def test_unchanged_values_leave_the_same_frame_object() -> None:
    frame = sensor(3, zgyro=-0.0, xmag=float("nan"))
    elements = parse_schedule({"faults": [
        {"fault": "bias", "value": 1, "target": [f"HIL_SENSOR.{name}" for name in
                                                 ("zgyro", "xmag", "id", "fields_updated")]},
    ]}).faults[0].fault.elements[frame.id]  # fmt: skip
    healthy = read_elements(frame, elements)
    assert write_elements(frame, 0, elements, healthy).frame is frame
    # A zero of the other sign has other bytes without a change of value.
    out = write_elements(frame, 0, elements[:1], [0.0])
    assert (out.magnitude, out.saturated) == (0.0, 0)
    assert isinstance(out.frame, Frame)
    assert math.copysign(1.0, out.frame.number("zgyro")) == 1.0
