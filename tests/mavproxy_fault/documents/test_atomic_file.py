import os
from pathlib import Path

import pytest

from mavproxy_fault.documents.atomic_file import write_atomic


def test_a_failed_write_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_atomic(path, "old\n")
    in_the_way = tmp_path / "summary.json.new"
    in_the_way.mkdir()
    with pytest.raises(IsADirectoryError):
        write_atomic(path, "half of it")
    in_the_way.rmdir()
    assert path.read_text() == "old\n"
    write_atomic(path, "new é\n")
    assert path.read_text(encoding="utf-8") == "new é\n"
    assert [one.name for one in tmp_path.iterdir()] == ["summary.json"]


def test_a_name_that_is_not_text_is_escaped_as_on_the_terminal(tmp_path: Path) -> None:
    write_atomic(tmp_path / "report.html", os.fsdecode(b"of \xff.tlog"))
    assert (tmp_path / "report.html").read_text() == "of \\udcff.tlog"
