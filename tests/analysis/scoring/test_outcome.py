"""The truth table of verdicts, of docs/verdicts.md."""

from collections.abc import Iterable, Sequence

import msgspec
import pytest

from analysis.results import Decision, Result, SensorDecision
from analysis.scoring.alarm_windows import AlarmWindow, alarms_of, channel_of, windows_of
from analysis.scoring.fault_channels import PLANE_OUTPUTS, fault_visibility
from analysis.scoring.outcome import RECOVERY_S, FaultOutcome, false_alarms, fault_outcomes
from mavproxy_fault.wire.label import Label
from simvehicle.hil.actuator_commands import ACTUATOR_CHANNELS

T0_US = 1_000_000


def stamp(t_s: float) -> int:
    return T0_US + round(t_s * 1e6)


def label(
    id: str, targets: str, start_s: float = 10, end_s: float | None = 20, fault: str = "bias"
) -> Label:
    return Label(
        id=id,
        fault=fault,
        targets=tuple(targets.split()),
        t0_us=T0_US,
        start_us=stamp(start_s),
        end_us=None if end_s is None else stamp(end_s),
        frames=10,
    )


def decision(t_s: float, excluded: Sequence[str] = (), hypothesis: str = "") -> Decision:
    return Decision(
        t_us=stamp(t_s),
        statistic=99.0,
        threshold=25.0,
        dof=6,
        p_value=0.0,
        alarm=bool(excluded or hypothesis),
        hypothesis=hypothesis or ("satellites" if excluded else "none"),
        excluded=tuple(excluded),
    )


def actuator(t_s: float, name: str) -> SensorDecision:
    found = sensor(t_s, "actuators", isolated="-or-" not in name)
    return msgspec.structs.replace(found, suspect=name)


def sensor(t_s: float, name: str, isolated: bool = True, alarm: bool = True) -> SensorDecision:
    return SensorDecision(
        t_us=stamp(t_s),
        sensor=name,
        statistic=50.0 if alarm else 1.0,
        threshold=10.0,
        dof=1,
        alarm=alarm,
        isolated=isolated and alarm,
    )


def from_to(start_s: float, end_s: float) -> list[float]:
    return [start_s + 0.2 * i for i in range(round((end_s - start_s) / 0.2) + 1)]


def windows(results: Iterable[Result]) -> list[AlarmWindow]:
    return windows_of(alarm for result in results for alarm in alarms_of(result))


def judged(labels: Sequence[Label], results: Sequence[Result]) -> list[FaultOutcome]:
    quiet = [sensor(0, name, alarm=False) for name in ("imu", "mag", "baro", "gps-position")]
    watched = {channel_of(result) for result in [decision(0), *quiet, *results]} - {None}
    return fault_outcomes(labels, windows(results), {str(name) for name in watched}, 200_000)


G12, GYRO, FIX = "PSEUDORANGE.G12", "HIL_SENSOR.xgyro", "HIL_GPS.lat"
G12_EXCLUDED = [decision(t, ["G12"]) for t in from_to(10.2, 22)]

