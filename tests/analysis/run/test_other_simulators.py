"""A recorded link of jMAVSim without lockstep, through proxy and monitor."""

import json
from itertools import groupby
from pathlib import Path

from analysis.results import read_results
from mavproxy_fault.cli import main
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns, read_frames

RECORDED = Path(__file__).resolve().parents[2] / "data" / "jmavsim" / "hil.tlog"
NO_TRUTH = "faults: [{id: no-truth, fault: drop, target: HIL_STATE_QUATERNION}]"
GYRO = (
    "faults: [{id: gyro, fault: bias, target: 'HIL_SENSOR.zgyro', value: 0.5, at_s: 2, for_s: 1}]"
)


def replayed(schedule, folder):
    """The recording as the proxy would send it."""
    (folder / "faults.yaml").write_text(schedule)
    arguments = ["replay", str(RECORDED), "--schedule", str(folder / "faults.yaml")]
    assert main([*arguments, "--out", str(folder / "sent.tlog")]) == 0
    return folder / "sent.tlog"


def monitored(log, out):
    assert main(["monitor", "--log", str(log), "--zenoh", "off", "--out", str(out)]) == 0
    return json.loads((out / "summary.json").read_text())


def test_the_recording_is_out_of_step():
    names = [frame.layout.name for _, frame in read_frames(RECORDED)]
    link = [name for name in names if name in ("HIL_SENSOR", "HIL_ACTUATOR_CONTROLS")]
    runs = [len(list(run)) for name, run in groupby(link) if name == "HIL_SENSOR"]
    assert max(runs) > 4


def test_the_monitor_scores_it_against_its_truth(tmp_path):
    summary = monitored(RECORDED, tmp_path)
    assert summary["epochs"] == 60
    assert 0.0 < summary["attitude_rmse_deg"]["angle"] < 10.0
    assert summary["attitude"]["ekf"]["samples"] > 1000
    # jMAVSim sends several HIL_SENSOR with one timestamp; there are no other alarms.
    alarms = [
        one for one in read_results(tmp_path / "results.jsonl") if getattr(one, "alarm", False)
    ]
    assert alarms
    assert all("its timestamp is frozen" in one.reason for one in alarms)


def test_without_the_truth_no_attitude_is_scored(tmp_path):
    summary = monitored(replayed(NO_TRUTH, tmp_path), tmp_path / "monitored")
    assert summary["epochs"] == 60
    assert summary["attitude_rmse_deg"] is None
    assert summary["attitude"] == {}


def test_a_fault_changes_only_the_frames_of_its_second(tmp_path):
    log = replayed(GYRO, tmp_path)
    before = read_columns(RECORDED, {"HIL_SENSOR"})["HIL_SENSOR"]
    after = read_columns(log, {"HIL_SENSOR"})["HIL_SENSOR"]
    changed = after["zgyro"] - before["zgyro"] > 0.4
    stamps = before["time_usec"][changed]
    assert 200 < changed.sum() < 260
    assert 0.9e6 < int(stamps[-1]) - int(stamps[0]) <= 1e6
    assert len(read_labels(tmp_path / "sent.labels.jsonl")) > 0
