"""The search page's data of a flight."""

import json
from pathlib import Path

import numpy as np
import pytest

from analysis.search.search_session import SearchSession
from analysis.search.space.fault_range import FaultRange
from analysis.search.space.test_file import FlightEnvelope, InitialState, TestFile
from analysis.search_page import flight_data as module
from analysis.search_page.flight_data import flight_data

FAULT = FaultRange(
    fault="bias", any_of=["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro"], value=(0.1, 0.2), at_s=0.25
)
TEST = TestFile(duration_s=1.0, initial=InitialState(roll_deg=(-30.0, 30.0)), faults=[FAULT])


def flown(test: TestFile, folder: Path) -> tuple[SearchSession, dict]:
    session = SearchSession(test, folder)
    session.next()
    return session, json.loads(flight_data(session))


def test_the_estimate_is_the_truth_plus_its_error(tmp_path: Path) -> None:
    _, flight = flown(TEST, tmp_path)
    off = np.array(flight["estimate"]) - np.array(flight["truth"])
    assert off == pytest.approx(np.array(flight["error"]), abs=2e-5)
    assert np.abs(flight["error"]).max() > 0.1  # the fault misleads it


def test_the_path_begins_at_nought_and_goes_east_north_and_up(tmp_path: Path) -> None:
    session, flight = flown(TEST, tmp_path)
    path = np.array(flight["path"]).T
    assert path[0].tolist() == [0.0, 0.0, 0.0]
    moved = session.trace.truth[-1, :3] - session.trace.truth[0, :3]
    assert path[-1] == pytest.approx([moved[1], moved[0], -moved[2]], abs=1e-4)


def test_parameters_have_their_ranges_and_a_target_its_name(tmp_path: Path) -> None:
    session, flight = flown(TEST, tmp_path)
    found = {one["name"]: one for one in flight["parameters"]}
    assert set(found) == {"initial.roll_deg", "faults[0].value", "faults[0].target"}
    assert (found["initial.roll_deg"]["low"], found["initial.roll_deg"]["high"]) == (-30.0, 30.0)
    assert found["initial.roll_deg"]["value"] == session.values["initial.roll_deg"]
    (fault,) = flight["faults"]
    assert fault["what"] == f"bias on {found['faults[0].target']['value']}"
    assert (fault["at_s"], fault["for_s"]) == (0.25, None)


def test_a_flight_is_shown_as_far_as_its_envelope(tmp_path: Path) -> None:
    session, flight = flown(
        TestFile(
            duration_s=1.0,
            initial=InitialState(q_dps=60.0),
            envelope=FlightEnvelope(pitch_deg=10.0),
        ),
        tmp_path,
    )
    count = len(session.trace.truth)
    assert 1 < count < 101
    assert len(flight["t"][0]) == len(flight["q"][0]) == count
    assert flight["title"] == "test 0: left the envelope"


def test_a_long_flight_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_SAMPLES", 40)
    _, flight = flown(TEST, tmp_path)
    assert flight["step"] == 3
    assert flight["t"][0][:3] == [0.01, 0.04, 0.07]
