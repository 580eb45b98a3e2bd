import contextlib
import json
import resource
import shutil
import warnings
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.replaying.playback import split_records
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.edit_log import Edit, read_edits
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.label import Label, read_labels

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pymavlink import mavutil

WALL_US = 1_700_000_000_000_000


def heartbeat(seq: int) -> bytes:
    return build_frame(message_layout("HEARTBEAT"), {"type": 2, "mavlink_version": 3}, seq=seq)


def test_a_session_can_be_read_before_it_is_closed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, {"seed": 3})
    tape = CaptureBuffer()
    tape.receive(WALL_US, 1, heartbeat(0))
    tape.send(WALL_US + 5, heartbeat(0))
    recorder.write(tape, [Label(id="a", fault="bias", t0_us=0, start_us=1)])
    assert list(split_records((tmp_path / "received.tlog").read_bytes())) == [
        (WALL_US, heartbeat(0))
    ]
    assert list(split_records((tmp_path / "sent.tlog").read_bytes())) == [
        (WALL_US + 5, heartbeat(0))
    ]
    assert [label.id for label in read_labels(tmp_path / "labels.jsonl")] == ["a"]
    recorder.close(7, WALL_US + 9)
    session = json.loads((tmp_path / "session.json").read_text())
    assert session == {"seed": 3, "t0_us": 7, "end_us": WALL_US + 9}


def test_the_files_are_for_their_user_only_and_links_are_not_followed(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    folder = tmp_path / "log"
    folder.mkdir()
    for name in ("received.tlog", "session.json", "session.json.new"):
        (folder / name).symlink_to(elsewhere)  # dangling
    Recorder(folder, {"seed": 1}).close(None, 0)
    assert not elsewhere.exists()
    files = [path for path in folder.iterdir() if path.is_file()]
    assert len(files) == 8
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}


def test_an_earlier_session_is_moved_and_never_overwritten(tmp_path: Path) -> None:
    for number in range(3):
        Recorder(tmp_path, {"seed": number}).close(None, 0)
    seeds = [
        json.loads((tmp_path / folder / "session.json").read_text())["seed"]
        for folder in ("earlier-1", "earlier-2", ".")
    ]
    assert seeds == [0, 1, 2]


def test_bytes_that_are_not_a_frame_do_not_hide_frames_in_the_log(tmp_path: Path) -> None:
    tape = CaptureBuffer()
    frames = [heartbeat(seq) for seq in range(40)]
    for number, raw in enumerate(frames):
        tape.send(WALL_US + number * 1000, raw)
        broken = raw[:-1] + b"\0"
        tape.send(WALL_US + number * 1000 + 1, (b"boot: fine\r\n", broken)[number % 2])
    path = tmp_path / "sent.tlog"
    path.write_bytes(tape.drain().sent)
    ours = [raw for _, raw in split_records(path.read_bytes())]
    assert [raw for raw in ours if raw in frames] == frames
    log = mavutil.mavlink_connection(str(path))
    theirs = 0
    while (message := log.recv_match()) is not None:
        theirs += message.get_type() == "HEARTBEAT"
    log.close()
    assert theirs == 40


@contextlib.contextmanager
def files_no_larger_than(size: int) -> Iterator[None]:
    """Act like a nearly full disk: accept a part of a write and refuse the next one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_stops_recording_until_there_is_space(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, {})
    tape = CaptureBuffer()
    label = Label(id="a", fault="bias", t0_us=0, start_us=1)
    edit = Edit(3, 0, 0, "rflysim")
    for n in range(3):
        tape.receive(WALL_US + n, 0, heartbeat(n))
    with files_no_larger_than(200):
        recorder.write(tape, [], [edit])
        for n in range(3, 100):
            tape.receive(WALL_US + n, 0, heartbeat(n))
        recorder.write(tape, [label], [edit.at_record(50)])
        assert recorder.failing
    assert len((tmp_path / "received.tlog").read_bytes()) % (8 + len(heartbeat(0))) == 0
    tape.receive(WALL_US + 100, 0, heartbeat(100))
    recorder.write(tape)
    recorder.close(None, 0)
    assert recorder.failing is None
    kept = [
        n for _, raw in split_records((tmp_path / "received.tlog").read_bytes()) for n in [raw[4]]
    ]
    assert kept == [0, 1, 2, 100]
    assert len((tmp_path / "received.index").read_bytes()) == 4 * 6
    assert [one.id for one in read_labels(tmp_path / "labels.jsonl")] == ["a"]
    assert [one.at for one in read_edits(tmp_path / "edits.jsonl")] == [3, 3]
    assert json.loads((tmp_path / "session.json").read_text())["lost_records"] == 97


def test_a_removed_folder_is_created_again(tmp_path: Path) -> None:
    folder = tmp_path / "log"
    recorder = Recorder(folder, {})
    tape = CaptureBuffer()
    tape.receive(WALL_US, 0, heartbeat(0))
    recorder.write(tape)
    shutil.rmtree(folder)
    tape.receive(WALL_US + 1, 0, heartbeat(1))
    recorder.write(tape)
    shutil.rmtree(folder)
    recorder.close(None, 0)  # closing must not raise
    assert not folder.exists()
    assert tape.count == 1


def test_recording_resumes_when_a_failed_disk_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "log"
    recorder = Recorder(folder, {})
    tape = CaptureBuffer()
    for n in range(100):
        tape.receive(WALL_US + n, 0, heartbeat(n))
    with files_no_larger_than(200):
        recorder.write(tape)
    assert recorder.failing
    folder.rename(tmp_path / "old")  # like an unmounted disk
    tape.receive(WALL_US + 100, 0, heartbeat(100))
    recorder.write(tape)
    assert recorder.failing is None
    recorder.close(None, 0)
    assert [raw[4] for _, raw in split_records((folder / "received.tlog").read_bytes())] == [100]
    assert len((folder / "received.index").read_bytes()) == 6


class Uncut(FileIO):
    """A file on a disk that has become read-only."""

    def truncate(self, size: int | None = None) -> int:
        raise OSError(30, "Read-only file system")


def test_a_truncation_that_failed_is_repeated_when_the_disk_is_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, {})
    tape = CaptureBuffer()
    for n in range(100):
        tape.receive(WALL_US + n, 0, heartbeat(n))
    whole = recorder._files
    with contextlib.ExitStack() as opened, files_no_larger_than(200):
        recorder._files = {
            name: opened.enter_context(Uncut(file.name, "wb")) for name, file in whole.items()
        }
        recorder.write(tape)
    recorder._files = whole
    assert (tmp_path / "received.tlog").stat().st_size == 200
    tape.receive(WALL_US + 100, 0, heartbeat(100))
    recorder.write(tape)
    recorder.close(None, 0)
    assert recorder.failing is None
    assert [raw[4] for _, raw in split_records((tmp_path / "received.tlog").read_bytes())] == [100]


def test_a_folder_that_cannot_be_written_is_a_user_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="give a folder"):
        Recorder(tmp_path / "file" / "log", {})
