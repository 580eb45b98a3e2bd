import numpy as np
import pytest

from analysis.autopilots.ardupilot import ardupilot_process
from analysis.autopilots.flight_operator import OPERATOR_PERIOD_US, Operator, Phase
from analysis.autopilots.flight_plan import FlightPlan
from analysis.autopilots.operator_commands import OperatorCommands
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.autopilot.mission_service import Missions
from simvehicle.guidance.waypoints import Waypoint

SECOND_US = 1_000_000
WAYPOINTS = (Waypoint(47.4, 8.5, 20.0, 6.0), Waypoint(47.401, 8.5, 25.0, 6.0))


def frame(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


READY = frame("EKF_STATUS_REPORT", flags=0x33F)
LOST = frame("EKF_STATUS_REPORT", flags=0xA7)


def names(frames):
    return [item.layout.name for item in decoded(frames)]


def decoded(frames):
    found = Parser().push(b"".join(frames))
    assert all(isinstance(item, Frame) for item in found)
    return found


def commands(frames):
    return [
        (int(item.number("command")), item.number("param2"))
        for item in decoded(frames)
        if item.layout.name == "COMMAND_LONG"
    ]


def operator(plan):
    modes = ardupilot_process.MODES["multirotor"]
    return Operator(plan, OperatorCommands(modes, plan.waypoints))


class Autopilot:
    """An autopilot that follows the operator, second by second."""

    def __init__(self, operator):
        self.operator, self.t_us = operator, 0

    def second(self, *frames, on_ground=False):
        self.t_us += SECOND_US
        for one in frames:
            self.operator.receive(one)
        return self.operator.step(self.t_us, on_ground=on_ground)

    def settle(self):
        """Step until the position has settled; return the frames then sent."""
        while self.operator.phase is Phase.WAITING:
            frames = self.second(READY)
        return frames

    def commanded(self):
        """Step until the operator sends commands; return those."""
        while not (sent := commands(self.second())):
            pass
        return sent

    def rest(self):
        """Be disarmed on the ground until that counts as landed."""
        for _ in range(3):
            self.second(frame("HEARTBEAT", base_mode=81), on_ground=True)

    def up_to(self, phase):
        self.settle()
        if phase is Phase.ARMING:
            return
        self.second(frame("HEARTBEAT", base_mode=217))
        if phase is Phase.CLIMBING:
            return
        self.second(frame("GLOBAL_POSITION_INT", relative_alt=9_500))


def test_the_vehicle_is_not_armed_before_the_estimator_has_a_position():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    assert names(autopilot.second(LOST)) == ["HEARTBEAT"]
    assert autopilot.operator.phase is Phase.WAITING
    autopilot.settle()
    assert autopilot.commanded() == [(176, 4.0), (400, 0.0)]


def test_the_vehicle_is_armed_at_a_multiple_of_ten_seconds_however_soon_it_was_ready():
    for late in range(1, 10):
        autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
        for _ in range(late):
            autopilot.second(LOST)
        autopilot.settle()
        autopilot.commanded()
        assert autopilot.t_us == 20 * SECOND_US


def test_the_position_must_be_settled():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    for _ in range(3):
        for _ in range(8):
            autopilot.second(READY)
        autopilot.second(LOST)
    assert autopilot.operator.phase is Phase.WAITING
    begun_us = autopilot.t_us
    autopilot.settle()
    assert 10 * SECOND_US <= autopilot.t_us - begun_us <= 11 * SECOND_US


def test_the_vehicle_is_not_armed_before_the_autopilot_has_started():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    for second in range(1, 60):
        autopilot.operator.receive(READY)
        autopilot.operator.step(second * SECOND_US, started=False)
        assert autopilot.operator.phase is Phase.WAITING
    autopilot.operator.step(60 * SECOND_US)
    assert autopilot.operator.phase is Phase.ARMING


@pytest.mark.parametrize(("mav_type", "ends"), [(1, True), (2, False), (13, False), (0, False)])
def test_an_autopilot_for_another_kind_of_vehicle_is_reported(mav_type, ends):
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0, kind="multirotor")))
    autopilot.second(frame("HEARTBEAT", type=mav_type))
    reason = autopilot.operator.failure
    assert ("reports a fixedwing, but the scenario's vehicle is a multirotor" in reason) == ends


def test_the_timeouts_do_not_include_a_slow_start_of_the_autopilot():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    for second in range(1, 230):
        autopilot.operator.receive(READY)
        autopilot.operator.step(second * SECOND_US, started=False)
    assert not autopilot.operator.failure
    autopilot.operator.step(230 * SECOND_US)
    assert autopilot.operator.phase is Phase.ARMING


