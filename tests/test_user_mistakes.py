"""Mistakes on the command line give one line on standard error, with exit code 2."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from mavproxy_fault.cli import main

EXAMPLES = Path(__file__).parents[1] / "examples"
PROXY = ("proxy", "--zenoh", "off", "--to", "udpout:127.0.0.1:9", "--master")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "file").touch()
    (tmp_path / "not-text.yaml").write_bytes(b"\xff\xfe\0\n")
    (tmp_path / "foreign.jsonl").write_text("[1, 2]\n")
    (tmp_path / "log.tlog").write_bytes(bytes.fromhex("000000000000000afe0001c8010000000000000000"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((*PROXY, "udpin:127.0.0.1:0", "--logdir", "file/logs"), "file/logs: "),
        ((*PROXY, "udpin:127.0.0.1:99999"), "port 99999 is too large"),
        ((*PROXY, "udpin:127.0.0.1:0", "--run", ""), "--run ''"),
        ((*PROXY, "udpin:127.0.0.1:0", "--files", "file"), "--files file: is not a folder"),
        ((*PROXY, "udpin:127.0.0.1:0", "--rflysim-map", "file"), "without --rflysim PORT"),
        (
            (*PROXY, "udpin:127.0.0.1:0", "--schedule", "not-text.yaml"),
            "not-text.yaml: is not UTF-8 text",
        ),
        (("ui", "--port", "99999"), "--port 99999"),
        (("report", "log.tlog", "--labels", "foreign.jsonl"), "foreign.jsonl: Expected `object`"),
        (("report", "log.tlog", "--labels", "not-text.yaml"), "not-text.yaml: "),
        (("report", "log.tlog", "--criteria", "not-text.yaml"), "not-text.yaml: is not UTF-8 text"),
        (("monitor", "--log", "log.tlog", "--labels", "foreign.jsonl"), "foreign.jsonl: Expected"),
        (("monitor", "--log", "log.tlog", "--labels", "none.jsonl"), "none.jsonl: No such file"),
        (("replay", "log.tlog", "--schedule", "none.yaml", "--out", "x"), "none.yaml: "),
        (("run", "file/none.yaml", "--out", "out"), "file/none.yaml: cannot be read"),
        (("run", "--out", "file/out"), "--out file/out: Not a directory"),
    ],
)
def test_a_mistake_is_reported_in_one_line(
    folder: Path, words: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    message = capsys.readouterr().err
    assert message.startswith("mavproxy-fault: ")
    assert expected in message
    assert message.count("\n") == 1


def test_a_replay_into_a_folder_that_is_a_file_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "none.yaml").write_text("faults: []\n")
    assert main(("replay", "log.tlog", "--schedule", "none.yaml", "--out", "file/x.tlog")) == 2
    assert "--out file/x.tlog: " in capsys.readouterr().err


def test_names_beyond_the_letters_of_the_terminal_are_escaped(folder: Path) -> None:
    entry = "{id: \N{GRINNING FACE}, fault: bias, target: HIL_SENSOR.xgyro, value: 1}"
    (folder / "schedule.yaml").write_text(f"faults: [{entry}]\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", "faults", "check", "schedule.yaml"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert rb"\U0001f600" in done.stdout


def test_the_page_tells_who_holds_its_port(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert main(("ui", "--port", str(port))) == 2
    held = f"port {port} is in use by"
    assert f"--port {port}: Address already in use ({held}" in capsys.readouterr().err


SCHEMA = [sys.executable, "-m", "mavproxy_fault.cli", "faults", "schema"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no such device here")
def test_a_full_output_is_reported_in_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(SCHEMA, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr == "mavproxy-fault: No space left on device; the output is incomplete\n"


def test_what_a_shell_has_closed_is_no_sockets_number() -> None:
    code = "import os; from mavproxy_fault.cli import _reopen_closed_streams as reopen; "
    code += "reopen(); os.write(3, b'%d' % os.dup(2))"
    closed = ["sh", "-c", 'exec "$@" 3>&1 1>&- 2>&-', "sh"]
    done = subprocess.run([*closed, sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert int(done.stdout) > 3


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no such device here")
def test_a_device_without_an_end_is_not_read(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    assert main(("report", "log.tlog", "--labels", "/dev/zero")) == 2
    assert "/dev/zero: is not a file" in capsys.readouterr().err


def test_a_run_in_a_folder_that_is_gone_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "gone").mkdir()
    monkeypatch.chdir(folder / "gone")
    (folder / "gone").rmdir()
    assert main(("run", "--zenoh", "off", "--gcs", "off")) == 2
    assert "give a writable folder with --out" in capsys.readouterr().err


def test_a_misspelt_command_is_answered_with_the_nearest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(("injct", "bias")) == 2
    expected = "mavproxy-fault: injct: is not a command; did you mean inject?\n"
    assert capsys.readouterr().err == expected


@pytest.mark.parametrize(
    "words", [("run", "--zenoh", "off", "--gcs", "off"), ("report", "."), ("search", "test.yaml")]
)
def test_a_system_without_semaphores_is_reported_in_one_line(
    words: tuple[str, ...],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("multiprocessing.synchronize._multiprocessing.SemLock", refused)
    (folder / "test.yaml").write_text((EXAMPLES / "gyro_search.yaml").read_text())
    workers = ("--workers", "2") if words[0] == "search" else ()
    assert main([*words, *workers, "--out", "out"]) == 2
    assert "make sure that /dev/shm exists and is writable" in capsys.readouterr().err
