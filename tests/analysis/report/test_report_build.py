"""A run's report holds injected faults and decisions, in one file that needs no network."""

import json
import re
from pathlib import Path

import msgspec
import numpy as np

from analysis.report.page.report_tables import attitude_tables
from analysis.report.recordings.from_results import isolation_matrix, recording_of_results
from analysis.report.run_report import write_run_report
from analysis.results import AttitudeError, Decision, Result
from mavproxy_fault.wire.label import Label

T0_US = 1_000_000
JUMP = Label(
    id="jump<1>",
    fault="bias",
    targets=("PSEUDORANGE.G05",),
    t0_us=T0_US,
    start_us=T0_US + 10_000_000,
    end_us=T0_US + 19_500_000,
    frames=10,
)
SUMMARY = {
    "verdict": "PASS",
    "sim_s": 30.0,
    "wall_s": 1.0,
    "epochs": 30,
    "false_alarms": 0,
    "untestable_epochs": 0,
    "attitude_rmse_deg": {"roll": 0.1, "pitch": 0.1, "yaw": 0.2, "max": 0.2},
    "position_rmse_m": 1.5,
    "faults": [
        {
            "id": "jump<1>",
            "target": "PSEUDORANGE.G05",
            "start_s": 10.0,
            "end_s": 19.5,
            "frames": 10,
            "detected": True,
            "delay_s": 0.5,
            "isolated": ["G05"],
            "verdict": "isolated",
        }
    ],
    "criteria": [{"name": "false alarms", "limit": 0, "value": 0, "passed": True}],
}


def decisions() -> list[Result]:
    found: list[Result] = []
    for second in range(30):
        bad = 10 <= second < 20
        t_us = T0_US + second * 1_000_000
        found.append(
            Decision(
                t_us=t_us,
                statistic=40.0 if bad else 3.0,
                threshold=18.5,
                dof=2,
                p_value=None,
                alarm=bad,
                hypothesis="satellites" if bad else "none",
                excluded=("G05",) if bad else (),
                satellites=("G01", "G05"),
                residual_m=(0.5, None),
            )
        )
        found.append(AttitudeError(t_us=t_us, estimator="ekf", roll=0, pitch=0, yaw=1, angle=1))
    return found


def written(tmp_path: Path) -> str:
    path = write_run_report(
        tmp_path, summary=SUMMARY, labels=[JUMP], results=decisions(), columns={}
    )
    return path.read_text()


def model(text: str) -> dict[str, object]:
    found = re.search(r'<script type="application/json" id="model">(.*?)</script>', text)
    assert found is not None
    decoded: dict[str, object] = json.loads(found[1])
    return decoded


def test_the_file_refers_to_nothing_outside_itself(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert not re.search(r'(src|href)="(?!#)', text)
    assert "@import" not in text


def test_injected_and_detected_spans_are_on_the_timeline(tmp_path: Path) -> None:
    spans = model(written(tmp_path))["spans"]
    assert [(s["lane"], s["start"], s["end"]) for s in spans] == [
        ("injected: jump<1>", 10.0, 19.5),
        ("detected: GNSS", 10.0, 20.0),
        ("excluded: G05", 10.0, 20.0),
    ]


def test_text_from_a_log_or_label_is_escaped(tmp_path: Path) -> None:
    text = written(tmp_path)
    assert "jump<1>" not in text
    assert "jump&lt;1&gt;" in text


def test_the_statistic_its_threshold_and_residuals_have_plots(tmp_path: Path) -> None:
    panels = {panel["key"]: panel for panel in model(written(tmp_path))["panels"]}
    assert [s["name"] for s in panels["fdi-statistic"]["series"]] == ["statistic", "threshold"]
    assert [s["name"] for s in panels["fdi-residual"]["series"]] == ["G01", "G05"]
    assert "error-yaw" in panels


def test_an_excluded_satellite_has_a_gap_in_its_residuals() -> None:
    kept = [
        msgspec.structs.replace(d, satellites=("G01",), residual_m=(0.5,))
        if 10 <= d.t_s - T0_US * 1e-6 < 12
        else msgspec.structs.replace(d, residual_m=(0.5, 1.0))
        for d in decisions()
        if isinstance(d, Decision)
    ]
    found = recording_of_results([], kept, T0_US)
    curve = next(s for s in found.of("fdi-residual") if s.name == "G01")
    other = next(s for s in found.of("fdi-residual") if s.name == "G05")
    assert len(curve.t_s) == len(other.t_s) == 30
    assert np.flatnonzero(np.isnan(other.value)).tolist() == [10, 11]


def test_attitude_scores_are_given_by_phase_and_fault() -> None:
    part = {
        "samples": 5, "rmse_deg": dict.fromkeys(("roll", "pitch", "yaw", "angle"), 1.25),
        "angle_percentiles_deg": {"95": 2.0}, "max_deg": {"angle": 3.0},
    }  # fmt: skip
    scores = {**part, "nominal": part, "phases": {"climb": part}, "faults": {"jump": part}}
    ((section, table),) = attitude_tables({"attitude": {"ekf": scores}})
    assert section == "Attitude"
    assert all(table.head)  # a screen reader says every column
    labels = [row[0] for row in table.rows]
    assert labels == ["entire flight", "without faults", "phase: climb", "fault: jump"]


def test_every_column_of_a_runs_page_has_a_name(tmp_path: Path) -> None:
    path = write_run_report(
        tmp_path, summary=SUMMARY, labels=[JUMP], results=decisions(), columns={}
    )
    assert "<th></th>" not in path.read_text()


def test_a_criterion_that_is_not_met_is_the_reason_for_the_verdict(tmp_path: Path) -> None:
    failed = {"name": "false alarms", "limit": 0, "value": 3, "passed": False}
    summary = {**SUMMARY, "verdict": "FAIL", "criteria": [failed]}
    path = write_run_report(
        tmp_path, summary=summary, labels=[JUMP], results=decisions(), columns={}
    )
    assert "false alarms: 3, limit 0" in path.read_text()


def test_the_isolation_matrix_counts_epochs_by_injected_fault() -> None:
    heads, rows = isolation_matrix([JUMP], decisions())
    assert heads == ["none", "G05"]
    assert rows == {"jump<1>": [0, 10], "10 s after a fault": [10, 0], "no fault": [10, 0]}
