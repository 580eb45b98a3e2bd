"""Key figures of a made and of a real flight."""

from pathlib import Path

import numpy as np
import pytest

from analysis.recordings.flight_logs.ulog import read_ulog
from analysis.report.curves.derived_curves import add_derived_curves, derive_curves
from analysis.report.curves.recording import FlightData, Message, Signal, Span
from analysis.report.judging.flight_facts import flight_facts
from analysis.report.recordings.from_autopilot_log import recording_of_log
from analysis.report.recordings.vehicle_identity import (
    identity_by_info,
    identity_by_messages,
    identity_by_texts,
)

T = np.arange(0.0, 100.0, 0.1)


def flight() -> FlightData:
    """10 m/s for 80 s armed, before and after 99 m/s while disarmed."""
    armed = (T >= 10) & (T <= 90)
    signals = [
        Signal("speed", "ground", T, np.where(armed, 10.0, 99.0)),
        Signal("height", "estimate", T, np.where(armed, T, -50.0)),
        Signal("roll", "ATTITUDE", T, np.full(len(T), 30.0)),
        Signal("pitch", "ATTITUDE", T, np.full(len(T), 40.0)),
    ]
    return FlightData("", signals=signals, spans=[Span("armed", 10.0, 90.0, "armed", "mode")])


def test_key_figures_are_those_while_armed() -> None:
    facts = dict(flight_facts(add_derived_curves(flight())))
    assert facts["armed"] == "80 s"
    assert facts["distance over ground"] == "800 m"
    assert facts["ground speed, mean and largest"] == "10.0 and 10.0 m/s"
    assert facts["height range"] == "80.0 m"
    # cos of the tilt is cos 30 cos 40.
    assert facts["largest tilt"] == "48°"


def test_a_log_without_arming_has_no_key_figures() -> None:
    recording = flight()
    recording.spans.clear()
    assert flight_facts(recording) == []


def test_key_figures_of_a_real_flight_equal_those_of_flight_review(shared_data: Path) -> None:
    """Flight Review: 6.1 m (in space, ours is over ground), 1 m, 3.1 km/h, 8.3 degrees."""
    log = read_ulog(shared_data / "ulog" / "gps_interference.ulg")
    facts = dict(flight_facts(add_derived_curves(recording_of_log(log, ""))))
    assert float(facts["distance over ground"].removesuffix(" m")) == pytest.approx(4.9, abs=0.3)
    assert facts["height range"] == "0.9 m"
    assert facts["ground speed, mean and largest"].endswith(" and 0.9 m/s")
    assert facts["largest tilt"] == "8°"


def test_intervals_show_gaps_but_not_those_of_a_thinned_log() -> None:
    t_s = np.delete(np.arange(0.0, 2.0, 0.004), slice(100, 110))
    (found,) = derive_curves(FlightData("", signals=[Signal("gyro", "x", t_s, t_s)]))[0]
    assert found.panel == "interval"
    assert np.median(found.value) == pytest.approx(4.0)
    assert found.value.max() == pytest.approx(44.0)
    thinned = np.sort(np.random.default_rng(0).choice(t_s, 200, replace=False))
    assert derive_curves(FlightData("", signals=[Signal("gyro", "x", thinned, thinned)]))[0] == []


def test_a_vehicle_is_known_by_what_it_says_of_itself() -> None:
    texts = (
        "ArduCopter V4.5.7 (2a3dc4b7)",
        "CubeOrange 003E0037 3236510A 31333035",
        "Frame: QUAD/X",
    )
    assert identity_by_texts(texts) == {
        "firmware": "ArduCopter V4.5.7 (2a3dc4b7)",
        "board": "CubeOrange",
        "UUID": "003E00373236510A31333035",
        "frame": "QUAD/X",
    }
    info = {"sys_name": "PX4", "ver_sw_release": 0x011003C0, "ver_sw": "eae80c15abc", "ver_hw": "X"}
    found = identity_by_info(info, {"MAV_TYPE": 2.0, "SYS_AUTOSTART": 4001.0})
    assert found["firmware"] == "PX4 1.16.3 rc (eae80c15)"
    assert found["frame"] == "quadrotor, airframe 4001"


def test_a_vehicle_is_known_by_the_version_that_it_sends() -> None:
    columns = {
        "flight_sw_version": np.array([0x040507FF]), "uid": np.array([0xAB]),
        "flight_custom_version": np.array([list(b"2a3dc4b7")]),
    }  # fmt: skip
    message = Message(np.zeros(1), columns)
    flown = FlightData("r", "ardupilot", messages={"AUTOPILOT_VERSION": message})
    assert identity_by_messages(flown) == {
        "firmware": "ArduPilot 4.5.7 (2a3dc4b7)",
        "UUID": "00000000000000AB",
    }
