"""`report` writes a page, numbers and JUnit XML, and its exit code is the verdict."""

import csv
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from analysis.report.recordings.flight_sources import read_flight
from mavproxy_fault.cli import main
from mavproxy_fault.wire import tlog

Flight = Callable[..., Path]
ROOT = Path(__file__).parents[3]


def report(*arguments: object) -> int:
    return main(["report", *map(str, arguments)])


def test_a_nominal_flight_exits_0_and_writes_three_files(flight: Flight, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert report(flight(), "--out", out) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "junit.xml",
        "report.html",
        "summary.json",
    ]


def test_the_summary_has_the_keys_that_scripts_use(flight: Flight, tmp_path: Path) -> None:
    report(flight(), "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["verdict"] == "PASS"
    assert summary["sim_s"] == pytest.approx(19.8)
    for key in ("wall_s", "epochs", "false_alarms", "untestable_epochs", "position_rmse_m"):
        assert key in summary
    assert summary["faults"] == []
    assert summary["signals"]["roll"]["ATTITUDE"]["p99"] == pytest.approx(5.73, abs=0.01)


def test_a_failed_flight_exits_1_and_fails_its_junit_case(flight: Flight, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert report(flight(vibration=75.0), "--out", out) == 1
    suite = ET.parse(out / "junit.xml").getroot()
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["vibration"]
    assert suite.get("failures") == "1"


def test_criteria_move_the_limits(flight: Flight, tmp_path: Path) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("vibration_ardupilot_mps2: [80, 90]\n")
    path = flight(vibration=75.0)
    assert report(path, "--criteria", limits, "--out", tmp_path / "out") == 0


def test_a_log_that_cannot_be_read_exits_2_and_the_others_are_reported(
    flight: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "foreign.tlog"
    foreign.write_bytes(b"hello " * 1000)
    out = tmp_path / "out"
    assert report(flight(), foreign, tmp_path / "none.tlog", "--out", out) == 2
    assert (out / "flight" / "report.html").is_file()
    said = capsys.readouterr().err
    assert "foreign.tlog: 6000 bytes without MAVLink frames" in said
    assert "none.tlog: there is no such file" in said


def test_the_report_on_a_corrupted_log_says_how_much_is_missing(
    flight: Flight, tmp_path: Path
) -> None:
    path = flight()
    data = bytearray(path.read_bytes())
    data[1000:1600] = bytes(600)
    path.write_bytes(data)
    report(path, "--out", tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["junk_bytes"] >= 550
    check = next(check for check in summary["checks"] if check["name"] == "log is complete")
    assert check["verdict"] == "WARN"


def test_against_overlays_curves_and_lists_differing_parameters(
    flight: Flight, tmp_path: Path
) -> None:
    one, other = flight("one"), flight("other", seconds=5, vibration=20.0)
    report(one, "--against", other, "--out", tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text()
    assert "Checks side by side" in text
    assert "motors against the reference" in text
    assert "z \\u00b7 other" in text
    assert "<td>WPNAV_SPEED</td>" in text


def test_figures_are_written_in_three_forms(flight: Flight, tmp_path: Path) -> None:
    records = tlog.read_records(flight(seconds=5))
    few = [(t_us, raw) for t_us, raw, layout in records if layout and layout.name == "GPS_RAW_INT"]
    (tmp_path / "few.tlog").write_bytes(b"".join(tlog.log_record(*record) for record in few))
    report(tmp_path / "few.tlog", "--figures", "--out", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert {"speed.png", "speed.svg", "speed.pdf", "map.png", "map.svg", "map.pdf"} <= names


def test_csv_parquet_and_mcap_hold_the_same_rows(
    flight: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tlog, "BLOCK_FRAMES", 500)
    path = flight()
    rows = tlog.read_columns(path)["ATTITUDE"]
    for form in ("csv", "parquet", "mcap"):
        report(path, "--export", form, "--out", tmp_path / form)
    with (tmp_path / "csv" / "export" / "ATTITUDE.csv").open() as file:
        read = list(csv.DictReader(file))
    assert [int(row["time_boot_ms"]) for row in read] == rows["time_boot_ms"].tolist()
    table = pq.read_table(tmp_path / "parquet" / "export" / "ATTITUDE.parquet")
    assert table["roll"].to_pylist() == rows["roll"].tolist()
    with (tmp_path / "mcap" / "export" / "flight.mcap").open("rb") as file:
        messages = [
            (message.log_time, json.loads(message.data))
            for _, _, message in make_reader(file).iter_messages(topics=["/ATTITUDE"])
        ]
    stamps = np.array([stamp for stamp, _ in messages])
    assert np.diff(stamps).tolist() == (np.diff(rows["t_us"]) * 1000).tolist()
    assert [values["yaw"] for _, values in messages] == rows["yaw"].tolist()


def test_messages_of_a_tlog_are_on_the_clock_of_positions_and_results(
    flight: Flight, tmp_path: Path
) -> None:
    assert tlog.read_columns(flight())["ATTITUDE"]["t_us"][0] > 10**15  # the computer's, not so
    report(flight(), "--export", "mcap", "--out", tmp_path / "out")
    with (tmp_path / "out" / "export" / "flight.mcap").open("rb") as file:
        first: dict[str, int] = {}
        for _, channel, message in make_reader(file).iter_messages():
            first.setdefault(channel.topic, message.log_time)
    assert abs(first["/ATTITUDE"] - first["/pose/attitude"]) < 10**6


def test_foxglove_reads_positions_transforms_and_events_by_its_own_schemas(
    flight: Flight, tmp_path: Path
) -> None:
    report(flight(), "--export", "mcap", "--out", tmp_path / "out")
    found: dict[str, list[tuple[str, int, Any]]] = {}
    with (tmp_path / "out" / "export" / "flight.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        channels = reader.get_summary().channels.values()
        typed = [channel.topic for channel in channels if channel.message_encoding == "protobuf"]
        for schema, channel, message, value in reader.iter_decoded_messages(topics=typed):
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, value))
    kinds = {topic: rows[0][0] for topic, rows in found.items()}
    recording = read_flight([flight()], ()).recording
    for track in recording.tracks:
        topic = f"/position/{track.name.lower().replace(' ', '_')}"
        assert kinds[topic] == "foxglove.LocationFix"
        assert [row[2].latitude for row in found[topic]] == track.lat_deg.tolist()
    assert kinds["/transforms"] == "foxglove.FrameTransform"
    assert kinds["/pose/attitude"] == "foxglove.PoseInFrame"
    yaw = recording.of("yaw")[0].value[0]
    turn = found["/pose/attitude"][0][2].pose.orientation
    # Level: the nose points east at a yaw of 90 degrees, where ROS counts from.
    assert 2 * np.rad2deg(np.arctan2(turn.z, turn.w)) == pytest.approx(90 - yaw, abs=5)
    for name, log_time, value in found["/pose/attitude"]:
        assert value.timestamp.seconds * 10**9 + value.timestamp.nanos == log_time, name


def test_the_layouts_show_topics_of_the_export() -> None:
    views = ROOT / "examples" / "views"
    layout = json.loads((views / "foxglove.json").read_text())
    shown = set(re.findall(r'"/[\w./]+"', json.dumps(layout["configById"])))
    known = (
        "/position/",
        "/pose/",
        "/received.HIL_SENSOR",
        "/sent.HIL_SENSOR",
        "/results/",
        "/log",
    )
    assert all(topic.strip('"').startswith(known) for topic in shown)
    curves = ET.parse(views / "plotjuggler.xml").iter("curve")
    assert all(curve.attrib["name"].startswith(known) for curve in curves)


def test_a_run_folder_is_reported_with_its_labels_and_results(
    flight: Flight, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    flight().rename(folder / "received.tlog")
    (folder / "labels.jsonl").write_text(
        '{"id":"a","fault":"bias","t0_us":1000000,"start_us":2000000,"end_us":3000000}\n'
    )
    (folder / "results.jsonl").write_text(
        '{"type":"SensorDecision","t_s":1.5,"t_us":2500000,"sensor":"baro","statistic":9.0,'
        '"threshold":3.0,"dof":1,"alarm":true}\n{"type":"SensorDec'
    )
    report(folder, "--export", "mcap", "--out", tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text()
    assert '"lane": "injected: a"' in text
    assert '"lane": "detected: baro"' in text
    for source in (folder / "results.jsonl", tmp_path / "out" / "export" / "run.mcap"):
        report(source, "--out", tmp_path / "again")
        assert '"lane": "detected: baro"' in (tmp_path / "again" / "report.html").read_text()


def test_each_log_of_a_run_is_reported_with_the_runs_labels_results_and_criteria(
    flight: Flight, tmp_path: Path
) -> None:
    folder, own = tmp_path / "run", tmp_path / "run" / "autopilot" / "log"
    own.mkdir(parents=True)
    (folder / "sent.tlog").write_bytes(flight().read_bytes())
    (own / "flight.tlog").write_bytes(flight().read_bytes())
    alone = flight().rename(tmp_path / "alone.tlog")
    (folder / "labels.jsonl").write_text(
        '{"id":"a","fault":"bias","t0_us":1000000,"start_us":2000000,"end_us":3000000}\n'
    )
    row = {"name": "vehicle outcome", "limit": "at most failsafe", "value": "x", "passed": False}
    (folder / "summary.json").write_text(json.dumps({"criteria": [row]}))
    for log in (folder, folder / "sent.tlog", own / "flight.tlog"):
        assert report(log, "--out", tmp_path / "out") == 1, log
        text = (tmp_path / "out" / "report.html").read_text()
        assert '"lane": "injected: a"' in text, log
        assert "criterion: vehicle outcome" in text, log
    report(alone, "--out", tmp_path / "out")
    assert "injected: a" not in (tmp_path / "out" / "report.html").read_text()
