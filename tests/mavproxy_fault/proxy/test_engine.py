import time

import msgspec
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.profile_faults import Bias
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.interfaces import ANY
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.plant_messages import plant_change

DT_US = 4000


def sensor(t_us: int, **values: float) -> Frame:
    layout = message_layout("HIL_SENSOR")
    fields = {"time_usec": t_us, "xgyro": 0.5, "zacc": -9.81, "fields_updated": 0x1FFF, **values}
    return Frame(build_frame(layout, fields, component=51), layout)


def engine(text: str) -> Engine:
    return Engine(parse_schedule("seed: 1\nfaults:\n" + text))


def run(it: Engine, seconds: float, start_us: int = 1_000_000, **values: float) -> list[tuple]:
    """(seconds since the start, xgyro as sent or None, due later by us) for each frame sent."""
    found = []
    for i in range(round(seconds * 250)):
        t_us = start_us + i * DT_US
        for out in it.apply(sensor(t_us, **values), "to-vehicle", t_us):
            assert isinstance(out.frame, Frame)
            found.append((round(i * DT_US * 1e-6, 6), out.frame.number("xgyro"), out.due_us - t_us))
    return found


BIAS = """
  - {id: step, fault: bias, target: HIL_SENSOR.xgyro, value: 0.25, at_s: 0.1, for_s: 0.2}
"""


def test_a_bias_acts_from_its_start_until_its_end_and_no_longer():
    sent = run(engine(BIAS), 0.5)
    assert [x for t, x, _ in sent if t < 0.1 or t >= 0.3] == [0.5] * 75
    assert [x for t, x, _ in sent if 0.1 <= t < 0.3] == [0.75] * 50


def test_an_untouched_frame_is_the_same_object():
    it = engine(BIAS)
    frame = sensor(1_000_000)
    (out,) = it.apply(frame, "to-vehicle", 1_000_000)
    assert out.frame is frame
    assert out.due_us == 1_000_000


def test_the_label_reports_the_actual_not_the_planned_effect():
    it = engine(BIAS)
    run(it, 0.5)
    opened, closed = it.drain_labels()
    assert (opened.start_us, opened.end_us, opened.frames) == (1_100_000, None, 1)
    assert (closed.start_us, closed.end_us, closed.frames) == (1_100_000, 1_300_000, 50)
    assert closed.magnitude == pytest.approx(0.25)
    assert closed.t0_us == 1_000_000
    assert closed.targets == ("HIL_SENSOR.xgyro",)
    assert closed.parameters == {"value": 0.25}


def test_a_label_names_both_ways_of_a_fault_that_cut_both():
    it = engine("  - {id: cut, fault: drop, target: HIL_SENSOR, at_s: 0, for_s: 1}\n")
    ways = ["to-vehicle", "to-vehicle", "from-vehicle"]
    for i, way in enumerate(ways):
        it.apply(sensor(1_000_000 + i), way, 1_000_000 + i)
    opened, closed = [*it.drain_labels(), *it.finish(1_000_003)]
    assert (opened.direction, closed.direction) == ("to-vehicle", "both")


def test_a_fault_that_matches_no_frame_writes_no_label():
    it = engine("  - {fault: bias, target: HIL_GPS.alt, value: 5, at_s: 0.1, for_s: 0.2}")
    run(it, 0.5)
    assert it.finish(2_000_000) == []


def test_a_fault_still_active_at_the_end_gets_its_label_closed():
    it = engine("  - {fault: bias, target: HIL_SENSOR.xgyro, value: 5}")
    run(it, 0.1)
    it.drain_labels()
    (label,) = it.finish(1_096_000)
    assert (label.end_us, label.frames) == (1_096_000, 25)


def test_the_label_counts_values_that_did_not_fit():
    it = engine("  - {fault: bias, target: HIL_SENSOR.fields_updated, value: -1e6}")
    run(it, 0.02)
    (label,) = it.finish(2_000_000)[-1:]
    assert (label.saturated, label.frames) == (5, 5)
    assert label.magnitude == 0x1FFF


