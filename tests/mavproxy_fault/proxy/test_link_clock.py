"""The link clock: faults of a link at any rate of timestamps, in lockstep, and at live edits."""

from typing import Any

import pytest

from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.compiled.object_file import make
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.edit_log import EditLog
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.sender_rules import link_time, vehicle_time
from mavproxy_fault.proxy.senders import LINK_TIME, SIMULATED, new_senders
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

ROLES = (LinkRole("vehicle", "from-vehicle"), LinkRole("station", "to-vehicle"))
WALL_US = 1_700_000_000_000_000
VEHICLE = 1 << 8 | 1
STEP_US = 10_000  # parameters come at 100 Hz


def message(name: str, **values: Any) -> bytes:
    return build_frame(message_layout(name), values)


def passed(
    fault: dict[str, Any], stamp_every_s: float, seconds: float = 4.0
) -> tuple[list[float], Core]:
    """Arrival and delay of the parameters that pass, between timestamps of a given rate."""
    core = Core(ROLES, Engine(parse_schedule({"seed": 1, "faults": [{"id": "f", **fault}]})))
    sends, stamped_us = [], 0
    for step in range(round(seconds * 1e6 / STEP_US)):
        since_us = step * STEP_US
        if stamp_every_s and since_us >= stamped_us:
            stamp = message("SYSTEM_TIME", time_boot_ms=1000 + since_us // 1000)
            sends += core.received(0, stamp, WALL_US + since_us)
            stamped_us += round(stamp_every_s * 1e6)
        value = message("PARAM_VALUE", param_index=step, param_count=1000)
        sends += core.received(0, value, WALL_US + since_us)
    sends += core.due(WALL_US + round(seconds * 1e6) + 5_000_000)
    values = [send for send in sends if send.data[7:10] == b"\x16\0\0"]
    return [(send.due_us - WALL_US) * 1e-6 for send in values], core


@pytest.mark.parametrize("stamp_every_s", [0, 0.02, 0.25, 1, 10])
def test_a_rate_delay_and_outage_are_the_same_at_any_rate_of_timestamps(
    stamp_every_s: float,
) -> None:
    limit = {"fault": "rate-limit", "value": 200, "target": "PARAM_VALUE", "queue_s": 1}
    times, _ = passed(limit, stamp_every_s)
    assert times == pytest.approx([n * 0.01 for n in range(400)])
    slow, _ = passed({**limit, "value": 50}, stamp_every_s)
    assert len(slow) == 200 + 50  # four seconds, and one of the queue
    times, _ = passed({"fault": "delay", "value": 0.02}, stamp_every_s)
    assert times == pytest.approx([n * 0.01 + 0.02 for n in range(400)])
    times, core = passed({"fault": "outage", "at_s": 1, "for_s": 2}, stamp_every_s)
    assert times == pytest.approx([n * 0.01 for n in (*range(100), *range(300, 400))])
    *_, label = core.drain_labels()
    t0_us = label.t0_us
    assert (label.clock, label.start_us - t0_us, (label.end_us or 0) - t0_us) == (
        "link",
        1_000_000,
        3_000_000,
    )


def test_vehicle_time_is_used_where_an_entry_asks_for_it() -> None:
    times, core = passed({"fault": "drop", "at_s": 2, "clock": "vehicle"}, 10)
    assert len(times) == 400  # its only timestamp is the first
    assert core.drain_labels() == []


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("speed", [0.3, 1.0, 20.0])
def test_a_delay_lasts_its_seconds_of_a_simulator_at_any_speed(
    speed: float, compiled: bool
) -> None:
    entry = {"fault": "delay", "value": 0.1, "target": "HIL_GPS"}
    core = Core(ROLES, Engine(parse_schedule({"seed": 1, "faults": [entry]})))
    if compiled:
        make()
    receive = CompiledCore(core, 0, None).received if compiled else core.received
    late_us, sensor_us = [], 0
    for step in range(200):
        now_us, t_us = WALL_US + round(step * 4000 / speed), 1_000_000 + step * 4000
        raws = [message("HIL_SENSOR", time_usec=t_us, xacc=1)]
        raws += [message("HIL_GPS", time_usec=t_us, fix_type=3)] if step % 10 == 5 else []
        sends = []
        for raw in raws:
            sends += core.due(now_us) + receive(1, raw, now_us)
        for send in sends:
            if send.data[7:10] == b"\x6b\0\0":
                sensor_us = int.from_bytes(send.data[10:18], "little")
            elif send.data[7:10] == b"\x71\0\0":
                late_us.append(sensor_us - int.from_bytes(send.data[10:18], "little"))
    assert len(late_us) > 10
    # Between two samples wall time counts.
    assert all(100_000 - 4000 / min(speed, 1.0) <= one <= 104_000 for one in late_us), late_us


def test_a_delayed_frame_that_a_standing_simulator_waits_for_is_due_by_the_wall() -> None:
    entry = {"fault": "delay", "value": 0.1, "target": "HIL_SENSOR", "at_s": 0.004}
    core = Core(ROLES, Engine(parse_schedule({"seed": 1, "faults": [entry]})))
    for step in range(3):  # the last of them waits
        core.received(1, message("HIL_SENSOR", time_usec=10**6 + step * 4000), WALL_US + step)
    core.received(0, message("PARAM_VALUE"), WALL_US + 50_000)
    assert core.next_due_us == WALL_US + 1 + 100_000 - 3999  # not moved by the parameter


def test_the_link_time_follows_a_clock_that_runs_at_another_speed_and_never_decreases() -> None:
    for speed in (0.5, 10.0):
        senders, before_us = new_senders(), 0
        for step in range(500):
            now_us = WALL_US + step * 20_000
            t_us = vehicle_time(senders, VEHICLE, 1_000_000 + round(step * 20_000 * speed), now_us)
            for later_us in (0, 7_000, 19_000):
                senders[LINK_TIME] = link_time(senders, now_us + later_us)
                assert max(before_us, t_us) <= senders[LINK_TIME] <= t_us + 20_000
                before_us = senders[LINK_TIME]


def test_of_two_vehicles_the_link_time_follows_the_one_whose_clock_is_ahead() -> None:
    senders = new_senders()
    for step in range(100):
        now_us = WALL_US + step * 50_000
        ahead_us = vehicle_time(senders, VEHICLE, 9_000_000 + step * 50_000, now_us)
        vehicle_time(senders, 2 << 8 | 1, 4_000_000 + step * 50_000 + 20_000, now_us + 20_000)
        senders[LINK_TIME] = link_time(senders, now_us + 30_000)
        assert senders[LINK_TIME] == ahead_us + 30_000


def test_a_lockstep_link_stands_still_with_its_simulator() -> None:
    core = Core(ROLES, Engine(parse_schedule("faults: [{fault: outage, at_s: 1, for_s: 1}]")))
    for step in range(30):
        # Each step of a tenth of a second takes the simulator two seconds.
        sensor = message("HIL_SENSOR", time_usec=1_000_000 + step * 100_000)
        sends = core.received(1, sensor, WALL_US + step * 2_000_000)
        sends += core.received(0, message("VFR_HUD"), WALL_US + step * 2_000_000 + 1_900_000)
        assert bool([send for send in sends if send.data != b""]) or 10 <= step < 20
    assert core.senders[SIMULATED]
    labels = core.drain_labels()
    assert [(one.clock, one.start_us, one.end_us) for one in labels if one.end_us] == [
        ("", 2_000_000, 3_000_000)
    ]


def test_an_outage_begun_live_lasts_its_time_between_rare_timestamps() -> None:
    engine = Engine(parse_schedule("faults: []"))
    core, log = Core(ROLES, engine), None
    core.attach(LiveControl(engine))
    log = EditLog(core, CaptureBuffer())
    got = []
    for step in range(600):
        now_us = WALL_US + step * STEP_US
        if step == 0:
            core.received(0, message("SYSTEM_TIME", time_boot_ms=1000), now_us)
        if step == 300:
            engine.advance_time(log.begin(now_us))
            engine.arm({"fault": "outage", "id": "now", "for_s": 1})
        sends = core.received(0, message("PARAM_VALUE", param_index=step), now_us)
        got += [step for send in sends if send.data[7:10] == b"\x16\0\0"]
    assert got == [*range(300), *range(400, 600)]
