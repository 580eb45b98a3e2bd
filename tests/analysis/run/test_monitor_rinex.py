"""`monitor --rinex` end to end: a verdict, errors against the truth, files for other programs."""

import json
from math import radians

import numpy as np
import pytest
from pynmeagps import ERR_RAISE, NMEAReader

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig
from analysis.recordings.position_reference import read_reference
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision
from analysis.run.monitor_command import monitor_recording
from analysis.run.terminal_summary import print_summary
from mavproxy_fault.cli import main
from mavproxy_fault.numerics.earth import ecef_from_geodetic

TRUTH = "-3962108.6836,3381309.5672,3668678.6720"


@pytest.fixture(scope="module")
def folder(shared_data, tmp_path_factory):
    """The folder of a monitored recording, with its summary."""
    out, data = tmp_path_factory.mktemp("rinex") / "run", shared_data / "gnss_static"
    files = [str(data / "SEPT078M.21O"), str(data / "SEPT078M.21P")]
    code = main(
        ["monitor", "--rinex", *files, f"--truth={TRUTH}", "--zenoh", "off", "--out", str(out)]
    )
    assert code == 0
    return out


def test_the_verdict_uses_epochs_and_errors(folder):
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"] == "PASS"
    assert [row["name"] for row in summary["criteria"]] == [
        "horizontal error at 95 %, m",
        "vertical error at 95 %, m",
        "share of epochs with an unexplained alarm",
        "share of epochs tested",
    ]
    errors = summary["position_error"]["filter"]
    assert errors["epochs"] == 900
    assert errors["horizontal_95_m"] < 1.5
    assert summary["alarms"] == 0
    for row in summary["integrity"].values():
        assert row["with_level"] == 900
        assert row["misleading"] == 0


def test_unobservable_faults_are_reported(shared_data, tmp_path, capsys):
    data, schedule = shared_data / "gnss_static", tmp_path / "leap.yaml"
    schedule.write_text("faults: [{preset: gnss-spoof-jump, at_s: 100, for_s: 60}]\n")
    files = [str(data / "SEPT078M.21O"), str(data / "SEPT078M.21P")]
    given = ["--schedule", str(schedule), "--zenoh", "off", "--out", str(tmp_path / "run")]
    main(["monitor", "--rinex", *files, *given])
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["epochs_without_imu"] == 900
    assert summary["unbounded_epochs"] == 60
    output = capsys.readouterr().out
    assert "coordinated spoofing of all satellites" in output
    assert "60 of 900 positions: no protection level" in output


def test_the_position_file_has_rtklibs_format_and_all_positions(folder):
    written = read_reference(str(folder / "solution.pos"))
    lines = (folder / "results.jsonl").read_text().splitlines()
    decisions = [row for row in map(json.loads, lines) if row["type"] == "Decision"]
    assert written.t_us.tolist() == [row["t_us"] for row in decisions]
    apart = written.r_ecef_m - np.array([row["position_ecef_m"] for row in decisions])
    assert np.abs(apart).max() < 1e-3
    assert decisions[-1]["hdop"] > 0.4


def test_the_positions_are_written_as_nmea_sentences_too(folder):
    with (folder / "solution.nmea").open("rb") as file:
        sentences = [parsed for _, parsed in NMEAReader(file, quitonerror=ERR_RAISE)]
    fixes = [sentence for sentence in sentences if sentence.msgID == "GGA"]
    lines = (folder / "results.jsonl").read_text().splitlines()
    decisions = [row for row in map(json.loads, lines) if row["type"] == "Decision"]
    places = [(radians(fix.lat), radians(fix.lon), fix.alt + fix.sep) for fix in fixes]
    found = np.array([ecef_from_geodetic(*place) for place in places])
    assert np.abs(found - np.array([row["position_ecef_m"] for row in decisions])).max() < 2e-3
    assert {fix.quality for fix in fixes} == {1}
    assert fixes[0].time.isoformat() == "11:59:42"  # of 12:00:00 GPS time
    assert {sentence.msgID for sentence in sentences} == {"GGA", "RMC", "GST", "GSA"}


def test_the_report_has_the_sky_and_tracks_for_maps(folder):
    assert (folder / "report.html").read_text().count("data:image/svg+xml") == 5
    assert "truth" in (folder / "tracks.kml").read_text()
    assert json.loads((folder / "tracks.geojson").read_text())["features"]


