"""Class, modes and phases of a vehicle; each check holds for some classes and one phase."""

import numpy as np
import pytest
from pymavlink import mavutil

from analysis.report.curves.recording import FlightData, Signal, Span
from analysis.report.curves.vehicle_phase import (
    ARDUPILOT,
    CLASSES,
    MODES,
    PX4,
    armed_windows,
    class_by_texts,
    flying_windows,
    mode_name,
)
from analysis.report.flight_checks import flight_checks
from analysis.report.judging.check_limits import Thresholds


@pytest.mark.parametrize("mav_type", sorted(mavutil.AP_MAV_TYPE_MODE_MAP_DEFAULT))
def test_modes_are_those_of_pymavlink(mav_type: int) -> None:
    theirs = mavutil.AP_MAV_TYPE_MODE_MAP_DEFAULT[mav_type]
    ours = MODES[CLASSES[mav_type]]
    assert {number: ours.get(number) for number in theirs} == theirs


def test_a_mode_is_named_by_the_class_of_the_vehicle() -> None:
    assert mode_name(ARDUPILOT, CLASSES[12], 19) == "MANUAL"
    assert mode_name(ARDUPILOT, CLASSES[2], 19) == "AVOID_ADSB"
    assert mode_name(ARDUPILOT, CLASSES[10], 16) == "INITIALISING"
    assert mode_name(PX4, CLASSES[2], 4 << 16 | 6 << 24) == "LAND"
    assert mode_name(PX4, CLASSES[2], 4 << 16 | 20 << 24) == "DESCEND"  # a blind landing


@pytest.mark.parametrize(
    ("text", "quad", "kind"),
    [
        ("ArduCopter V4.5.7 (2a3dc4b7)", 0, "copter"),
        ("ArduPlane V4.4.0", 0, "plane"),
        ("ArduPlane V4.4.0", 1, "VTOL"),
        ("ArduRover V4.2.3", 0, "rover"),
        ("ArduSub V4.1.0", 0, "sub"),
        ("AntennaTracker V4.5.0", 0, "tracker"),
        ("Blimp V4.5.0", 0, "blimp"),
        ("ChibiOS: 6a85082c", 0, ""),
    ],
)
def test_the_firmware_names_the_class(text: str, quad: float, kind: str) -> None:
    assert class_by_texts(["Barometer 1 ready", text], {"Q_ENABLE": quad}) == kind


def flight(vehicle: str) -> FlightData:
    """Two motors of four at full output on the ground, from 2 to 8 s, and in the air to 20 s."""
    t_s = np.arange(0.0, 30.0, 0.1)
    found = FlightData("x", "ardupilot", duration_s=30.0, vehicle=vehicle)
    found.spans.append(Span("armed", 2.0, 28.0, "armed", "mode"))
    height = np.clip(t_s - 8.0, 0.0, 10.0) * (t_s < 20.0)
    found.signals.append(Signal("height", "estimate", t_s, height))
    ground = t_s < 8.0
    for i in range(4):
        output = np.where(ground & (i < 2), 1.0, 0.5)
        found.signals.append(Signal("actuators", f"motor {i + 1}", t_s, output))
    return found


def test_the_air_begins_with_the_height_and_ends_with_the_landing() -> None:
    assert armed_windows(flight("copter")) == [(2.0, 28.0)]
    ((start_s, end_s),) = flying_windows(flight("copter")) or ()
    assert (start_s, end_s) == (pytest.approx(9.1), pytest.approx(19.9))
    said = flight("copter")
    said.spans.append(Span("flying", 7.0, 21.0, "flying", "mode"))
    assert flying_windows(said) == [(7.0, 21.0)]


def test_a_controller_that_is_wound_up_on_the_ground_is_not_judged() -> None:
    found = {check.name: check for check in flight_checks(flight("copter"), Thresholds())}
    assert found["motors at their limit"].verdict == "PASS"
    assert found["motor balance"].verdict == "PASS"


def test_a_sub_has_no_lifting_motors_and_no_fix() -> None:
    found = {check.name: check for check in flight_checks(flight("sub"), Thresholds())}
    for name in ("motor balance", "motors at their limit", "GPS fix", "ground impact"):
        assert found[name].verdict == "not judged"
        assert found[name].evidence == "does not hold for a sub"


def test_a_bench_without_sky_is_not_judged() -> None:
    t_s = np.arange(0.0, 60.0, 0.2)
    fixes = [Signal("gps-fix", "1", t_s, np.zeros(len(t_s)))]
    for state, verdict in (("disarmed", "not judged"), ("armed", "WARN")):
        spans = [Span("armed", 0.0, 60.0, state, "mode")]
        found = FlightData("x", duration_s=60.0, signals=fixes, spans=spans, vehicle="copter")
        checks = {check.name: check for check in flight_checks(found, Thresholds())}
        assert checks["GPS fix"].verdict == verdict


@pytest.mark.parametrize(("name", "verdict"), [("eph", "WARN"), ("vdop", "not judged")])
def test_the_horizontal_dilution_is_judged(name: str, verdict: str) -> None:
    t_s = np.arange(0.0, 60.0, 0.2)
    dilution = [Signal("gps-dilution", name, t_s, np.full(len(t_s), 3.0))]
    found = flight_checks(FlightData("x", duration_s=60.0, signals=dilution), Thresholds())
    assert {c.name: c.verdict for c in found}["GPS dilution of precision"] == verdict


def test_a_vehicle_that_has_tipped_over_no_longer_flies() -> None:
    t_s = np.arange(0.0, 100.0, 0.1)
    height_m = np.interp(t_s, [0, 10, 60, 65, 100], [0, 20, 20, 0, 0])
    spans = [Span("armed", 0.0, 99.0, "armed", "mode"), Span("flying", 2.0, 99.0, "flying", "mode")]
    flight = FlightData("r", signals=[Signal("height", "estimate", t_s, height_m)], spans=spans)
    ((start_s, end_s),) = flying_windows(flight) or []
    assert (start_s, end_s) == (2.0, pytest.approx(65.0, abs=0.2))


def test_windows_in_the_air_are_what_armed_and_flying_have_in_common() -> None:
    flights = 3000
    armed = [Span("armed", 60.0 * i, 60.0 * i + 40, "armed", "mode") for i in range(flights)]
    air = [Span("flying", 60.0 * i + 5, 60.0 * i + 15, "flying", "mode") for i in range(flights)]
    air += [Span("flying", 60.0 * i + 30, 60.0 * i + 50, "flying", "mode") for i in range(flights)]
    found = flying_windows(FlightData("x", spans=armed + air)) or []
    assert found[:3] == [(5.0, 15.0), (30.0, 40.0), (65.0, 75.0)]
    assert len(found) == 2 * flights