# targets, results -> verdict, correct isolations, wrong isolations, reason
TRUTH = {
    "the faulty one alone": (G12, G12_EXCLUDED, "isolated", ("G12",), (), ""),
    "another satellite": (
        G12,
        [decision(12, ["E05"])],
        *("wrong", (), ("E05",), "otherwise missed"),
    ),
    "the right one, and a healthy one on another channel": (
        G12,
        [*G12_EXCLUDED, *(sensor(t, "imu") for t in from_to(12, 15))],
        *("wrong", ("G12",), ("imu",), "otherwise isolated"),
    ),
    "healthy ones inside, and the right one only after the end": (
        G12,
        [
            *(sensor(t, name) for name in ("imu", "mag", "baro") for t in from_to(11, 14)),
            decision(20.9, ["G12"]),
        ],
        *("wrong", (), ("imu", "mag", "baro"), "otherwise detected 0.9 s after its end"),
    ),
    "an alarm without isolation": (
        G12,
        [decision(11, hypothesis="multiple-unknown")],
        *("detected", (), (), "nothing was isolated"),
    ),
    "the same for an IMU, which the epoch's test can see": (
        GYRO,
        [decision(11, hypothesis="multiple-unknown")],
        *("detected", (), (), "nothing was isolated"),
    ),
    "an alarm with two hypotheses": (
        GYRO,
        [decision(11, hypothesis="GPS-or-imu")],
        *("ambiguous", (), (), "GPS-or-imu"),
    ),
    "between two of which none is it": (
        "HIL_SENSOR.xmag",
        [decision(11, hypothesis="GPS-or-imu")],
        *("missed", (), (), ""),
    ),
    "a sensor suspected, not left out": (
        "HIL_SENSOR.xmag",
        [sensor(11, "mag", isolated=False)],
        *("detected", (), (), "nothing was isolated"),
    ),
    "one of two satellites": (
        f"{G12} PSEUDORANGE.E05",
        G12_EXCLUDED,
        *("detected", ("G12",), (), "not isolated: E05"),
    ),
    "a receiver's velocity for its position": (
        FIX,
        [sensor(12, "gps-velocity")],
        *("isolated", ("gps-velocity",), (), ""),
    ),
    "a receiver's position beside its satellite": (
        G12,
        [*G12_EXCLUDED, sensor(12, "gps-position")],
        *("isolated", ("G12", "gps-position"), (), ""),
    ),
    "one sensor of a message that is lost": (
        "HIL_SENSOR",
        [sensor(12, "imu"), sensor(12, "baro")],
        *("isolated", ("baro", "imu"), (), ""),
    ),
    "one epoch after the end": (
        G12,
        [decision(20.1, ["G12"])],
        *("isolated", ("G12",), (), ""),
    ),
    "later": (G12, [decision(23, ["G12"])], "late", (), (), "detected 3.0 s after its end"),
    "after its echo": (G12, [decision(31, ["G12"])], "missed", (), (), ""),
    "nothing": (G12, [], "missed", (), (), ""),
    "an alarm from before": (
        G12,
        [decision(t, ["G12"]) for t in from_to(8, 12)],
        *("not judged", (), (), "G12 had an alarm before the fault"),
    ),
    "no channel": (
        "BATTERY_STATUS.voltages[0]",
        [],
        *("not judged", (), (), "no channel monitors BATTERY_STATUS.voltages[0]"),
    ),
    "a satellite that is lost": (
        "PLANT.satellite_lost[G12]",
        [],
        *("not judged", (), (), "a lost satellite is no error: terrain hides satellites too"),
    ),
    "no such sensor": (
        "HIL_SENSOR.diff_pressure",
        [],
        *("not judged", (), (), "no airspeed in this flight"),
    ),
    "a healthy sensor while the plant is at fault": (
        "PLANT.mass_kg_add",
        [sensor(12, "mag")],
        *("wrong", (), ("mag",), "otherwise no channel monitors the plant (mass_kg_add)"),
    ),
    "the motor that is weak": (
        "PLANT.motor_efficiency[1]",
        [actuator(12, "motor 2")],
        *("isolated", ("motor 2",), (), ""),
    ),
    "another motor": (
        "PLANT.motor_efficiency[1]",
        [actuator(12, "motor 3")],
        *("wrong", (), ("motor 3",), "otherwise missed"),
    ),
    "one of two motors": (
        "PLANT.motor_efficiency[1]",
        [actuator(12, "motor 2-or-motor 4")],
        *("ambiguous", (), (), "motor 2-or-motor 4"),
    ),
    "a fixed wing's motor": (
        "PLANT.motor_efficiency[0]",
        [actuator(12, "throttle")],
        *("isolated", ("throttle",), (), ""),
    ),
    "a surface by its output": (
        "HIL_ACTUATOR_CONTROLS.controls[7]",
        [actuator(12, "elevator")],
        *("isolated", ("elevator",), (), ""),
    ),
    "a motor in a flight without commands": (
        "PLANT.motor_efficiency[1]",
        [],
        *("not judged", (), (), "no actuators in this flight"),
    ),
}


def test_the_outputs_of_a_plane_are_those_of_the_simulator() -> None:
    expected = {
        number: name for name, outputs in ACTUATOR_CHANNELS.items() for number, _ in outputs
    }
    assert expected == PLANE_OUTPUTS


@pytest.mark.parametrize("case", TRUTH.values(), ids=TRUTH.keys())
def test_truth_table(case: tuple) -> None:
    targets, results, verdict, isolated, wrongly, reason = case
    (row,) = judged([label("f", targets)], results)
    found = row.verdict, row.isolated, tuple(wrong.who for wrong in row.wrongly), row.reason
    assert found == (verdict, isolated, wrongly, reason)