def test_unanswered_commands_are_repeated_every_second():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.ARMING)
    assert commands(autopilot.operator.step(autopilot.t_us + 500_000)) == []
    assert commands(autopilot.second()) == [(176, 4.0), (400, 0.0)]


def test_a_hover_takes_off_waits_and_lands():
    autopilot = Autopilot(operator(FlightPlan(10.0, 3.0)))
    autopilot.up_to(Phase.FLYING)
    assert autopilot.operator.phase is Phase.FLYING
    frames = [autopilot.second() for _ in range(3)]
    assert autopilot.operator.phase is Phase.LANDING
    assert commands(frames[-1]) == [(176, 9.0)]
    autopilot.rest()
    assert autopilot.operator.phase is Phase.LANDED
    assert autopilot.operator.finished
    assert not autopilot.operator.failure


def test_a_vehicle_that_is_disarmed_in_the_air_has_not_landed_before_it_fell():
    autopilot = Autopilot(operator(FlightPlan(10.0, 300.0)))
    autopilot.up_to(Phase.FLYING)
    for _ in range(9):
        autopilot.second(frame("HEARTBEAT", base_mode=81))
    assert not autopilot.operator.finished
    autopilot.rest()
    assert autopilot.operator.finished


def test_flight_events_are_recorded():
    autopilot = Autopilot(operator(FlightPlan(10.0, 3.0)))
    autopilot.up_to(Phase.FLYING)
    autopilot.second(frame("MISSION_ITEM_REACHED", seq=2))
    events = autopilot.operator.events_us
    # each is recorded at the time of the operator's latest step
    assert events["take-off"] == events["arming"] + 1 * SECOND_US
    assert events["mission-item:2"] == events["arming"] + 2 * SECOND_US


def test_a_mission_is_uploaded_item_by_item_and_flown():
    autopilot = Autopilot(operator(FlightPlan(20.0, 60.0, WAYPOINTS)))
    (count,) = [one for one in decoded(autopilot.settle()) if one.layout.name == "MISSION_COUNT"]
    assert count.number("count") == 4  # home, which ArduPilot stores, a speed and two waypoints
    items = []
    for number in range(4):
        asked = frame("MISSION_REQUEST_INT", seq=number)
        items += [
            i for i in decoded(autopilot.second(asked)) if i.layout.name == "MISSION_ITEM_INT"
        ]
    assert [item.number("seq") for item in items] == [0, 1, 2, 3]
    assert [item.number("command") for item in items] == [16, 178, 16, 16]
    assert items[1].number("param2") == 6.0
    assert items[3].number("x") == 474_010_000
    assert items[3].number("z") == 25.0
    autopilot.second(frame("MISSION_ACK", type=0))
    assert (176, 4.0) in autopilot.commanded()
    autopilot.second(frame("HEARTBEAT", base_mode=217))
    frames = autopilot.second(frame("GLOBAL_POSITION_INT", relative_alt=19_000))
    assert commands(frames) == [(176, 3.0), (300, 0.0)]


def test_an_autopilot_that_never_gets_ready_ends_the_flight_with_the_reason():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    while not autopilot.operator.finished:
        autopilot.second()
    assert autopilot.operator.finished
    assert autopilot.operator.failure == "still waiting for a position after 181 s"


def test_an_autopilot_that_refuses_to_arm_is_asked_for_three_minutes_and_quoted():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.ARMING)
    while not autopilot.operator.finished:
        autopilot.second(frame("STATUSTEXT", text=b"Arm: Main loop slow (171Hz < 250Hz)"))
    assert autopilot.operator.failure == (
        "still arming after 181 s: Arm: Main loop slow (171Hz < 250Hz)"
    )


def test_an_autopilot_that_lands_by_itself_ends_the_flight():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.FLYING)
    autopilot.rest()
    assert autopilot.operator.finished
    assert not autopilot.operator.failure
    assert "landed" in autopilot.operator.events_us
    assert "landing" not in autopilot.operator.events_us  # it was not commanded


def test_motors_that_stop_during_the_take_off_are_reported():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.CLIMBING)
    autopilot.rest()
    assert autopilot.operator.failure == "disarmed while taking off"


@pytest.mark.parametrize("component", [1, 25])
def test_only_status_texts_of_the_autopilot_are_recorded(component):
    ground = operator(FlightPlan(10.0, 30.0))
    layout = message_layout("STATUSTEXT")
    raw = build_frame(layout, {"text": b"PreArm: Compass not healthy"}, component=component)
    ground.step(3 * SECOND_US)
    ground.receive(Frame(raw, layout))
    expected = [(3 * SECOND_US, "PreArm: Compass not healthy")] if component == 1 else []
    assert ground.texts == expected