def test_only_messages_of_the_schedule_are_wanted():
    it = engine(BIAS)
    assert it.wanted is None  # until the first frame has set the time
    it.start_at(0)
    assert it.wanted == {message_layout("HIL_SENSOR").id}
    it.arm({"id": "all", "fault": "drop"})
    assert it.wanted is None


def test_where_selects_component_direction_and_instance():
    it = engine("""
  - {fault: drop, where: {component: 51, direction: to-vehicle, id: 2}}
""")
    assert len(it.apply(sensor(1, id=0), "to-vehicle", 1)) == 1
    assert len(it.apply(sensor(2, id=2), "to-vehicle", 2)) == 0
    assert len(it.apply(sensor(3, id=2), "from-vehicle", 3)) == 1


def test_probability_thins_out_a_fault():
    it = engine("  - {fault: bias, target: HIL_SENSOR.xgyro, value: 1, probability: 0.3}")
    hit = sum(x > 1 for _, x, _ in run(it, 4))
    assert abs(hit - 300) < 4 * (1000 * 0.3 * 0.7) ** 0.5  # binomial, four sigma


def test_delays_of_two_entries_add_up_and_order_is_that_of_the_schedule():
    it = engine("""
  - {id: a, fault: delay, value: 0.05}
  - {id: b, fault: bias, target: HIL_SENSOR.xgyro, value: 1}
  - {id: c, fault: scale, target: HIL_SENSOR.xgyro, value: 2}
  - {id: d, fault: delay, value: 0.02}
""")
    assert run(it, 0.02) == [(round(i * DT_US * 1e-6, 6), 3.0, 70_000) for i in range(5)]


def test_a_sealed_frame_passes_value_faults_and_is_counted():
    it = engine(BIAS.replace("at_s: 0.1", "at_s: 0"))
    frame = sensor(1)
    (out,) = it.apply(frame, "to-vehicle", 1, sealed=True)
    assert out.frame is frame
    assert it.state()["faults"][0]["signed_skipped"] == 1


def test_a_fault_repeats():
    it = engine("""
  - {fault: bias, target: HIL_SENSOR.xgyro, value: 1, at_s: 0.1, for_s: 0.04,
     repeat: {every_s: 0.1, times: 3}}
""")
    struck = [t for t, x, _ in run(it, 0.8) if x > 1]
    assert struck == [round(s + i * 0.004, 3) for s in (0.1, 0.2, 0.3) for i in range(10)]
    assert [label.frames for label in it.drain_labels() if label.end_us] == [10, 10, 10]


def test_a_time_jump_does_not_trigger_all_missed_repetitions():
    it = engine("""
  - {fault: bias, target: HIL_SENSOR.xgyro, value: 1, for_s: 0.04, repeat: {every_s: 0.1}}
""")
    it.apply(sensor(0), "to-vehicle", 0)
    it.apply(sensor(10**17), "to-vehicle", 10**17)
    assert it.state()["faults"][0]["start_us"] > 10**17 - 10**6


def test_a_fault_follows_the_end_of_another():
    it = engine(
        BIAS
        + """
  - {id: next, fault: constant, target: HIL_SENSOR.xgyro, value: 9, for_s: 0.02,
     after: {id: step, delay_s: 0.05}}
"""
    )
    assert [t for t, x, _ in run(it, 0.6) if x == 9] == [0.352, 0.356, 0.36, 0.364, 0.368]


def test_junk_passes_an_outage_only_outside_it():
    it = engine("  - {fault: drop, at_s: 1, for_s: 1}")
    it.start_at(0)
    assert [out.frame for out in it.junk(b"x", "to-vehicle", 500_000, ANY)] == [b"x"]
    assert it.junk(b"x", "to-vehicle", 1_500_000, ANY) == []
    assert [out.frame for out in it.junk(b"x", "to-vehicle", 2_500_000, ANY)] == [b"x"]


