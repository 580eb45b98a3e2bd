"""The run folder's files."""

import json
from pathlib import Path

from analysis.report.run_folder import ResultFile, write_summary
from analysis.results import AttitudeError, read_results


def test_a_number_that_is_not_finite_is_null_in_a_summary(tmp_path: Path):
    write_summary(tmp_path, {"a": [1.0, float("nan")], "b": {"c": float("inf")}, "d": "nan"})
    found = json.loads((tmp_path / "summary.json").read_text())
    assert found == {"a": [1.0, None], "b": {"c": None}, "d": "nan"}


def test_results_are_in_the_file_as_soon_as_they_are_written(tmp_path: Path):
    with ResultFile(tmp_path) as file:
        for t_us in range(3):
            file.write([AttitudeError(t_us=t_us, estimator="own", roll=1, pitch=0, yaw=0, angle=1)])
            # A process that is killed now leaves all of them.
            assert len(list(read_results(tmp_path / "results.jsonl"))) == t_us + 1