@pytest.mark.parametrize("grounded_s", [25, 35])
def test_a_vehicle_on_the_ground_with_motors_on_ends_the_flight(grounded_s):
    autopilot = Autopilot(operator(FlightPlan(10.0, 100.0)))
    autopilot.up_to(Phase.FLYING)
    # Its estimator still reports a height.
    for _ in range(grounded_s):
        autopilot.second(frame("GLOBAL_POSITION_INT", relative_alt=9_500), on_ground=True)
    reason = "on the ground for 30 s with its motors on"
    assert autopilot.operator.failure == (reason if grounded_s > 30 else "")


def test_a_vehicle_on_the_ground_before_its_take_off_does_not_end_the_flight():
    autopilot = Autopilot(operator(FlightPlan(10.0, 100.0)))
    autopilot.up_to(Phase.CLIMBING)
    for _ in range(40):
        autopilot.second(on_ground=True)
    assert not autopilot.operator.failure


def fly_upload(waypoints, loss, seed=1, limit_s=600):
    """Upload to the simulator's mission service over a link that loses frames both ways; returns
    the operator, the service and the number of MISSION_COUNT."""
    rng, missions, counts = np.random.default_rng(seed), Missions(), 0
    ground = operator(FlightPlan(20.0, 60.0, waypoints))
    for t_us in range(0, limit_s * SECOND_US, OPERATOR_PERIOD_US):
        if t_us % SECOND_US == 0:
            ground.receive(READY)
        answers = missions.tick(t_us)
        for item in decoded(ground.step(t_us)):
            counts += item.layout.name == "MISSION_COUNT"
            if item.layout.name.startswith("MISSION") and rng.random() >= loss:
                answers += missions.received(item, t_us)
        for answer in answers:
            if rng.random() >= loss:
                ground.receive(Frame(build_frame(*answer), answer[0]))
        if ground.phase is Phase.ARMING or ground.failure:
            break
    return ground, missions, counts


@pytest.mark.parametrize(("loss", "seed"), [(0.0, 1), (0.1, 1), (0.1, 2), (0.2, 3)])
def test_a_mission_of_five_hundred_items_is_uploaded_also_under_loss(loss, seed):
    waypoints = tuple(Waypoint(47.4 + n * 1e-5, 8.5, 20.0, 6.0) for n in range(498))
    ground, missions, counts = fly_upload(waypoints, loss, seed)
    assert not ground.failure
    assert len(missions.items) == 500  # home and a speed too
    assert ground.phase is Phase.ARMING
    # The vehicle's requests drive the upload: it is announced again only where nothing came.
    assert counts == 1 or (loss and counts <= 4)


def test_an_upload_in_progress_is_not_announced_again():
    autopilot = Autopilot(operator(FlightPlan(20.0, 60.0, WAYPOINTS)))
    autopilot.settle()
    sent = autopilot.second(frame("MISSION_REQUEST_INT", seq=0))
    sent += [one for _ in range(5) for one in autopilot.second()]
    assert "MISSION_COUNT" not in names(sent)
    silent = [one for _ in range(8) for one in autopilot.second()]
    assert names(silent).count("MISSION_COUNT") > 0


def test_a_vehicle_that_hovers_below_the_height_has_ended_its_take_off():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.CLIMBING)
    armed = frame("HEARTBEAT", base_mode=217)
    aloft = frame("EXTENDED_SYS_STATE", landed_state=2)
    for _ in range(14):
        autopilot.second(armed, aloft, frame("GLOBAL_POSITION_INT", relative_alt=7_000))
    assert autopilot.operator.phase is Phase.FLYING
    assert "take-off" in autopilot.operator.events_us


@pytest.mark.parametrize("landed_state", [0, 1, 3])
def test_a_vehicle_that_stays_on_the_ground_has_not_taken_off(landed_state):
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    autopilot.up_to(Phase.CLIMBING)
    state = frame("EXTENDED_SYS_STATE", landed_state=landed_state)
    for _ in range(65):
        autopilot.second(frame("HEARTBEAT", base_mode=217), state)
    assert autopilot.operator.failure.startswith("still taking off after 6")


def test_a_silent_autopilot_needs_time():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0)))
    needs = []
    for second in range(6):
        autopilot.second(*([READY] if second in (0, 1, 4) else []))
        needs.append(autopilot.operator.needs_time)
    assert needs == [False, False, True, True, False, True]


def test_a_mission_needs_time_to_be_stored_and_read():
    autopilot = Autopilot(operator(FlightPlan(10.0, 30.0, WAYPOINTS)))
    autopilot.settle()
    for _ in range(5):  # not uploaded yet
        autopilot.second(READY)
        assert autopilot.operator.needs_time
    autopilot.second(READY, frame("MISSION_ACK"))
    needs = []
    for _ in range(5):
        needs.append(autopilot.operator.needs_time)
        autopilot.second(READY)
    assert needs == [True, True, True, False, False]
