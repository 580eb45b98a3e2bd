"""Opening of logs: compressed logs are unpacked, other files are errors."""

import gzip
import lzma
import os
from pathlib import Path

import pyarrow as pa
import pytest

from analysis.report.recordings.log_paths import log_file, log_files
from mavproxy_fault.documents.errors import ConfigError

CONTENT = bytes(range(256)) * 100


@pytest.mark.parametrize("ending", ["gz", "xz", "zst"])
def test_a_compressed_log_is_unpacked_under_its_own_name(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"flight.tlog.{ending}"
    if ending == "zst":
        with pa.CompressedOutputStream(str(path), "zstd") as file:
            file.write(CONTENT)
    else:
        packed = gzip.compress(CONTENT) if ending == "gz" else lzma.compress(CONTENT)
        path.write_bytes(packed)
    found = log_file(path, tmp_path / "unpacked")
    assert found.name == "flight.tlog"
    assert found.read_bytes() == CONTENT
    assert log_file(path, tmp_path / "unpacked").name == "2-flight.tlog"


@pytest.mark.parametrize("ending", ["gz", "xz", "zst"])
def test_a_truncated_compressed_log_is_an_error(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"flight.tlog.{ending}"
    path.write_bytes(b"no such format")
    with pytest.raises(ConfigError, match="cannot be unpacked"):
        log_file(path, tmp_path)


def test_a_pipe_and_an_lfs_pointer_are_errors_and_do_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.tlog")
    (tmp_path / "lfs.ulg").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    (tmp_path / "good.tlog").write_bytes(CONTENT)
    names = ("pipe.tlog", "lfs.ulg", "none.tlog", "good.tlog")
    found, messages = log_files([tmp_path / name for name in names], tmp_path)
    assert [path.name for path in found] == ["good.tlog"]
    assert [text.rpartition(": ")[2].split(";")[0] for text in messages] == [
        "is a pipe or a device",
        "is a Git LFS pointer, not the log",
        "there is no such file",
    ]
