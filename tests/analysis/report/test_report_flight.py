"""Checks find the problems of a flight, and none in a nominal one."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from analysis.report.curves.recording import (
    UNGRADED,
    Event,
    FlightData,
    Signal,
    inside_windows,
)
from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.autopilot_texts import texts_check
from analysis.report.judging.check_limits import Thresholds, read_thresholds
from analysis.report.judging.checks import (
    CheckLimits,
    FlightCheck,
    chain_of,
    chain_text,
    check_level,
    lasting_windows,
    verdict_of,
)
from analysis.report.judging.fault_reaction import fault_reactions
from analysis.report.recordings.flight_sources import RecordedFlight as Source
from analysis.report.recordings.flight_sources import group_logs, read_flight
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.label import Label

Flight = Callable[..., Path]


def outcome(path: Path, *labels: Label) -> FlightAssessment:
    return assess_flight(read_flight([path], labels), Thresholds())


def verdicts(found: FlightAssessment) -> dict[str, str]:
    return {check.name: check.verdict for check in found.checks}


def signal(values: list[float], step_s: float = 0.1) -> Signal:
    return Signal("vibration", "x", np.arange(len(values)) * step_s, np.array(values, float))


def test_a_nominal_flight_passes(flight: Flight) -> None:
    found = outcome(flight())
    assert found.verdict == "PASS"
    assert set(verdicts(found).values()) == {"PASS", "not judged"}


def test_a_check_without_data_is_not_judged(flight: Flight) -> None:
    found = verdicts(outcome(flight()))
    assert found["innovation test ratios"] == "not judged"
    assert found["position against the truth"] == "not judged"


def test_vibration_beyond_the_limit_fails_with_its_peak_as_evidence(flight: Flight) -> None:
    found = outcome(flight(vibration=75.0))
    check = next(check for check in found.checks if check.name == "vibration")
    assert check.verdict == "FAIL"
    assert "peak 75 m/s²" in check.evidence
    assert found.verdict == "FAIL"


def test_a_gps_jump_is_found_without_a_label(flight: Flight) -> None:
    found = outcome(flight(jump_at_s=10.0))
    check = next(check for check in found.checks if check.name == "GPS jumps")
    assert check.verdict == "FAIL"
    assert check.windows[0][0] == pytest.approx(10.0, abs=0.05)
    assert any(span.lane == "found: GPS jumps" for span in found.flight.recording.spans)


def test_an_ekf_variance_between_the_limits_warns(flight: Flight) -> None:
    assert verdicts(outcome(flight(variance=0.6)))["EKF variances"] == "WARN"
    assert verdicts(outcome(flight(variance=0.9)))["EKF variances"] == "FAIL"


def test_a_failsafe_text_fails_and_a_harmless_one_does_not(flight: Flight) -> None:
    bad = outcome(flight("bad", texts=((8, 2, b"Battery Failsafe - RTL"),)))
    assert verdicts(bad)["messages of the autopilot"] == "FAIL"
    good = outcome(flight("good", texts=((8, 6, b"Reached command #3"),)))
    assert verdicts(good)["messages of the autopilot"] == "PASS"


def test_frames_missing_by_sequence_numbers_are_counted(flight: Flight) -> None:
    found = outcome(flight(seconds=30, lost=3))
    link = found.flight.recording.links[0]
    assert link.lost == pytest.approx(3 * 150, abs=3)
    assert verdicts(found)["link from 1/1"] == "FAIL"


def test_what_an_injected_fault_does_to_the_estimate_is_judged_by_the_outcome(
    flight: Flight,
) -> None:
    label = Label(
        id="jump", fault="bias", targets=("GPS_RAW_INT.lat",), t0_us=1_000_000,
        start_us=10_900_000, end_us=21_000_000,
    )  # fmt: skip
    found = outcome(flight(jump_at_s=10.0), label)
    assert verdicts(found)["GPS jumps"] == verdicts(found)["estimate steps"] == "PASS"
    assert found.verdict == "PASS"
    assert verdicts(outcome(flight(jump_at_s=10.0)))["estimate steps"] == "FAIL"
    row = found.summary["faults"][0]
    assert row["detected"]
    assert row["reaction"][0]["text"] == "position estimate jumps by 200 m"


def test_modes_arming_and_changed_parameters_are_events_of_the_recording(flight: Flight) -> None:
    recording = outcome(flight()).flight.recording
    texts = [(event.t_s, event.text) for event in recording.events if event.kind == "mode"]
    assert texts == [(2.0, "armed"), (5.0, "mode AUTO")]
    assert recording.parameters["WPNAV_SPEED"] == [(0.0, 500.0), (6.0, 300.0)]


def test_a_value_counts_only_when_it_stays_beyond_the_limit() -> None:
    brief = signal([0.0] * 50 + [9.0] * 5 + [0.0] * 50)
    long = signal([0.0] * 50 + [9.0] * 15 + [0.0] * 50)
    limits = CheckLimits(1.0, 5.0, hold_s=1.0)
    assert check_level("x", [brief], limits, None).verdict == "PASS"
    check = check_level("x", [long], limits, None)
    assert check.verdict == "FAIL"
    assert check.windows == ((pytest.approx(5.0), pytest.approx(6.5)),)


def test_only_the_armed_part_of_a_flight_is_judged() -> None:
    values = signal([9.0] * 50 + [0.0] * 50)
    limits = CheckLimits(1.0, 5.0)
    assert check_level("x", [values], limits, [(6.0, 9.0)]).verdict == "PASS"
    assert check_level("x", [values], limits, []).verdict == "not judged"


def test_a_gap_in_the_data_does_not_join_two_excursions() -> None:
    t_s = np.array([0.0, 0.4, 100.0, 100.4])
    assert lasting_windows(t_s, np.ones(4, bool), 1.0) == []


def test_thresholds_come_from_a_file_and_unknown_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("gps_step_m: [1, 2]\n")
    assert read_thresholds(str(path)).gps_step_m == (1.0, 2.0)
    path.write_text("gps_stepm: [1, 2]\n")
    with pytest.raises(ConfigError, match="gps_step_m"):
        read_thresholds(str(path))


def test_overlapping_tlogs_are_one_flight_and_others_are_not(
    flight: Flight, tmp_path: Path
) -> None:
    one, two = flight("one"), flight("two", 10)
    later = tmp_path / "later.tlog"
    data = one.read_bytes()
    later.write_bytes(data)
    assert group_logs([one, two]) == [[one, two]]
    ulog = tmp_path / "a.ulg"
    ulog.write_bytes(b"ULog\x01\x12\x35" + bytes(50))
    assert group_logs([one, ulog]) == [[one], [ulog]]


def test_two_vehicles_keep_their_curves_apart(tmp_path: Path, flight: Flight) -> None:
    first, second = flight("a"), flight("b", system=7)
    both = tmp_path / "both.tlog"
    both.write_bytes(first.read_bytes() + second.read_bytes())
    recording = outcome(both).flight.recording
    names = {signal.name for signal in recording.of("roll")}
    assert names == {"ATTITUDE (system 1)", "ATTITUDE (system 7)"}


@pytest.mark.parametrize("content", [b"", b"not a log at all " * 500, bytes(5000)])
def test_a_foreign_or_empty_file_is_a_config_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.tlog"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"x\.tlog"):
        read_flight([path], ())


def test_a_recording_without_anything_has_no_verdict() -> None:
    found = assess_flight(Source(FlightData("nothing"), (Path("x"),)), Thresholds())
    assert found.verdict == "NO VERDICT"


def test_a_link_without_losses_says_nothing_about_a_flight() -> None:
    whole = FlightCheck(name="log is complete", verdict="PASS", evidence="")
    link = FlightCheck(name="link from 1/1", verdict="PASS", evidence="")
    assert verdict_of([whole, link]) == "NO VERDICT"
    assert (
        verdict_of([whole, link, FlightCheck(name="vibration", verdict="PASS", evidence="")])
        == "PASS"
    )


def test_the_sequence_numbers_of_two_links_in_one_log_are_not_judged(flight: Flight) -> None:
    found = outcome(flight(lost=100))
    assert verdicts(found)["link from 1/1"] == "not judged"


def test_an_attitude_that_does_not_follow_its_setpoint_fails() -> None:
    t_s = np.arange(100) * 0.1
    roll = np.where(t_s > 5, 100.0, 0.0)
    curves = [
        Signal(part, name, t_s, value)
        for part, value in (("roll", roll), ("pitch", 0 * roll))
        for name, value in (("ATTITUDE", value), ("desired", 0 * roll))
    ]
    found = assess_flight(Source(FlightData("x", signals=curves), (Path("x"),)), Thresholds())
    check = next(check for check in found.checks if check.name == "attitude control")
    assert check.verdict == "FAIL"
    assert check.windows[0][0] == pytest.approx(5.1)


def test_a_constant_truth_is_ignored(shared_data: Path) -> None:
    log = shared_data / "px4_hil" / "hover_gps_jump_hil.tlog"
    found = assess_flight(read_flight([log], []), Thresholds())
    assert verdicts(found)["position against the truth"] == "not judged"
    assert any("never changes" in note for note in found.summary["notes"])


def test_px4s_glitch_flag_and_the_accepted_jump_show_in_the_real_log(shared_data: Path) -> None:
    folder = shared_data / "px4_hil"
    label = Label(
        id="gps-jump", fault="bias", targets=("HIL_GPS.lat",), t0_us=1_000_000,
        start_us=41_000_000, end_us=56_000_000, frames=75,
    )  # fmt: skip
    paths = [folder / "hover_gps_jump_hil.tlog", folder / "hover_gps_jump_gcs.tlog"]
    assert group_logs(paths) == [paths]
    found = assess_flight(read_flight(paths, [label]), Thresholds())
    said = found.summary["faults"][0]["reaction"]
    assert said[0]["text"] == "estimator: GPS glitch raised"
    assert said[0]["after_s"] == pytest.approx(0.18, abs=0.01)
    assert said[1]["text"] == "position estimate jumps by 200 m"
    assert said[1]["after_s"] == pytest.approx(7.15, abs=0.05)
    assert said[2]["text"] == "estimator: GPS glitch cleared"


def jump(id: str = "jump", **changes: object) -> Label:
    label = Label(
        id=id, fault="bias", targets=("GPS_RAW_INT.lat",), t0_us=1_000_000,
        start_us=10_900_000, end_us=21_000_000,
    )  # fmt: skip
    return msgspec.structs.replace(label, **changes)


def fault_rows(found: FlightAssessment) -> dict[str, tuple[str, str]]:
    return {row["id"]: (row["verdict"], row["reason"]) for row in found.summary["faults"]}


def test_in_an_edited_recording_checks_detect_instead_of_the_autopilot(
    flight: Flight,
) -> None:
    seen = outcome(flight("seen", jump_at_s=10.0), jump(recorded=True))
    assert fault_rows(seen) == {"jump": ("isolated", "")}
    unseen = outcome(flight("unseen"), jump(recorded=True))
    reason = "injected into a recording: the autopilot could not react"
    assert fault_rows(unseen) == {"jump": ("not judged", reason)}
    assert unseen.verdict == "PASS"


def test_a_failed_check_counts_only_for_faults_of_its_own_sensor(flight: Flight) -> None:
    compass = jump("compass", targets=("RAW_IMU.xmag",), recorded=True)
    found = outcome(flight(jump_at_s=10.0), jump(recorded=True), compass)
    assert fault_rows(found)["jump"][0] == "isolated"
    assert fault_rows(found)["compass"][0] == "not judged"


def test_labels_continue_over_a_restart_of_the_vehicle(flight: Flight, tmp_path: Path) -> None:
    """Half a minute passes between both flights: the proxy's clock, and labels, do not include
    it."""
    first, second = flight("first"), flight("second", jump_at_s=10.0)
    records = [(t_us, raw) for t_us, raw, _ in tlog.read_records(first)]
    records += [(t_us + 50_000_000, raw) for t_us, raw, _ in tlog.read_records(second)]
    path = tmp_path / "both.tlog"
    path.write_bytes(b"".join(tlog.log_record(*record) for record in records))
    label = jump(recorded=True, start_us=30_700_000, end_us=40_800_000)
    assert fault_rows(outcome(path, label)) == {"jump": ("isolated", "")}


def test_a_problem_of_the_original_recording_isolates_no_sensor() -> None:
    """The real flight shook before, while and after its GPS was edited, which the edit did not."""
    shaken = FlightCheck(
        name="vibration", verdict="FAIL", evidence="", windows=((3.0, 4.0), (11.0, 12.0))
    )
    jumps = FlightCheck(name="GPS jumps", verdict="FAIL", evidence="", windows=((9.8, 10.1),))
    recording = FlightData("x", "ardupilot", 1_000_000, 60.0, [])
    rows = fault_reactions([jump(recorded=True)], recording, [shaken, jumps])
    # A window that begins one sample before the edit counts.
    assert [(row["verdict"], row["delay_s"]) for row in rows] == [("isolated", 0.0)]
    calm = msgspec.structs.replace(shaken, windows=((11.0, 12.0),))
    (row,) = fault_reactions([jump(recorded=True)], recording, [calm, jumps])
    assert (row["verdict"], row["wrongly"][0]["who"]) == ("wrong", "imu")


def test_a_log_with_labels_needs_no_criteria_for_a_verdict(flight: Flight) -> None:
    found = outcome(flight(), jump())
    assert fault_rows(found)["jump"] == ("missed", "")
    assert verdicts(found)["criterion: faults missed"] == "FAIL"
    assert found.verdict == "FAIL"


def test_a_command_of_a_sequence_is_not_a_missed_fault(flight: Flight) -> None:
    found = outcome(flight(), jump("up", fault="command", targets=()))
    assert fault_rows(found)["up"] == ("not judged", "a command to the vehicle falsifies nothing")
    assert found.verdict == "PASS"


def test_a_log_without_an_autopilot_calls_no_fault_missed() -> None:
    recording = FlightData("x", signals=[signal([0.0] * 50)])
    found = assess_flight(Source(recording, (Path("x"),), [jump()]), Thresholds())
    assert fault_rows(found)["jump"][0] == "not judged"


def text(t_s: float, text: str, severity: int = UNGRADED, kind: str = "text") -> Event:
    return Event(t_s, kind, text, severity)


@pytest.mark.parametrize(
    ("flag", "verdict"),
    [
        ("estimator: fs bad acc vertical raised", "isolated"),
        ("estimator: accelerometer error raised", "isolated"),
        ("estimator: GPS glitch raised", "wrong"),
        ("estimator: velocity rejected raised", "detected"),  # names no sensor
    ],
)
def test_an_estimator_flag_counts_as_a_reaction_of_the_autopilot(flag: str, verdict: str) -> None:
    label = jump("accel", targets=("HIL_SENSOR.zacc",))
    recording = FlightData("x", "px4", 1_000_000, 60.0, [signal([0.0] * 600)])
    recording.events.append(text(12.0, flag, 4, "flag"))
    found = assess_flight(Source(recording, (Path("x"),), [label]), Thresholds())
    assert fault_rows(found)["accel"][0] == verdict


ARMED = [(10.0, 100.0)]
TEXTS = {
    "said when it is over": ([text(20, "GPS Glitch cleared", 3)], "PASS", ""),
    "said on the bench": ([text(5, "PreArm: Compass not healthy", 2)], "PASS", ""),
    "for information": ([text(20, "primary EKF changed (timeout)", 6)], "PASS", ""),
    "an emergency without an alarming word": (
        [text(20, "BARO #0: no data", 0)],
        "FAIL",
        "'BARO #0: no data' at 20.0 s",
    ),
    "a sensor that a simulator cut off": (
        [text(20, "BARO #0 failed: STALE!", 0)],
        "FAIL",
        "'BARO #0 failed: STALE!' at 20.0 s",
    ),
    "a sensor that is off": (
        [text(20, "BARO #0 failed:  OFF!", 0)],
        "FAIL",
        "'BARO #0 failed:  OFF!' at 20.0 s",
    ),
    "what is not over": (
        [text(20, "Compass not ok", 2)],
        "WARN",
        "'Compass not ok' at 20.0 s",
    ),
    "an event that is off": (
        [text(20, "Failsafe. Short event on", 4), text(26, "Failsafe. Short event off", 4)],
        "WARN",
        "'Failsafe. Short event on' at 20.0 s",
    ),
    "said as it disarms": (
        [text(100.6, "Crash: Disarming: AngErr=45>30", 0)],
        "FAIL",
        "'Crash: Disarming: AngErr=45>30' at 100.6 s",
    ),
    "a transmitter switched off behind the landing": (
        [text(100.3, "Radio Failsafe - Disarming", 1)], "PASS", "",
    ),
    "said on the bench afterwards": ([text(110, "Crash: check", 0)], "PASS", ""),
    "sixty times": (
        [text(20 + 0.5 * i, "Throttle saturated", 2) for i in range(60)],
        "WARN",
        "'Throttle saturated' at 20.0 s, 60 times",
    ),
    "begins and ends": (
        [text(20, "GPS Glitch", 2), text(26, "GPS Glitch cleared", 2)],
        "WARN",
        "'GPS Glitch' at 20.0 to 26.0 s",
    ),
    "an error and its end": (
        [text(20, "GPS: error 2", 3, "error"), text(23, "GPS: resolved", 6, "error")],
        "WARN",
        "'GPS: error 2' at 20.0 to 23.0 s",
    ),
    "the grave one first": (
        [*(text(11 + i, w, 4) for i, w in enumerate(("a failure", "b failure", "c failure",
         "d failure", "e failure", "f failure"))), text(30, "Crash: Disarming", 0)],
        "FAIL",
        "'Crash: Disarming' at 30.0 s, 'a failure' at 11.0 s",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TEXTS.values(), ids=TEXTS.keys())
def test_texts_count_by_severity_time_and_end(case: tuple[list[Event], str, str]) -> None:
    events, verdict, evidence = case
    check = texts_check(FlightData("x", events=events), ARMED)
    assert check.verdict == verdict
    assert check.evidence.startswith(evidence)


def test_findings_are_told_in_order_of_time_with_the_first_cause_first() -> None:
    def check(name: str, verdict: str, start_s: float) -> FlightCheck:
        return FlightCheck(
            name=name, verdict=verdict, evidence="x", windows=((start_s, start_s + 1.0),)
        )

    checks = [
        check("clipping", "FAIL", 5.4), check("attitude", "WARN", 5.1),
        check("GPS fix", "WARN", -9.0), check("vibration", "PASS", 1.0),
    ]  # fmt: skip
    assert [(t_s, c.name) for t_s, c in chain_of(checks)] == [(5.1, "attitude"), (5.4, "clipping")]
    assert chain_text(checks) == "attitude from 5.1 s, then clipping from 5.4 s"


def test_of_a_repeated_message_the_summary_has_the_first_ones_and_counts_the_rest(
    flight: Flight,
) -> None:
    texts = tuple((2, 6, b"Gyro: %d" % i) for i in range(500))
    summary = outcome(flight(texts=(*texts, (9, 6, b"Terrain loaded")))).summary
    said = [event["text"] for event in summary["events"]]
    assert [text for text in said if text.startswith("Gyro")] == [f"Gyro: {i}" for i in range(200)]
    assert "Terrain loaded" in said
    assert summary["events_omitted"] == {"text: Gyro: #": 300}


def test_times_are_found_in_windows_that_overlap_or_are_out_of_order() -> None:
    t_s = np.arange(10.0)
    inside = inside_windows(t_s, [(6.0, 7.0), (1.0, 3.5), (3.0, 4.0)])
    assert t_s[inside].tolist() == [1.0, 2.0, 3.0, 4.0, 6.0, 7.0]
    assert not inside_windows(t_s, []).any()
    assert inside_windows(t_s, None).all()
