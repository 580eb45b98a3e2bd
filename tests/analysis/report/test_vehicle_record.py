from dataclasses import replace

import numpy as np
import pytest

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.curves.recording import (
    UNGRADED,
    Event,
    FlightData,
    GroundTrack,
    Signal,
    Span,
)
from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.vehicle_record import vehicle_outcome
from analysis.report.recordings.flight_sources import RecordedFlight
from analysis.report.recordings.from_tlog import recording_of_tlog
from mavproxy_fault.wire.tlog import row_dtype

STEP_US, FLIGHT_S = 50_000, 30.0
T_US = np.arange(1_000_000, round(FLIGHT_S * 1e6), STEP_US)


def rows_of(name, t_us, system=1, **values):
    rows = np.zeros(len(t_us), row_dtype(name))
    rows["t_us"], rows["system"], rows["component"] = t_us, system, 1
    for field, value in values.items():
        rows[field] = value
    return rows


def crashed_log(texts=()):
    """The truth falls at 8 m/s at 20 s; the autopilot's estimate comes down gently."""
    t_s = T_US * 1e-6
    up_m = np.clip((t_s - 3.0) * 4.0, 0.0, 10.0)
    true_m = np.minimum(up_m, np.clip(10.0 - (t_s - 20.0) * 8.0, 0.0, None))
    own_m = np.minimum(up_m, np.clip(10.0 - (t_s - 20.0) * 1.0, 0.0, None))
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(T_US), 1))
    seconds_us = np.arange(1, 30) * 1_000_000
    place = {"lat": 474_000_000, "lon": 85_000_000}
    columns = {
        "HIL_STATE_QUATERNION": rows_of(
            "HIL_STATE_QUATERNION", T_US, time_usec=T_US, alt=true_m * 1e3 + 4e5, **place,
            vz=-np.gradient(true_m, t_s) * 100.0, attitude_quaternion=quaternions,
        ),
        "GLOBAL_POSITION_INT": rows_of(
            "GLOBAL_POSITION_INT", T_US, time_boot_ms=T_US // 1000, alt=own_m * 1e3 + 4e5,
            relative_alt=own_m * 1e3, **place,
        ),
        "HEARTBEAT": rows_of(
            "HEARTBEAT", seconds_us, type=2, autopilot=3, custom_mode=4,
            base_mode=np.where((seconds_us > 2_000_000) & (seconds_us < 25_000_000), 209, 81),
        ),
    }  # fmt: skip
    if texts:
        columns["STATUSTEXT"] = rows_of(
            "STATUSTEXT", [t_us for t_us, _ in texts], severity=1,
            text=[text.encode() for _, text in texts],
        )  # fmt: skip
    return columns


def test_the_ground_impact_is_that_of_the_truth_and_not_of_the_estimate() -> None:
    flight = RecordedFlight(recording_of_tlog(crashed_log(), name="x"), ())
    assessed = assess_flight(flight, Thresholds())
    impact = next(check for check in assessed.checks if check.name == "ground impact")
    assert impact.verdict == "FAIL"
    assert assessed.summary["outcome"]["outcome"] == "crashed"
    assert assessed.summary["outcome"]["impact_mps"] == pytest.approx(8.0, abs=0.3)
    assert assessed.verdict == "FAIL"


def test_without_the_truth_the_estimate_is_all_there_is() -> None:
    columns = crashed_log()
    del columns["HIL_STATE_QUATERNION"]
    found = vehicle_outcome(add_derived_curves(recording_of_tlog(columns)))
    assert (found.outcome, found.source) == ("landed as commanded", "autopilot's estimate")


def test_a_crash_that_the_autopilot_reports_never_passes_because_a_fault_acted() -> None:
    columns = crashed_log([(21_000_000, "Crash: Disarming: AngErr=173>30, Accel=0.9<3.0")])
    recording = recording_of_tlog(columns, t0_us=0)
    recording.spans.append(Span("f", 18.0, 28.0, "bias", "injected"))
    assessed = assess_flight(RecordedFlight(recording, ()), Thresholds())
    said = next(check for check in assessed.checks if check.name == "messages of the autopilot")
    assert said.verdict == "FAIL"


def test_a_sensor_that_ardupilot_finds_unhealthy_in_flight_is_a_detection() -> None:
    columns = crashed_log()
    del columns["HIL_STATE_QUATERNION"]
    seen = rows_of("SYS_STATUS", T_US, onboard_control_sensors_enabled=0xC)
    # Not yet known at its start, the compass (4) is lost for a second.
    known = (T_US > 3_000_000) & ~((T_US >= 15_000_000) & (T_US < 16_000_000))
    seen["onboard_control_sensors_health"] = np.where(known, 0xC, 0x8)
    flight = add_derived_curves(recording_of_tlog(columns | {"SYS_STATUS": seen}))
    found = [(event.t_s, event.text) for event in flight.events if event.kind == "error"]
    assert found == [(14.0, "compass: error 4"), (15.0, "compass: resolved")]
    assert vehicle_outcome(flight).outcome == "detected"


def test_a_flight_that_px4_terminates_is_so_whatever_mode_was_set() -> None:
    columns = crashed_log([(15_100_000, "Failsafe activated")])
    del columns["HIL_STATE_QUATERNION"]
    beats = columns["HEARTBEAT"]
    beats["autopilot"], beats["custom_mode"] = 12, 3 << 24 | 4 << 16  # LOITER
    beats["system_status"] = np.where(beats["t_us"] >= 15_000_000, 8, 4)
    found = vehicle_outcome(add_derived_curves(recording_of_tlog(columns)))
    assert (found.failsafe, found.reason) == ("TERMINATION", "Failsafe activated")


