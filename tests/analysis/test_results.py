"""The schema of results."""

import math
from pathlib import Path

from analysis.results import Decision, SensorDecision, decode, encode, read_results


def decision(t_s: float) -> Decision:
    return Decision(
        t_us=int(t_s * 1e6),
        statistic=3.5,
        threshold=25.0,
        dof=6,
        p_value=0.74,
        alarm=False,
        hypothesis="none",
        excluded=("G12",),
    )


def test_a_result_survives_json() -> None:
    assert decode(encode(decision(1.0))) == decision(1.0)


def test_the_type_of_a_result_is_in_its_json() -> None:
    sensor = SensorDecision(
        t_us=0, sensor="baro", statistic=math.inf, threshold=1, dof=1, alarm=True
    )
    assert b'"type":"SensorDecision"' in encode(sensor)
    assert decode(encode(sensor)).statistic is None  # type: ignore[union-attr]


def test_an_incomplete_line_is_skipped(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    file.write_bytes(encode(decision(1.0)) + b"\n" + encode(decision(2.0))[:20])
    assert list(read_results(file)) == [decision(1.0)]
