"""Flights of a search under an autopilot: what is read from their run folders, and a real one."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from analysis.autopilots import flight_process
from analysis.results import AttitudeError, encode_lines
from analysis.search.evaluation import autopilot_flight
from analysis.search.evaluation.simulated_batch import SimulatedBatch
from analysis.search.space.test_file import TestFile, read_test
from mavproxy_fault.documents.errors import ConfigError

EXAMPLE = Path(__file__).parents[3] / "examples" / "autopilot_search.yaml"
VALUES = {"faults[0].value": 0.05, "faults[0].at_s": 6.0, "faults[0].for_s": 5.0}
VALUES |= {"faults[0].target": 0.0}
DOCUMENT = {"seed": 1, "schedule": {"faults": [{"id": "x"}]}}
HEALTHY_DEG, FAULTED_DEG = 3.0, 5.0


def written(
    folder: Path,
    error_deg: float,
    *,
    off_ground: bool = True,
    landed: bool = True,
    outcome: str = "degraded",
) -> Path:
    """A run folder: on the ground to 10 s, in the air to 20 s, with an error of roll."""
    run = folder / "run"
    run.mkdir(parents=True, exist_ok=True)
    moments = {"arming": 5.0} | ({"take-off": 10.0, "landing": 20.0} if off_ground else {})
    ended = "" if landed else "it fell"
    account = {"landed": landed, "ended_early": ended, "moments_s": moments}
    summary = {"autopilot": account, "faults": [], "outcome": {"outcome": outcome}}
    (run / "summary.json").write_text(json.dumps(summary))
    errors = [
        AttitudeError(
            t_us=t * 1_000_000,
            estimator=estimator,
            pitch=0.0,
            yaw=0.0,
            angle=roll,
            roll=roll,
        )
        for t in range(30)
        # Far off on the ground and while landing, which is not of the flight.
        for estimator, roll in (
            ("ATTITUDE", error_deg if 10 <= t < 20 else 90.0),
            ("ekf", 70.0),
        )
    ]
    (run / "results.jsonl").write_bytes(encode_lines(errors))
    return run


@pytest.fixture
def flights(monkeypatch):
    """What each flight is to show, taken one after the other; the healthy one is always alike."""
    coming: list[dict] = []
    flown: list[dict] = []

    def fly(subject, words, schedule, folder, *, kept):
        flown.append({"words": words, "schedule": schedule})
        if not schedule["faults"]:
            return written(folder, HEALTHY_DEG)
        return written(folder, **coming.pop(0))

    monkeypatch.setattr(flight_process, "run_flight_process", fly)
    autopilot_flight._reference_flight.cache_clear()
    yield coming, flown
    autopilot_flight._reference_flight.cache_clear()


@pytest.fixture
def choice():
    test = read_test(EXAMPLE)
    assert test.autopilot is not None
    return test.autopilot


def test_the_error_is_that_in_the_air_less_the_flight_without_faults(flights, choice):
    coming, flown = flights
    coming += [{"error_deg": FAULTED_DEG}, {"error_deg": 1.0}]
    found, error_deg = autopilot_flight.measure_autopilot_error(choice, DOCUMENT, 0.0)
    assert error_deg.tolist() == pytest.approx([4.0, 0.0, 0.0, 4.0])  # 5^2 = 3^2 + 4^2
    assert (found.lasted_s, found.ended_early) == (10.0, "")
    # With the next test's noise; the flight without faults is that of the first.
    _, error_deg = autopilot_flight.measure_autopilot_error(choice, {**DOCUMENT, "seed": 2}, 0.0)
    assert error_deg.tolist() == [0.0] * 4  # better than without: no fault has done that
    assert [bool(one["schedule"]["faults"]) for one in flown] == [False, True, True]
    assert flown[0]["words"][1:] == ["--autopilot", "px4"]


def test_a_failed_take_off_is_repeated_and_then_reported(flights, choice):
    coming, _ = flights
    coming += [{"error_deg": 0.0, "off_ground": False}] * 2 + [{"error_deg": FAULTED_DEG}]
    found, _ = autopilot_flight.measure_autopilot_error(choice, DOCUMENT, 0.0)
    assert found.lasted_s == 10.0
    coming += [{"error_deg": 0.0, "off_ground": False, "landed": False}] * 3
    with pytest.raises(ConfigError, match="the vehicle did not take off in 3 tries; it fell"):
        autopilot_flight.measure_autopilot_error(choice, DOCUMENT, 0.0)


@pytest.mark.parametrize("end", [{"landed": False}, {"outcome": "crashed"}])
def test_a_flight_that_does_not_land_by_itself_counts_as_a_crash(flights, end):
    coming, _ = flights
    coming += [{"error_deg": FAULTED_DEG, **end}]
    flown = SimulatedBatch(read_test(EXAMPLE))
    outcome = flown.evaluate_values({name: np.array([v]) for name, v in VALUES.items()}, 1, 0, 1)
    assert outcome.broken_limit.tolist() == [7]
    assert outcome.fitness[0] < 0.0  # worse than any that stayed in the air


def test_an_autopilot_needs_a_scenario():
    choice = {"kind": "px4"}
    with pytest.raises(ValueError, match="autopilot is set without scenario; give scenario too"):
        TestFile(estimator="autopilot", autopilot=choice)  # type: ignore[arg-type]


@pytest.mark.skipif(
    shutil.which(os.environ.get("MAVPROXY_FAULT_PX4", "")) is None,
    reason="MAVPROXY_FAULT_PX4 names no SITL program of PX4",
)
def test_a_real_px4_is_turned_by_a_gyro_bias_of_the_search(tmp_path):
    text = EXAMPLE.read_text().replace(
        "kind: px4", f"kind: px4, binary: {os.environ['MAVPROXY_FAULT_PX4']}"
    )
    (tmp_path / "search.yaml").write_text(text)
    shutil.copy(EXAMPLE.with_name("px4_brief_hover.yaml"), tmp_path)
    flown = SimulatedBatch(read_test(tmp_path / "search.yaml"))
    outcome = flown.evaluate_values({name: np.array([v]) for name, v in VALUES.items()}, 1, 0, 1)
    assert outcome.rmse_deg[0, 3] > 2.0