def test_a_live_fault_starts_when_armed_and_can_be_changed_and_cleared():
    it = engine(BIAS)
    run(it, 0.5)
    it.arm({"id": "live", "fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 1})
    assert run(it, 0.004, 1_500_000)[0][1] == 1.5
    it.update("live", 2)
    assert run(it, 0.004, 1_504_000)[0][1] == 2.5
    assert it.clear("live")
    assert run(it, 0.004, 1_508_000)[0][1] == 0.5
    assert it.drain_labels()[-1].parameters == {"value": 2}
    assert not it.clear("live")


def test_an_invalid_live_edit_changes_nothing():
    it = engine(BIAS)
    with pytest.raises(ConfigError, match="step waits for the vehicle's first timestamp"):
        it.update("step", 1)
    it.start_at(0)
    with pytest.raises(ConfigError, match="did you mean bias"):
        it.arm({"fault": "bais", "target": "HIL_SENSOR.xgyro", "value": 1})
    with pytest.raises(ConfigError, match="is not a fault"):
        it.update("stepp", 1)
    assert it.ids() == ["step"]


def test_entries_kept_in_a_new_schedule_continue_undisturbed():
    text = "seed: 1\nfaults:\n  - {id: hold, fault: freeze, target: HIL_SENSOR.xgyro}\n"
    it = Engine(parse_schedule(text))
    run(it, 0.004)
    it.replace(parse_schedule(text + BIAS))
    assert run(it, 0.004, 1_004_000, xgyro=0.9)[0][1] == 0.5


def test_a_restarted_schedule_counts_its_times_from_now():
    it = engine(BIAS)
    run(it, 0.5)  # it is over
    it.replace(parse_schedule("faults:\n" + BIAS), anew=True)
    again = run(it, 0.5, 1_500_000)
    # The edit counts from the newest frame, one step before.
    assert [t for t, x, _ in again if x == 0.75] == [round(0.096 + 0.004 * i, 6) for i in range(50)]


def test_a_saved_and_reloaded_schedule_does_not_disturb_active_faults():
    it = engine(BIAS)
    run(it, 0.15)
    it.arm({"id": "live", "fault": "freeze", "target": "HIL_SENSOR.ygyro"})
    run(it, 0.05, 1_150_000, ygyro=0.25)
    it.replace(parse_schedule(it.save()))
    assert it.active == ["step", "live"]
    assert run(it, 0.004, 1_200_000)[0][1] == 0.75
    assert not any(label.end_us for label in it.drain_labels())


def test_a_schedule_saved_for_a_restart_counts_from_its_first_entry():
    it = Engine(Schedule(1))
    run(it, 0.2)
    it.arm({"id": "a", "fault": "noise", "target": "HIL_SENSOR.ygyro", "value": 1})
    run(it, 0.1, 1_200_000)
    it.arm({"id": "b", "fault": "noise", "target": "HIL_SENSOR.xgyro", "value": 1, "at_s": 5})
    assert [e.at_s for e in parse_schedule(it.save()).faults] == [0.196, 5.296]
    assert [e.at_s for e in parse_schedule(it.save(anew=True)).faults] == [0.0, 5.1]


def test_a_saved_schedule_reads_back_and_does_the_same():
    it = engine(BIAS)
    run(it, 0.2)
    it.arm({"id": "live", "fault": "noise", "target": "HIL_SENSOR.ygyro", "value": 1})
    again = parse_schedule(it.save())
    assert [(e.id, e.at_s, e.for_s) for e in again.faults] == [
        ("step", 0.1, 0.2),
        ("live", 0.196, None),
    ]


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_preset_of_several_parts_is_saved_once(seconds: float) -> None:
    it = engine("  - {id: blow, preset: imu-impulse, at_s: 0.1, for_s: 3}")
    run(it, seconds)
    again = parse_schedule(it.save())
    assert [e.id for e in again.faults] == ["blow.1", "blow.2"]


def test_streamed_values_act_until_they_are_stale():
    it = engine("""
  - {id: s, fault: bias, target: HIL_SENSOR.xgyro, profile: {live: {timeout_s: 0.02}}}
""")
    assert run(it, 0.004)[0][1] == 0.5
    it.update("s", 0.25, latency_us=1000)
    values = [x for _, x, _ in run(it, 0.04, 1_004_000)]
    assert values == [0.75] * 5 + [0.5] * 5
    assert it.state()["faults"][0]["latency_us"] == 1000
    with pytest.raises(ConfigError, match="refused"):
        it.update("s", 0.25, latency_us=40_000)


def test_the_same_seed_gives_the_same_bytes_and_another_entry_does_not_change_them():
    noise = "  - {id: n, fault: noise, target: HIL_SENSOR.xgyro, value: 1}\n"
    other = "  - {id: m, fault: noise, target: HIL_SENSOR.ygyro, value: 1}\n"
    assert run(engine(noise), 0.1) == run(engine(other + noise), 0.1)


def test_an_invalid_value_of_a_fault_is_refused():
    it = engine("  - {id: lost, fault: drop, value: 0.5}")
    it.start_at(0)
    with pytest.raises(ConfigError, match="lost = 5"):
        it.update("lost", 5)
    it.update("lost", 1)
    assert it.apply(sensor(1), "to-vehicle", 1) == []


def test_plant_parameters_and_satellites_accept_streamed_and_changed_values():
    it = engine("""
  - {id: wind, fault: plant, target: PLANT.wind_n_mps, profile: {live: {timeout_s: 1}}}
  - {id: range, fault: bias, target: PSEUDORANGE.G12, value: 5, via: simulator}
""")
    it.start_at(0)
    it.update("wind", 3)
    it.update("range", 8)
    changes = [plant_change(out.frame) for out in it.apply(sensor(1), "to-vehicle", 1) if out.back]
    assert {change.name: change.value for change in changes} == {
        "wind_n_mps": 3,
        "pseudorange_m[G12]": 8,
    }


def test_a_value_changed_during_a_fault_gets_a_label() -> None:
    it = engine("  - {id: b, fault: bias, target: HIL_SENSOR.xgyro, value: 1}\n")
    said = []
    for number in range(100):  # a second of frames, a new value at each
        t_us = 1_000_000 + number * 10_000
        it.apply(sensor(t_us), "to-vehicle", t_us)
        it.update("b", number + 1.5)
        said += it.drain_labels()
    (done,) = it.finish(2_000_000)
    assert [label.value for label in said] == [None, 20.5, 40.5, 60.5, 80.5]
    assert (done.value, done.start_us, done.frames) == (100.5, said[0].start_us, 100)


def test_foreign_bytes_after_a_timestamp_far_ahead_cost_no_more_than_a_frame() -> None:
    it = engine("""
  - {id: again, fault: bias, target: HIL_SENSOR.xgyro, value: 1, for_s: 0.01,
     repeat: {every_s: 0.02}}
""")
    steps = []
    follow = it._start_dependents
    it._start_dependents = lambda *given: (steps.append(given), follow(*given))[1]  # type: ignore[method-assign]
    it.apply(sensor(1_000_000), "to-vehicle", 1_000_000)
    it.junk(b"x", "to-vehicle", 10**15 - 1, ANY)
    it.apply(sensor(10**15), "to-vehicle", 10**15 + 7_000_000)
    assert len(steps) < 20


@pytest.mark.parametrize("seconds", [float("inf"), 1e300, 1e15])
def test_an_unreachable_time_never_comes(seconds: float) -> None:
    entry = parse_schedule("faults: [{id: a, fault: drop, target: HIL_SENSOR}]").faults[0]
    it = engine(BIAS)
    run(it, 0.1)
    it.arm(msgspec.structs.replace(entry, at_s=seconds))
    it.arm(msgspec.structs.replace(entry, id="b", for_s=seconds))
    assert len(run(it, 0.1, 2_000_000)) == 0
    assert it.active == ["b"]


def test_ended_injected_faults_are_removed_after_a_while() -> None:
    it = engine(BIAS)
    for n in range(100):
        it.arm({"id": f"live-{n}", "fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 1,
                "for_s": 0.004})  # fmt: skip
        run(it, 0.02, 1_000_000 + n * 20_000)
    assert "step" in it.ids()
    assert len(it.ids()) < 40
    assert it.ids()[-1] == "live-99"


def test_a_failing_fault_is_reported_and_the_frame_passes(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Bias, frozen=True, kw_only=True):
        def after(self, *_: object) -> tuple[list[float], None]:
            raise RuntimeError("a bug in a plugin fault")

    entry = parse_schedule(f"faults: [{BIAS.strip()[2:]}]").faults[0]
    it = Engine(Schedule(1, (msgspec.structs.replace(
        entry, at_s=0.0, fault=Broken(elements=entry.fault.elements, value=1.0)),)))  # fmt: skip
    frame = sensor(1_000_000)
    for _ in range(3):
        (out,) = it.apply(frame, "to-vehicle", 1_000_000)
        assert out.frame is frame
    (fault,) = it.state()["faults"]
    assert (fault["failures"], fault["frames"]) == (3, 0)
    assert len(caplog.records) == 1


def test_a_fault_does_not_overflow_when_its_clock_goes_far_back() -> None:
    it = engine("""
  - {id: float, fault: float, target: HIL_SENSOR.xgyro, settle_s: 0.05}
""")
    it.apply(sensor(10**9), "to-vehicle", 10**9)
    it.apply(sensor(10**9), "to-vehicle", 10**6)
    assert it.state()["faults"][0]["failures"] == 0


def test_a_schedule_of_a_thousand_entries_costs_ten_times_one_of_a_hundred() -> None:
    # All times are in the past: every entry begins and ends within the edit.
    few, many = (loading_s(count) for count in (100, 1000))
    assert many < 40 * few  # a linear search for each entry would take 100 times more


def loading_s(count: int) -> float:
    """The least of several processor times of an edit that loads another schedule."""
    engine = Engine(parse_schedule("faults: []"))
    engine.start_at(0)
    engine.advance_time(10**9)
    times = []
    for number in range(3):
        schedule = parse_schedule(
            "faults:\n" + "".join(
                f"  - {{id: s{number}-{n}, fault: bias, target: ATTITUDE.roll, value: 1, "
                f"at_s: {n / 100}, for_s: 0.005}}\n"
                for n in range(count)
            )
        )  # fmt: skip
        begun_s = time.thread_time()
        engine.replace(schedule)
        times.append(time.thread_time() - begun_s)
    assert all(one["state"] == "done" for one in engine.state()["faults"])
    return min(times)


def test_entries_prepared_ahead_equal_those_of_the_edit() -> None:
    schedule = parse_schedule("""
faults:
  - {id: over, fault: bias, target: ATTITUDE.roll, value: 1, at_s: 1, for_s: 1}
  - {id: leads, fault: bias, target: ATTITUDE.roll, value: 1, at_s: 2, for_s: 1}
  - {id: follows, fault: bias, target: ATTITUDE.yaw, value: 1, after: {id: leads, delay_s: 2}}
  - {id: again, fault: bias, target: ATTITUDE.roll, value: 1, for_s: 1, repeat: {every_s: 3}}
  - {id: acts, fault: bias, target: ATTITUDE.pitch, value: 1, at_s: 3}
  - {id: waits, fault: bias, target: ATTITUDE.pitch, value: 1, at_s: 30, for_s: 1}
""")
    states = []
    for beforehand in (False, True):
        engine = Engine(parse_schedule("faults: []"))
        engine.start_at(0)
        engine.advance_time(10_000_000)
        prepared = engine.prepare_entries(schedule) if beforehand else None
        engine.replace(schedule, prepared=prepared)
        states.append((engine.state(), engine.edges_us, engine.active))
    assert states[0] == states[1]
    assert states[0][2] == ["follows", "acts"]
