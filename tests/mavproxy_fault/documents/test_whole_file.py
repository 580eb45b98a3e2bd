from pathlib import Path

import pytest

from mavproxy_fault.documents.whole_file import write_whole


def test_a_writer_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_whole(path, "old\n")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "half of it \ud800")  # no file can hold half a pair
    assert path.read_text() == "old\n"
    write_whole(path, "new é\n")
    assert path.read_text(encoding="utf-8") == "new é\n"
    assert [one.name for one in tmp_path.iterdir()] == ["summary.json"]
