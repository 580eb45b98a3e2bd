"""Reading label files, also those that somebody else wrote."""

from pathlib import Path

import msgspec
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.label import Label, read_labels

LINES = [msgspec.json.encode(Label(id=name, fault="bias", t0_us=0, start_us=1)) for name in "ab"]


@pytest.mark.parametrize("end", [b"\n", b""])
def test_the_last_label_needs_no_line_end(tmp_path: Path, end: bytes) -> None:
    path = tmp_path / "labels.jsonl"
    path.write_bytes(b"\n".join(LINES) + end)
    assert [label.id for label in read_labels(path)] == ["a", "b"]


def test_a_truncated_last_line_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "labels.jsonl"
    for cut in range(1, len(LINES[1])):
        path.write_bytes(LINES[0] + b"\n" + LINES[1][:cut])
        assert [label.id for label in read_labels(path)] == ["a"]


@pytest.mark.parametrize("wrong", [b'{"id": 3}', b'{"id": 3}\n', b"{\n", b"no label\n"])
def test_a_line_that_is_no_label_is_refused(tmp_path: Path, wrong: bytes) -> None:
    path = tmp_path / "labels.jsonl"
    path.write_bytes(LINES[0] + b"\n" + wrong)
    with pytest.raises(ConfigError, match=r"give a labels\.jsonl"):
        read_labels(path)