def test_commands_of_a_ground_station_tell_a_failsafe_from_a_command() -> None:
    columns = crashed_log()
    del columns["HIL_STATE_QUATERNION"]
    beats = columns["HEARTBEAT"]
    beats["custom_mode"][beats["t_us"] >= 15_000_000] = 9  # LAND
    asked = rows_of("COMMAND_LONG", [2_000_000, 14_800_000], 255, target_system=1, command=176)
    asked["param1"], asked["param2"] = 1, [4, 9]
    for count, outcome in ((2, "landed as commanded"), (1, "failsafe")):
        found = vehicle_outcome(
            add_derived_curves(recording_of_tlog(columns | {"COMMAND_LONG": asked[:count]}))
        )
        assert found.outcome == outcome
    # A remote control may have chosen the mode.
    remote = rows_of("RC_CHANNELS", T_US, time_boot_ms=T_US // 1000, chancount=8, chan5_raw=1500)
    columns |= {"COMMAND_LONG": asked[:1], "RC_CHANNELS": remote}
    for component, outcome in ((1, "landed as commanded"), (51, "failsafe")):
        remote["component"] = component  # that of a simulator has sticks only
        found = vehicle_outcome(add_derived_curves(recording_of_tlog(columns)))
        assert found.outcome == outcome


def loiter(sticks: list[Signal]) -> FlightData:
    """A copter in the air that is moved by 60 m in LOITER from 20 to 30 s."""
    t_s = np.arange(0.0, 60.0, 0.1)
    height_m = np.interp(t_s, [0, 2, 10, 50, 58], [0, 0, 10, 10, 0])
    north_m = np.interp(t_s, [20, 30], [0, 60])
    track = GroundTrack("estimate", t_s, 47.0 + north_m / 111_195, np.full(600, 8.0), height_m)
    signals = [Signal("height", "estimate", t_s, height_m), *sticks]
    spans = [Span("armed", 1.0, 59.0, "armed", "mode"), Span("mode", 0.0, 60.0, "LOITER", "mode")]
    return FlightData(
        "x", "ardupilot", duration_s=60.0, signals=signals, spans=spans, tracks=[track],
        vehicle="copter",
    )  # fmt: skip


def test_a_copter_that_is_guided_by_commands_outside_the_log_leaves_no_place() -> None:
    flight = loiter([])
    flight.spans[1] = flight.spans[1]._replace(text="GUIDED")
    assert vehicle_outcome(flight).excursion_m == 0.0
    flight.events.append(Event(1.0, "command", "GUIDED"))
    assert vehicle_outcome(flight).excursion_m == pytest.approx(60.0, abs=1.0)


def channel(moved_us: float) -> list[Signal]:
    t_s = np.arange(0.0, 60.0, 0.1)
    pushed = (t_s > 19.0) & (t_s < 29.0)
    return [Signal("rc", "channel 2", t_s, 1500.0 + moved_us * pushed)]


@pytest.mark.parametrize(
    ("sticks", "degraded"), [(channel(200.0), False), ([], False), (channel(0.0), True)]
)
def test_a_pilot_may_move_a_copter_in_loiter(sticks: list[Signal], degraded: bool) -> None:
    found = vehicle_outcome(add_derived_curves(loiter(sticks)))
    assert (found.outcome == "degraded") == degraded


@pytest.mark.parametrize(("panel", "low"), [("rc", 1200.0), ("sticks", -0.5)])
def test_a_pilot_who_lowers_the_throttle_has_commanded_the_landing(panel: str, low: float) -> None:
    flight = loiter([])
    flight.events.append(Event(1.0, "command", "LOITER"))
    assert vehicle_outcome(flight).outcome == "landed uncommanded"
    t_s = np.arange(0.0, 60.0, 0.1)
    name, middle = ("channel 3", 1500.0) if panel == "rc" else ("throttle", 0.0)
    flight.signals.append(Signal(panel, name, t_s, np.where(t_s > 50.0, low, middle)))
    assert vehicle_outcome(flight).outcome == "landed as commanded"


def test_a_sub_neither_takes_off_nor_lands() -> None:
    flight = replace(loiter([]), vehicle="sub")
    assert (vehicle_outcome(flight).outcome, vehicle_outcome(flight).events) == ("not judged", [])


@pytest.mark.parametrize(("charge", "judged"), [(0, False), (5, True)])
def test_a_battery_that_is_always_at_zero_is_not_measured(charge: int, judged: bool) -> None:
    rows = rows_of("SYS_STATUS", T_US, battery_remaining=np.where(T_US < 9_000_000, charge, 0))
    found = recording_of_tlog({"SYS_STATUS": rows}).of("battery-remaining")
    assert any(np.isfinite(signal.value).any() for signal in found) == judged


def test_information_is_no_reason_for_a_failsafe() -> None:
    flight = loiter(channel(200.0))
    flight.events.append(Event(30.0, "text", "PrecLand: Failsafe Measures", UNGRADED))
    assert vehicle_outcome(flight).failsafe == ""
    flight.events.append(Event(31.0, "text", "Radio Failsafe", UNGRADED))
    assert vehicle_outcome(flight).reason == "Radio Failsafe"
