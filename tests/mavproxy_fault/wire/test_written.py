"""Files with a hole at their end: only the written part is read."""

from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.written import written_bytes

HOLE = 1 << 32


def with_hole(path: Path, data: bytes, at: int = 0) -> Path:
    with path.open("wb") as file:
        file.seek(at)
        file.write(data)
        file.truncate(HOLE)
    if path.stat().st_blocks * 512 > HOLE // 2:
        pytest.skip("this file system keeps no holes")
    return path


def test_the_end_is_where_the_last_data_are(tmp_path: Path) -> None:
    # Holes end with a block of the file system.
    assert len(b"abc") <= written_bytes(with_hole(tmp_path / "a", b"abc")) <= 1 << 16
    within = written_bytes(with_hole(tmp_path / "b", b"abc", at=1 << 24))
    assert (1 << 24) + 3 <= within <= (1 << 24) + (1 << 16)
    assert written_bytes(with_hole(tmp_path / "c", b"")) == 0


def test_a_file_without_a_hole_is_read_completely(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(10_000))
    assert written_bytes(tmp_path / "a") == 10_000
    (tmp_path / "b").touch()
    assert written_bytes(tmp_path / "b") == 0


def test_a_log_in_preallocated_space_is_read_up_to_its_written_end(tmp_path: Path) -> None:
    frame = build_frame(message_layout("HEARTBEAT"), {"type": 2})
    path = with_hole(tmp_path / "a.tlog", tlog.log_record(1_000_000, frame))
    log = tlog.read_log(path)
    assert len(log.frames) == 1
    assert log.size < 1 << 17
    with pytest.raises(ConfigError, match="the log is empty"):
        tlog.read_log(with_hole(tmp_path / "b.tlog", b""))