@pytest.mark.parametrize(
    ("fault", "target", "verdict"),
    [
        ("drop", G12, "not judged"),
        ("drop", "PSEUDORANGE", "missed"),
        ("drop", f"{G12} HIL_SENSOR.xgyro", "missed"),
        ("bias", G12, "missed"),
    ],
)
def test_a_lost_satellite_is_not_judged_a_silent_receiver_is(
    fault: str, target: str, verdict: str
) -> None:
    done = msgspec.structs.replace(label("f", target), fault=fault)
    (row,) = judged([done], [])
    assert row.verdict == verdict


def test_a_wrong_isolation_has_its_time() -> None:
    results = [sensor(t, "imu") for t in from_to(12, 15)]
    (row,) = judged([label("f", G12)], results)
    (wrong,) = row.wrongly
    assert (wrong.from_s, wrong.for_s) == (12.0, 3.0)


def test_the_delay_counts_to_the_first_alarm_on_a_channel_that_can_see_it() -> None:
    results = [sensor(10.4, "baro", isolated=False), *G12_EXCLUDED]
    (row,) = judged([label("f", G12)], results)
    assert (row.detected, row.delay_s) == (True, 0.2)


def test_two_faults_at_once_each_have_their_own() -> None:
    labels = [label("a", G12), label("b", "PSEUDORANGE.E05")]
    rows = judged(labels, [decision(t, ["E05", "G12"]) for t in from_to(10.2, 20)])
    assert [row.verdict for row in rows] == ["isolated", "isolated"]


def test_an_alarm_of_a_later_fault_does_not_detect_an_earlier_one() -> None:
    labels = [label("a", G12, 10, 12), label("b", G12, 15, 18)]
    rows = judged(labels, [decision(t, ["G12"]) for t in from_to(15.2, 18)])
    assert [row.verdict for row in rows] == ["missed", "isolated"]


def test_false_alarms_are_counted_by_channel_outside_and_inside_faults() -> None:
    results = [
        *(sensor(t, "baro", isolated=False) for t in (5.0, 5.2)),
        *(sensor(t, "imu") for t in from_to(12, 15)),
        sensor(14, "mag", isolated=False),  # a suspicion while something was wrong
        *(sensor(t, "mag") for t in from_to(40, 42)),
    ]
    rows = false_alarms([label("f", G12)], windows(results), 100.0, 200_000)
    found = [(r.channel, r.outside, r.inside, r.blamed, r.seconds, r.per_hour) for r in rows]
    assert found == [
        ("baro", 1, 0, (), 0.0, 36.0),
        ("imu", 0, 1, ("imu",), 3.0, 36.0),
        ("mag", 1, 0, ("mag",), 2.0, 36.0),
    ]


def test_a_correct_isolation_is_false_after_the_aftermath() -> None:
    (row,) = false_alarms(
        [label("f", G12)], windows(decision(t, ["G12"]) for t in from_to(11, 35)), 60, 200_000
    )
    assert (row.outside, row.inside, row.blamed) == (1, 0, ("G12",))
    assert row.seconds == pytest.approx(4.8, abs=0.01)


def test_an_exclusion_that_ends_ten_seconds_after_the_first_healthy_epoch_is_correct() -> None:
    fault, back_s = label("f", "HIL_GPS.lat", 10, 20.12), 20.2 + RECOVERY_S
    left_out = [decision(t, ["GPS"]) for t in from_to(10.2, back_s - 0.1)]
    assert not false_alarms([fault], windows(left_out), 60.0, 200_000)


@pytest.mark.parametrize(
    ("fault", "targets", "channels"),
    [
        ("bias", "HIL_SENSOR.xgyro", "gps-position imu satellites"),
        ("bias", "SCALED_IMU2.zmag", "mag"),
        ("bias", "HIGHRES_IMU.abs_pressure", "baro"),
        ("bias", "SCALED_PRESSURE.press_diff", "airspeed"),
        ("bias", "GPS2_RAW.lat", "gps-position gps-velocity"),
        ("plant", "PLANT.receiver_off", "gps-position gps-velocity satellites"),
        ("plant", "PLANT.pseudorange_m[G12]", "gps-position gps-velocity satellites"),
        ("plant", "PLANT.spoof_north_m[all]", "gps-position gps-velocity satellites"),
        ("plant", "PLANT.spoof_clock_m[G]", "gps-position gps-velocity satellites"),
        ("plant", "PLANT.wind_n_mps", ""),
        ("drop", "DISTANCE_SENSOR", "link range"),
        ("outage", "", "link"),
        ("jitter", "", ""),
        ("duplicate", "HIL_SENSOR", ""),
        ("gps-spoof", "", "gps-position gps-velocity satellites"),
        ("bias", "ODOMETRY.x", "vision"),
    ],
)
def test_channels_follow_from_target_and_kind(fault: str, targets: str, channels: str) -> None:
    found = fault_visibility(label("f", targets, fault=fault))
    assert sorted(found.channels) == channels.split()
    assert bool(found.reason) is not bool(channels)


