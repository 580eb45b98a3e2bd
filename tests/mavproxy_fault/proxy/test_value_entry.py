"""The fast path of value faults for a single float, compared with the general path."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.fault_parts.draft import Draft
from mavproxy_fault.fault_parts.value_fault import MOST_ROWS, MOST_SENDERS
from mavproxy_fault.faults.delayed_values import Lag
from mavproxy_fault.faults.freeze import Replay
from mavproxy_fault.faults.profile_faults import Bias
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.value_entry import NO_FLOAT_INDEX, ActiveValueEntry
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import FLOAT_MAX, Frame, build_frame

SENSOR = message_layout("HIL_SENSOR")
# All edge cases of a float: zeros of both signs, subnormal, the limits, NaN.
EDGES = [0.0, -0.0, 1e-45, -1e-45, 1e-300, FLOAT_MAX, -FLOAT_MAX, 1e300, float("inf"), float("nan")]
singles = st.binary(min_size=4, max_size=4) | st.sampled_from(EDGES[:7]).map(
    lambda x: struct.pack("<f", x)
)
numbers = st.floats() | st.sampled_from(EDGES) | st.floats(width=32)


def at_work(fault: str, value: float, *, short: bool) -> ActiveValueEntry:
    entry = {"fault": fault, "target": "HIL_SENSOR.ygyro", "value": value}
    running = ActiveValueEntry(parse_schedule({"faults": [entry]}).faults[0], 1, 0, 0)
    assert running._floats[SENSOR.id] < NO_FLOAT_INDEX
    if not short:
        running._floats = {SENSOR.id: NO_FLOAT_INDEX}
    running.begin()
    return running


@given(singles, numbers, st.sampled_from(["bias", "scale", "constant", "saturate", "dead-band"]))
def test_the_fast_path_gives_the_bytes_and_counts_of_the_general_one(
    healthy: bytes, value: float, fault: str
) -> None:
    if not abs(value) <= FLOAT_MAX or fault not in ("bias", "scale", "constant"):
        value = abs(value) if abs(value) < 1e308 else 1e39
    frame = Frame(build_frame(SENSOR, {"time_usec": 1, "id": 1}), SENSOR)
    payload = bytearray(frame.payload)
    start = SENSOR.fields["ygyro"].offset
    payload[start : start + 4] = healthy
    frame = frame.with_payload(bytes(payload))
    outcomes = []
    for short in (True, False):
        running, draft = at_work(fault, value, short=short), Draft(frame)
        for t_us in (5, 6):  # with the state left by the first, too
            running.edit(draft, "from-vehicle", t_us)
        left = draft.sealed()
        label = running.close(9)
        outcomes.append((left.raw, left is frame, label))
    assert outcomes[0] == outcomes[1]


def test_a_live_value_acts_on_the_next_frame() -> None:
    running = at_work("bias", 1.0, short=True)
    running.set_value(3.0, 1, None)
    draft = Draft(Frame(build_frame(SENSOR, {"id": 1}), SENSOR))
    running.edit(draft, "from-vehicle", 2)
    assert draft.sealed().number("ygyro") == 3.0


def test_an_overridden_rule_is_used_whatever_its_base_class() -> None:
    class Odd(Bias, frozen=True, kw_only=True):
        def after(self, before, key, t_s, state, rng):  # type: ignore[no-untyped-def]
            return [7.0], state

    assert Bias(value=1.0).by_value
    assert not Odd(value=1.0).by_value
    assert not Bias(value=(1.0, 2.0)).by_value


def test_a_frame_passes_if_a_rule_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    running = at_work("bias", 1.0, short=True)
    monkeypatch.setattr(running, "_of", lambda healthy, t_s: "text")
    frame = Frame(build_frame(SENSOR, {"id": 1}), SENSOR)
    draft = Draft(frame)
    running.edit(draft, "from-vehicle", 2)
    assert draft.sealed() is frame
    assert running.failures == 1


REMEMBERING = [name for name, kind in known_faults().items() if getattr(kind, "by_sender", False)]


@pytest.mark.parametrize("name", sorted(set(REMEMBERING) - {"bit-flip"}))
def test_a_fault_stores_only_the_first_of_many_invented_senders(name: str) -> None:
    entry = {"fault": name, **known_faults()[name].example, "target": "HIL_SENSOR.xgyro"}
    engine = Engine(parse_schedule({"faults": [entry]}))
    for sender in range(2 * MOST_SENDERS):
        data = build_frame(SENSOR, {"id": 1}, system=1 + sender // 200, component=sender % 200)
        [out] = engine.apply(Frame(data, SENSOR), "from-vehicle", 1)
        assert isinstance(out.frame, Frame)
    [running] = engine._all
    assert len(running.states["from-vehicle"].inner) == MOST_SENDERS
    assert not running.failures


@pytest.mark.parametrize("fault", [Lag(value=60.0), Replay(value=60.0)])
def test_the_cost_of_past_values_does_not_grow_with_their_number(fault: Lag | Replay) -> None:
    state = None
    for n in range(MOST_ROWS + 9):  # the clock stands still
        _, state = fault.after([n], (1, 1), 0.0, state, None)
        if n == 9:
            began = state[1, 1][0]
    assert state is not None
    rows = state[1, 1][0]
    assert rows is began  # never copied
    assert MOST_ROWS <= len(rows) < MOST_ROWS + 10


def test_a_lag_releases_older_values() -> None:
    lag, state = Lag(value=0.1), None
    for n in range(10_000):
        after, state = lag.after([n], (1, 1), n / 1000, state, None)
        assert after == [max(n - 100, 0)]
    assert state is not None
    assert len(state[1, 1][0]) < 400
