"""One float by a rule for one: the short way of value faults against the general one."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.fault_parts.draft import Draft
from mavproxy_fault.faults.driven import Bias
from mavproxy_fault.proxy.value_entry import NOWHERE, RunningValueFault
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import FLOAT_MAX, Frame, build

SENSOR = known("HIL_SENSOR")
# Every float that an edge may come from: zeros of two signs, subnormal, the limits, no numbers.
EDGES = [0.0, -0.0, 1e-45, -1e-45, 1e-300, FLOAT_MAX, -FLOAT_MAX, 1e300, float("inf"), float("nan")]
singles = st.binary(min_size=4, max_size=4) | st.sampled_from(EDGES[:7]).map(
    lambda x: struct.pack("<f", x)
)
numbers = st.floats() | st.sampled_from(EDGES) | st.floats(width=32)


def at_work(fault: str, value: float, *, short: bool) -> RunningValueFault:
    entry = {"fault": fault, "target": "HIL_SENSOR.ygyro", "value": value}
    running = RunningValueFault(parse_schedule({"faults": [entry]}).faults[0], 1, 0, 0)
    assert running._floats[SENSOR.id] < NOWHERE
    if not short:
        running._floats = {SENSOR.id: NOWHERE}
    running.begin()
    return running


@given(singles, numbers, st.sampled_from(["bias", "scale", "constant", "saturate", "dead-band"]))
def test_the_short_way_gives_the_bytes_and_counts_of_the_general_one(
    healthy: bytes, value: float, fault: str
) -> None:
    if not abs(value) <= FLOAT_MAX or fault not in ("bias", "scale", "constant"):
        value = abs(value) if abs(value) < 1e308 else 1e39
    frame = Frame(build(SENSOR, {"time_usec": 1, "id": 1}), SENSOR)
    payload = bytearray(frame.payload)
    start = SENSOR.fields["ygyro"].offset
    payload[start : start + 4] = healthy
    frame = frame.with_payload(bytes(payload))
    outcomes = []
    for short in (True, False):
        running, draft = at_work(fault, value, short=short), Draft(frame)
        for t_us in (5, 6):  # what the first has left, too
            running.edit(draft, "from-vehicle", t_us)
        left = draft.sealed()
        label = running.close(9)
        outcomes.append((left.raw, left is frame, label))
    assert outcomes[0] == outcomes[1]


def test_a_live_value_acts_on_the_next_frame() -> None:
    running = at_work("bias", 1.0, short=True)
    running.feed(3.0, 1, None)
    draft = Draft(Frame(build(SENSOR, {"id": 1}), SENSOR))
    running.edit(draft, "from-vehicle", 2)
    assert draft.sealed().number("ygyro") == 3.0


def test_a_rule_of_its_own_is_asked_whatever_it_derives_from() -> None:
    class Odd(Bias, frozen=True, kw_only=True):
        def after(self, before, key, t_s, state, rng):  # type: ignore[no-untyped-def]
            return [7.0], state

    assert Bias(value=1.0).by_value
    assert not Odd(value=1.0).by_value
    assert not Bias(value=(1.0, 2.0)).by_value


def test_a_rule_that_fails_lets_the_frame_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    running = at_work("bias", 1.0, short=True)
    monkeypatch.setattr(running, "_of", lambda healthy, t_s: "text")
    frame = Frame(build(SENSOR, {"id": 1}), SENSOR)
    draft = Draft(frame)
    running.edit(draft, "from-vehicle", 2)
    assert draft.sealed() is frame
    assert running.failures == 1
