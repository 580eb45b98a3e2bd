"""The run folder's files."""

import json
from pathlib import Path

from analysis.report.run_folder import write_summary


def test_a_number_that_is_not_finite_is_null_in_a_summary(tmp_path: Path):
    write_summary(tmp_path, {"a": [1.0, float("nan")], "b": {"c": float("inf")}, "d": "nan"})
    found = json.loads((tmp_path / "summary.json").read_text())
    assert found == {"a": [1.0, None], "b": {"c": None}, "d": "nan"}
