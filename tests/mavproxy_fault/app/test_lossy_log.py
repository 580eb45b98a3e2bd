import logging
import os
from pathlib import Path

import pytest

from mavproxy_fault.app.lossy_log import LONGEST, LossyHandler


def line(text: str) -> logging.LogRecord:
    return logging.makeLogRecord({"msg": text})


def test_lines_that_would_block_are_dropped_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reader, writer = os.pipe()
    with os.fdopen(reader, "rb", buffering=0) as heard, os.fdopen(writer, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        handler = LossyHandler()
        for number in range(10_000):  # a pipe has room for 64 kB
            handler.emit(line(f"line {number}"))
        came = heard.read(1 << 20).decode().splitlines()
        handler.emit(line("after"))
        word, after = heard.read(1 << 20).decode().splitlines()
    assert came == [f"line {number}" for number in range(len(came))]
    assert word == f"({10_000 - len(came)} lines are missing here)"
    assert after == "after"


def test_a_long_line_is_cut_to_the_size_of_a_pipe_write(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with (tmp_path / "log").open("w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        LossyHandler().emit(line("é" * 9000 + "the end"))
    written = (tmp_path / "log").read_bytes()
    assert len(written) <= LONGEST + 1
    assert written.decode().endswith("the end\n")
