import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.subscriptions import LEASE_S, MOST_ROWS, SubscribedMessages, Watched
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout, message_names
from mavproxy_fault.wire.frame import build_frame

LINKS = (LinkRole("simulator", "to-vehicle"), LinkRole("vehicle", "from-vehicle"))


def proxy(faults: str = "") -> tuple[Core, LiveControl]:
    control = LiveControl(Engine(parse_schedule(f"faults: [{faults}]")))
    return Core(LINKS, control.engine, control=control), control


def fly(core: Core, frames: int, step_us: int = 4000, **values: float) -> None:
    """HIL_SENSOR frames from 1 s on."""
    for number in range(frames):
        t_us = 1_000_000 + number * step_us
        stamped = {"time_usec": t_us, "xgyro": 0.5, **values}
        core.received(
            0,
            build_frame(message_layout("HIL_SENSOR"), stamped, seq=number & 0xFF),
            9_000_000 + t_us,
        )


def column(samples: Watched, name: str, *, sent: bool) -> list[tuple[float, float]]:
    place = samples.fields.index(name) + 1
    rows = samples.sent if sent else samples.received
    assert rows is not None
    return [(row[0] / 1e6, row[place]) for row in rows]


def test_a_faulted_field_is_sampled_as_received_and_as_sent() -> None:
    core, control = proxy("{fault: bias, target: HIL_SENSOR.xgyro, value: 0.25, at_s: 0.02}")
    control.watch(b'["HIL_SENSOR"]', 0.0)
    fly(core, 10)
    (samples,) = control.watched(0.0)
    assert (samples.message, samples.instance) == ("HIL_SENSOR", 0)
    assert column(samples, "xgyro", sent=False) == [(1.0, 0.5), (1.02, 0.5)]
    assert column(samples, "xgyro", sent=True) == [(1.0, 0.5), (1.02, 0.75)]


def test_unchanged_values_are_sent_once() -> None:
    core, control = proxy()
    control.watch(b'["HIL_SENSOR"]', 0.0)
    fly(core, 10)
    (samples,) = control.watched(0.0)
    assert len(samples.received) == 2
    assert samples.sent is None


def test_a_message_without_a_stamp_is_not_shown_as_changed() -> None:
    core, control = proxy()
    control.watch(b'["SYS_STATUS"]', 0.0)
    core.received(1, build_frame(message_layout("ATTITUDE"), {"time_boot_ms": 1000}), 9_000_000)
    status = build_frame(message_layout("SYS_STATUS"), {"voltage_battery": 12000}, seq=1)
    core.received(1, status, 9_003_000)  # 3 ms after the newest stamp
    (samples,) = control.watched(0.0)
    assert (len(samples.received), samples.sent) == (1, None)


def test_a_dropped_frame_is_sampled_as_received_only() -> None:
    core, control = proxy("{fault: drop, target: HIL_SENSOR}")
    control.watch(b'["HIL_SENSOR"]', 0.0)
    fly(core, 10)
    (samples,) = control.watched(0.0)
    assert (len(samples.received), samples.sent) == (2, [])


def test_sensors_of_one_message_are_separate() -> None:
    core, control = proxy()
    control.watch(b'["HIL_SENSOR"]', 0.0)
    fly(core, 1, id=0)
    fly(core, 1, id=1)
    assert [samples.instance for samples in control.watched(0.0)] == [0, 1]


def test_a_subscription_expires() -> None:
    core, control = proxy()
    before = control.wanted
    control.watch(b'["HIL_STATE_QUATERNION"]', 0.0)
    assert message_layout("HIL_STATE_QUATERNION").id in control.wanted
    control.watched(LEASE_S + 0.1)
    assert control.wanted == before
    fly(core, 10)
    assert control.watched(LEASE_S + 0.1) == []


def test_unread_samples_are_bounded() -> None:
    core, control = proxy()
    control.watch(b'["HIL_SENSOR"]', 0.0)
    fly(core, MOST_ROWS + 20, step_us=20_000)
    assert len(control.watched(0.0)[0].received) == MOST_ROWS


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b'["HIL_SENSORS"]', "HIL_SENSORS is not a message; did you mean HIL_SENSOR"),
        (b"{}", "send a JSON list of message names"),
    ],
)
def test_a_wrong_subscription_is_refused(payload: bytes, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        proxy()[1].watch(payload, 0.0)


def test_too_many_messages_are_refused() -> None:
    control = proxy()[1]
    with pytest.raises(ConfigError, match="are too many"):
        control.view.watch(message_names()[:40], 0.0)


def test_sent_bytes_that_begin_no_frame_are_not_sampled() -> None:
    view = SubscribedMessages()
    view.watch(["ATTITUDE"], 0.0)
    # Where a frame of MAVLink 1 has its message id.
    view.sent(bytes((0, 28, 0, 1, 1, message_layout("ATTITUDE").id)) + bytes(30), 1)
    assert view.drain() == []


def test_a_satellite_range_is_sampled_before_and_after() -> None:
    core, control = proxy("{fault: bias, target: PSEUDORANGE.G07, value: 50}")
    control.watch(b'["PSEUDORANGE"]', 0.0)
    names, ranges_m = ("E05", "G07", "G12"), [2.3e7, 2.1e7, 2.2e7]
    zeros = [0.0, 0.0, 0.0]
    for sequence, message in enumerate(encode_epoch(1000.0, names, ranges_m, zeros, zeros)):
        for raw in tunnel_frames(message, sequence):
            core.received(0, raw, 9_000_000)
    (samples,) = control.watched(0.0)
    assert samples.fields == names
    (came,), (left,) = samples.received, samples.sent or []
    added_m = [round(after - before, 1) for before, after in zip(came[1:], left[1:], strict=True)]
    assert added_m == [0.0, 50.0, 0.0]
