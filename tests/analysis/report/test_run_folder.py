"""The run folder's files."""

import json
from pathlib import Path

import pytest

from analysis.report.recordings.flight_sources import read_flight
from analysis.report.run_folder import ResultFile, write_summary
from analysis.results import AttitudeError, read_results
from mavproxy_fault.documents.errors import ConfigError


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


@pytest.mark.parametrize("content", [b"", b'{"verdict": "PA', b"[1]", b"\xff{}"])
@pytest.mark.parametrize("name", ["", "sent.tlog"])
def test_a_damaged_summary_of_a_run_is_named(content: bytes, name: str, tmp_path: Path):
    (tmp_path / "sent.tlog").write_bytes(b"")
    (tmp_path / "summary.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"summary\.json: .*; remove the file"):
        read_flight([tmp_path / name], [])