@pytest.mark.parametrize("fault", ["delay", "jitter"])
def test_late_frames_silence_streams_but_falsify_no_satellite(fault: str) -> None:
    found = fault_visibility(label("f", "", fault=fault))
    assert not found.channels
    assert all(map(found.allows, ("imu", "baro", "gps-position", "satellites", "link")))
    assert not any(map(found.allows, ("G12", "gps-velocity", "clock", "motor 1")))


def test_a_consequence_of_what_no_channel_observes_is_no_detection() -> None:
    """A stream that falls silent as its frames are late, 9 s after they begin to be."""
    found = judged([label("f", "", fault="delay")], [sensor(19, "baro")])
    assert [(o.verdict, o.detected, o.delay_s, o.isolated) for o in found] == [
        ("not judged", False, None, ("baro",))
    ]
    (lost,) = judged([label("f", "PSEUDORANGE.G12", fault="drop")], [decision(12, ["G12"])])
    assert (lost.verdict, lost.detected, lost.wrongly) == ("not judged", False, ())


def test_on_a_link_that_loses_frames_the_raw_ranges_may_fall_silent_as_well() -> None:
    silent = windows([sensor(12, "satellites"), sensor(12, "link")])
    assert not false_alarms([label("f", "", fault="drop")], silent, 100.0, 200_000)


def test_bits_cleared_by_group_belong_to_that_sensor() -> None:
    off = Label(
        id="f", fault="clear-bits", targets=("HIL_SENSOR.fields_updated",), t0_us=0, start_us=0,
        parameters={"groups": ["baro"]},
    )  # fmt: skip
    assert fault_visibility(off).channels == {"baro"}


def test_what_a_ground_station_loses_no_channel_observes() -> None:
    lost = msgspec.structs.replace(label("f", "", fault="outage"), where={"system": 255})
    assert fault_visibility(label("f", "", fault="outage")).channels == {"link"}
    assert not fault_visibility(lost).channels


@pytest.mark.parametrize("epoch_s", [0.2, 1.0, 15.0, 30.0])
def test_an_exclusion_is_one_alarm_at_any_rate(epoch_s: float) -> None:
    results = [decision(10 + epoch_s * k, ["G12"]) for k in range(60)]
    results += [decision(10 + epoch_s * (100 + 10 * k), ["E05"]) for k in range(3)]
    alarms = [alarm for result in results for alarm in alarms_of(result)]
    found = windows_of(alarms, round(epoch_s * 1e6))
    assert [(w.name, w.count) for w in found] == [("G12", 60), ("E05", 1), ("E05", 1), ("E05", 1)]


def test_another_sensors_alarms_are_not_merged_over_the_epochs_of_a_receiver() -> None:
    alarms = [alarm for t in (10.0, 40.0) for alarm in alarms_of(sensor(t, "mag"))]
    assert len(windows_of(alarms, 30_000_000)) == 2


@pytest.mark.parametrize(
    ("fault", "targets", "channels"),
    [
        ("gyro-off", "SCALED_IMU2.xgyro", {"imu", "satellites", "gps-position"}),
        ("gps-off", "GPS_RAW_INT.lat", {"gps-position", "gps-velocity"}),
        ("motor-off", "HIL_ACTUATOR_CONTROLS.controls[1]", {"actuators"}),
        ("mavlink-off", "", {"link"}),
        ("esc-off", "", set()),
    ],
)
def test_a_failure_of_the_autopilot_itself_is_scored_by_its_telemetry(
    fault: str, targets: str, channels: set[str]
) -> None:
    native = msgspec.structs.replace(label("f", targets), fault=fault, by="autopilot", frames=0)
    native = native if targets else msgspec.structs.replace(native, targets=())
    assert fault_visibility(native).channels == channels
    (row,) = fault_outcomes([native], [], {"imu", "gps-position", "actuators", "link"}, 200_000)
    assert row.target == f"{fault} by the autopilot"
    expected = ("missed", "") if channels else ("not judged", "no channel monitors esc-off")
    assert (row.verdict, row.reason) == expected
