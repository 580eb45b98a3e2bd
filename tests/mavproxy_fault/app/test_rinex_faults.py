"""`replay` of a RINEX file: faults in a real recording, labels beside it, and errors."""

import pytest

from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.cli import main
from mavproxy_fault.rinex.rinex_text import read_rinex_text
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.label import latest_labels, read_labels

STEP = {"fault": "bias", "target": "PSEUDORANGE.G19", "value": 50, "at_s": 10, "for_s": 5}
LOSS = {"fault": "drop", "target": "PSEUDORANGE.G17", "value": 1.0, "at_s": 20, "for_s": 2}


@pytest.fixture
def recording(shared_data):
    return shared_data / "gnss_static" / "SEPT078M.21O"


def schedule(*faults):
    return parse_schedule({"seed": 1, "faults": list(faults)})


def test_faults_act_from_the_first_epoch_on_as_on_a_link(recording):
    healthy = read_rinex_text(recording)
    lines, labels = faulted_lines(recording, schedule(STEP, LOSS))
    changed = [(a, b) for a, b in zip(healthy, lines, strict=True) if a.rstrip() != b.rstrip()]
    steps = [float(b[3:17]) - float(a[3:17]) for a, b in changed if a.startswith("G19")]
    assert steps == pytest.approx([50.0] * 5)
    assert [b[3:17].strip() for a, b in changed if a.startswith("G17")] == ["", ""]
    assert len(changed) == 7
    step, loss = latest_labels(labels)
    assert (step.frames, step.magnitude, step.recorded) == (5, 50.0, True)
    assert (step.start_us - step.t0_us, step.end_us - step.t0_us) == (10_000_000, 15_000_000)
    assert loss.frames == 2


def test_the_command_writes_file_and_labels(recording, tmp_path):
    faults, out = tmp_path / "faults.yaml", tmp_path / "faulted.21O"
    faults.write_text("faults:\n  - {fault: bias, target: PSEUDORANGE.G19, value: 50, for_s: 5}\n")
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", str(out)]) == 0
    assert len(read_rinex_text(out)) == len(read_rinex_text(recording))
    assert [label.frames for label in read_labels(tmp_path / "faulted.21O.labels.jsonl")] == [5]


def test_an_output_that_cannot_be_written_is_refused_without_a_traceback(
    recording, tmp_path, capsys
):
    faults, file = tmp_path / "faults.yaml", tmp_path / "file"
    faults.write_text("faults:\n  - {fault: bias, target: PSEUDORANGE.G19, value: 50, for_s: 5}\n")
    file.touch()
    for out in (file / "faulted.21O", tmp_path):  # in a file instead of a folder; a folder
        command = ["replay", str(recording), "--schedule", str(faults), "--out", str(out)]
        assert main(command) == 2
        assert "; give a file that can be written\n" in capsys.readouterr().err
    navigation = recording.with_suffix(".21P")
    command = ["monitor", "--rinex", str(recording), str(navigation), "--calibrate"]
    assert main([*command, str(file / "noise.yaml")]) == 2
    assert "--calibrate" in capsys.readouterr().err


def test_a_fault_on_a_missing_satellite_is_reported(recording, tmp_path, capsys):
    faults, out = tmp_path / "faults.yaml", tmp_path / "faulted.21O"
    faults.write_text(
        "faults:\n"
        "  - {id: here, fault: bias, target: PSEUDORANGE.G19, value: 50, for_s: 5}\n"
        "  - {id: nowhere, fault: bias, target: PSEUDORANGE.G31, value: 50, for_s: 5}\n"
    )
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", str(out)]) == 0
    output = capsys.readouterr().err
    assert "fault nowhere (bias) matched no observation" in output
    assert "here (bias)" not in output.replace("nowhere (bias)", "")


def test_a_fault_that_cannot_act_on_a_file_is_refused(recording, tmp_path, capsys):
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults:\n  - {fault: bias, target: HIL_SENSOR.xgyro, value: 1}\n")
    out = str(tmp_path / "faulted.21O")
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", out]) == 2
    assert "cannot act on a RINEX file; give a PSEUDORANGE target" in capsys.readouterr().err
    assert main(["replay", str(recording), "--link", "udpout:127.0.0.1:9"]) == 2
    assert "needs --schedule FILE and --out FILE" in capsys.readouterr().err
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", str(recording)]) == 2
    assert "is the replayed file itself" in capsys.readouterr().err


def test_a_spoof_without_orbits_and_a_target_without_signals_are_refused(
    recording, tmp_path, capsys
):
    faults, out = tmp_path / "faults.yaml", str(tmp_path / "faulted.21O")
    faults.write_text("faults:\n  - {preset: gnss-carry-off}\n")
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", out]) == 2
    assert "spoofs another position" in (said := capsys.readouterr().err)
    assert "give --nav FILE" in said
    faults.write_text("faults:\n  - {fault: plant, target: PLANT.mass_kg_add, value: 1}\n")
    assert main(["replay", str(recording), "--schedule", str(faults), "--out", out]) == 2
    assert "PLANT target of satellites" in capsys.readouterr().err


def test_a_jammed_recording_loses_its_signals(recording):
    lines, labels = faulted_lines(
        recording, schedule({"preset": "gps-jamming", "at_s": 3, "for_s": 2})
    )
    healthy = read_rinex_text(recording)
    blank = [
        b for a, b in zip(healthy, lines, strict=True) if a[:1] in "GE" and not b[3:17].strip()
    ]
    assert len(blank) > 10
    assert [label.frames for label in latest_labels(labels)] == [2]
