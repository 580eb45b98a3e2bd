"""Entries of value faults: live values, failing rules, and what they remember."""

import pytest

from mavproxy_fault.fault_parts.value_fault import MOST_ROWS, MOST_SENDERS
from mavproxy_fault.faults.delayed_values import Lag, Replay
from mavproxy_fault.faults.profile_faults import Bias
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.active_entry import ActiveEntry
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

SENSOR = message_layout("HIL_SENSOR")


def at_work(fault: str, value: float) -> ActiveEntry:
    entry = {"fault": fault, "target": "HIL_SENSOR.ygyro", "value": value}
    running = ActiveEntry(parse_schedule({"faults": [entry]}).faults[0], 1, 0, 0)
    running.begin()
    return running


def test_a_live_value_acts_on_the_next_frame() -> None:
    running = at_work("bias", 1.0)
    running.set_value(3.0, 1, None)
    [out] = running.act(Frame(build_frame(SENSOR, {"id": 1}), SENSOR), "from-vehicle", 2)
    assert isinstance(out.frame, Frame)
    assert out.frame.number("ygyro") == 3.0


def test_a_frame_passes_if_a_rule_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    running = at_work("bias", 1.0)
    monkeypatch.setattr(Bias, "numbers", lambda self, count: [()] * count)
    frame = Frame(build_frame(SENSOR, {"id": 1}), SENSOR)
    [out] = running.act(frame, "from-vehicle", 2)
    assert out.frame is frame
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
def test_the_number_of_past_values_is_bounded(fault: Lag | Replay) -> None:
    state = None
    for n in range(MOST_ROWS + 9):  # the clock stands still
        [value], state = fault.after([n], (1, 1), 0.0, state, None)
    assert value == (9 if isinstance(fault, Lag) else 8)


def test_a_lag_releases_older_values() -> None:
    lag, state = Lag(value=0.1), None
    for n in range(10_000):
        after, state = lag.after([n], (1, 1), n / 1000, state, None)
        assert after == [max(n - 100, 0)]
