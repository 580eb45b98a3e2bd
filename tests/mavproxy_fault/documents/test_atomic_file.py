import os
from pathlib import Path

import pytest

from mavproxy_fault.documents.atomic_file import replace_file, write_all, write_atomic


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


def test_a_replaced_log_is_the_user_s_own_and_no_link(tmp_path: Path) -> None:
    path, secret = tmp_path / "a.tlog", tmp_path / "elsewhere"
    path.write_bytes(b"an earlier log, open to all")
    path.chmod(0o666)
    with path.open("rb") as reader, replace_file(path) as log:
        write_all(log, b"new")
        assert reader.read() == b"an earlier log, open to all"  # another file
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o600
    path.unlink()
    for target in (secret, tmp_path):
        path.symlink_to(target)  # dangling, and to something that is there
        with pytest.raises(FileExistsError):
            replace_file(path)
        path.unlink()
    assert not secret.exists()