def test_faults_of_a_schedule_are_found_in_the_recording(shared_data, tmp_path):
    data, faults = shared_data / "gnss_static", tmp_path / "faults.yaml"
    faults.write_text(
        "faults:\n"
        "  - {id: step, fault: bias, target: PSEUDORANGE.G19, value: 50, at_s: 300, for_s: 60}\n"
        "  - {id: ramp, fault: drift, target: PSEUDORANGE.E13, value: 0.5, at_s: 500, for_s: 60}\n"
        "  - {id: nowhere, fault: bias, target: PSEUDORANGE.G31, value: 50}\n"
    )
    files = [str(data / "SEPT078M.21O"), str(data / "SEPT078M.21P")]
    out = tmp_path / "run"
    given = ["--schedule", str(faults), f"--truth={TRUTH}", "--zenoh", "off", "--out", str(out)]
    assert main(["monitor", "--rinex", *files, *given]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["never_acted"] == ["nowhere (bias)"]
    assert [(row["verdict"], row["isolated"]) for row in summary["faults"]] == [
        ("isolated", ["G19"]),
        ("isolated", ["E13"]),
    ]
    assert (out / "labels.jsonl").is_file()


def test_a_recording_in_which_no_fault_acted_gives_no_verdict(shared_data, tmp_path):
    data, faults, out = shared_data / "gnss_static", tmp_path / "faults.yaml", tmp_path / "run"
    faults.write_text("faults:\n  - {id: x, fault: bias, target: PSEUDORANGE.G31, value: 50}\n")
    files = [str(data / "SEPT078M.21O"), str(data / "SEPT078M.21P")]
    given = ["--schedule", str(faults), "--zenoh", "off", "--out", str(out)]
    assert main(["monitor", "--rinex", *files, *given]) == 0
    assert json.loads((out / "summary.json").read_text())["verdict"] == "NO VERDICT"


def test_a_schedule_without_rinex_is_refused(tmp_path, capsys):
    code = main(["monitor", "--log", "flight.tlog", "--schedule", "faults.yaml"])
    assert code == 2
    assert "--schedule: needs --rinex" in capsys.readouterr().err


def test_a_stop_ends_a_recording_midway_with_the_results_so_far(shared_data):
    data, results, stops = shared_data / "gnss_static", [], iter((False, True))
    block = read_rinex(data / "SEPT078M.21O", data / "SEPT078M.21P")
    monitor_recording(block, Monitor(MonitorConfig()), results.extend, lambda: next(stops))
    decisions = [result for result in results if isinstance(result, Decision)]
    assert 0 < len(decisions) < 900
    assert all(decision.hdop is not None for decision in decisions)


def test_a_recording_that_is_refused_leaves_no_folder(shared_data, tmp_path, capsys):
    obs, wrong = shared_data / "gnss_static" / "SEPT078M.21O", tmp_path / "none.nav"
    out = tmp_path / "run"
    assert main(["monitor", "--rinex", str(obs), str(wrong), "--out", str(out)]) == 2
    assert "none.nav: No such file or directory; give a RINEX file" in capsys.readouterr().err
    assert not out.exists()


def test_reasons_of_untestable_epochs_are_reported(shared_data, tmp_path, capsys):
    data, lost = shared_data / "gnss_static", tmp_path / "lost.yaml"
    # All of GPS, and of Galileo all but two that are in view.
    names = ["G", *(f"E{n:02d}" for n in range(1, 37) if n not in (1, 13))]
    targets = [f"PLANT.satellite_lost[{name}]" for name in names]
    fault = {"fault": "plant", "target": targets, "value": 1, "at_s": 100, "for_s": 60}
    lost.write_text(json.dumps({"faults": [fault]}))
    files = [str(data / "SEPT078M.21O"), str(data / "SEPT078M.21P")]
    given = ["--schedule", str(lost), "--zenoh", "off", "--out", str(tmp_path / "run")]
    main(["monitor", "--rinex", *files, *given])
    reasons = json.loads((tmp_path / "run" / "summary.json").read_text())["untestable_reasons"]
    assert sum(reasons.values()) == 60
    reason, count = next(iter(reasons.items()))
    assert f"untestable      {count} epochs: {reason}\n" in capsys.readouterr().out


def test_many_alarms_without_labels_suggest_the_calibration(capsys):
    summary = {
        "sim_s": 600.0,
        "wall_s": 1.0,
        "alarms": 20,
        "epochs": 600,
        "epochs_without_imu": 600,
    }
    rest = dict.fromkeys(("position_rmse_m", "false_by_channel", "false_alarms"))
    rest |= {
        "watched": ["satellites"],
        "untestable_epochs": 0,
        "untestable_reasons": {},
        "unbounded_epochs": 0,
    }
    rest |= {"faults": [], "criteria": [], "attitude_rmse_deg": None, "verdict": "PASS"}
    print_summary(rest | summary, None)
    assert "fit the noise to a fault-free recording with --calibrate" in capsys.readouterr().out
    print_summary(rest | summary | {"false_alarms": 0}, None)
    print_summary(rest | summary | {"alarms": 2}, None)
    assert "--calibrate" not in capsys.readouterr().out
