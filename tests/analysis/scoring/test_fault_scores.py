"""Labels against results."""

from analysis.results import Decision, Result, SensorDecision
from analysis.scoring.fault_scores import Alarm, alarm_of, channel, false_alarms, score_faults
from mavproxy_fault.wire.label import Label


def label(id: str, target: str, start_s: float, end_s: float) -> Label:
    return Label(
        id=id,
        fault="bias",
        targets=(target,),
        t0_us=1_000_000,
        start_us=int((start_s + 1) * 1e6),
        end_us=int((end_s + 1) * 1e6),
        frames=10,
    )


def decision(t_s: float, excluded: tuple[str, ...] = (), hypothesis: str = "") -> Decision:
    return Decision(
        t_s=t_s,
        t_us=int((t_s + 1) * 1e6),
        statistic=99.0,
        threshold=25.0,
        dof=6,
        p_value=0.0,
        alarm=bool(excluded or hypothesis),
        hypothesis=hypothesis or ("satellites" if excluded else "none"),
        excluded=excluded,
    )


def sensor(t_s: float, name: str) -> SensorDecision:
    return SensorDecision(
        t_s=t_s,
        t_us=int((t_s + 1) * 1e6),
        sensor=name,
        statistic=50.0,
        threshold=10.0,
        dof=1,
        alarm=True,
    )


def alarms(*results: Result) -> list[Alarm]:
    return [alarm for result in results if (alarm := alarm_of(result)) is not None]


def test_a_satellite_fault_is_isolated_with_its_delay() -> None:
    results = [decision(9.8), *(decision(t, ("G12",)) for t in (10.2, 10.4, 10.6))]
    (row,) = score_faults([label("step", "PSEUDORANGE.G12", 10.0, 11.0)], alarms(*results))
    assert (row.detected, row.delay_s, row.isolated, row.verdict) == (
        True,
        0.2,
        ("G12",),
        "isolated",
    )
    assert (row.start_s, row.end_s, row.channel) == (10.0, 11.0, "satellites")


def test_blaming_another_satellite_is_wrong() -> None:
    (row,) = score_faults([label("a", "PSEUDORANGE.G12", 10, 11)], alarms(decision(10.2, ("E05",))))
    assert row.verdict == "wrong"


def test_blaming_the_other_of_two_faults_at_once_is_not_wrong() -> None:
    labels = [label("a", "PSEUDORANGE.G12", 10, 11), label("b", "PSEUDORANGE.E05", 10, 11)]
    rows = score_faults(labels, alarms(decision(10.2, ("E05", "G12"))))
    assert [row.verdict for row in rows] == ["isolated", "isolated"]


def test_an_alarm_on_another_channel_does_not_detect() -> None:
    (row,) = score_faults([label("a", "HIL_SENSOR.xgyro", 10, 11)], alarms(sensor(10.5, "baro")))
    assert (row.detected, row.verdict) == (False, "missed")


def test_a_late_alarm_does_not_detect() -> None:
    (row,) = score_faults([label("a", "HIL_SENSOR.xgyro", 10, 11)], alarms(sensor(12.5, "imu")))
    assert row.verdict == "missed"


def test_nobody_blamed_is_only_detected() -> None:
    result = decision(10.2, hypothesis="multiple-unknown")
    (row,) = score_faults([label("a", "PSEUDORANGE.G12", 10, 11)], alarms(result))
    assert row.verdict == "detected"


def test_a_target_nothing_watches_is_said_so() -> None:
    (row,) = score_faults([label("a", "BATTERY_STATUS.voltages[0]", 10, 11)], [])
    assert row.verdict == "no channel"


def test_false_alarms_are_rises_outside_the_faults_and_their_echo() -> None:
    labels = [label("a", "HIL_SENSOR.xgyro", 10, 11)]
    results = [sensor(t, "baro") for t in (5.0, 5.2, 5.4, 10.5, 15.0, 25.0)]
    assert false_alarms(labels, alarms(*results)) == 2


def test_channels_follow_from_targets() -> None:
    targets = ("HIL_SENSOR.xgyro", "HIL_SENSOR.xmag", "HIL_GPS.lat", "HIL_GPS.vn", "HIL_SENSOR")
    assert [channel(t) for t in targets] == ["imu", "mag", "gps-position", "gps-velocity", "imu"]


def test_a_spoofed_receiver_is_isolated_as_the_gps_position() -> None:
    spoof = Label(
        id="spoof",
        fault="gps-spoof",
        t0_us=1_000_000,
        start_us=11_000_000,
        end_us=21_000_000,
        frames=50,
    )
    (row,) = score_faults([spoof], [alarm_of(sensor(12.0, "gps-position"))])
    assert (row.verdict, row.isolated) == ("isolated", ("gps-position",))
