from pathlib import Path

import numpy as np
import pytest

import mavproxy_fault

SHORT = {
    "name": "short",
    "duration_s": 8,
    "start": {"lat_deg": 47.4, "lon_deg": 8.5, "alt_m": 488.0, "height_m": 100.0},
    "mission": [{"shape": "eight", "size_m": 800, "height_m": 100, "speed_mps": 25}],
    "schedule": {"faults": []},
}


def test_a_run_gives_labels_results_and_columns_as_arrays(tmp_path: Path) -> None:
    step = {"id": "step", "fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.3, "at_s": 3}
    run = mavproxy_fault.run(
        SHORT, schedule={"faults": [{**step, "for_s": 2}]}, seed=4, out=tmp_path / "flight"
    )
    (label,) = run.labels
    assert (label.id, label.frames) == ("step", 500)
    sent, received = run.columns["HIL_SENSOR"], run.received_columns["HIL_SENSOR"]
    change = sent["xgyro"] - received["xgyro"]
    assert np.count_nonzero(change) == 500
    assert change.max() == pytest.approx(0.3, abs=1e-6)
    errors = run.results["AttitudeError"]
    assert errors["angle"].dtype == float
    assert len(errors["angle"]) == len(errors["t_us"]) > 50
    assert run.summary["sim_s"] == pytest.approx(8, abs=0.1)
    assert run.report.is_file()
    frame = run.frame("HIL_SENSOR")
    assert frame["xgyro"].max() == sent["xgyro"].max()
    assert len(run.frame("HIL_SENSOR", received=True)) == len(received)
    assert list(run.frame("AttitudeError")["estimator"].unique()) == ["ekf"]
    # An array field is a list in each row.
    attitude = next(iter(run.frame("HIL_STATE_QUATERNION")["attitude_quaternion"]))
    assert len(attitude) == 4
    lines = run.plot("HIL_SENSOR.xgyro", "HIL_SENSOR.zacc").axes[0].lines
    assert lines[0].get_ydata().max() > lines[1].get_ydata().max() + 0.2
    assert f">{run.summary['faults'][0]['verdict']}</td>" in run._repr_html_()
    again = mavproxy_fault.monitor(
        run.folder / "sent.tlog", labels=run.folder / "labels.jsonl", out=tmp_path / "again"
    )
    assert again.summary["faults"][0]["id"] == "step"
    assert again._repr_html_().startswith(f"<b>{again.verdict} ")


def test_an_invalid_scenario_is_refused() -> None:
    with pytest.raises(mavproxy_fault.ConfigError, match="mision"):
        mavproxy_fault.run({**SHORT, "mision": []})
