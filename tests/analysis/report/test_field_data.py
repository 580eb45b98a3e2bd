"""Any field of any message: inside the file up to a size, or beside it."""

import base64
import zlib
from pathlib import Path

import numpy as np
import pytest

from analysis.report.curves.recording import Message
from analysis.report.page.field_data import FOLDER, field_data
from mavproxy_fault.documents.errors import ConfigError

T_S = np.arange(100_000) * 0.01


def messages() -> dict[str, Message]:
    rng = np.random.default_rng(1)
    lat = 470_000_000 + rng.integers(0, 1000, len(T_S))
    return {
        "FAST": Message(
            T_S, {"lat": lat, "noise": rng.normal(size=len(T_S)), "text": np.array(["a"])}
        ),
        "SLOW": Message(T_S[:10], {"vector": rng.normal(size=(10, 3))}),
    }


def numbers(text: str) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8)
    return np.ascontiguousarray(planes.reshape(4, -1).T).view("<f4")[:, 0]


def test_messages_that_do_not_fit_are_thinned_and_the_index_says_so(tmp_path: Path) -> None:
    found = field_data(messages(), "0.2", tmp_path)
    fast, slow = found.index
    assert (fast["name"], fast["rows"]) == ("FAST", 100_000)
    assert fast["step"] > 1
    assert slow["step"] == 1
    assert sum(map(len, found.inside.values())) < 0.4e6
    assert [field["name"] for field in fast["fields"]] == ["lat", "noise"]
    assert [field["name"] for field in slow["fields"]] == ["vector[0]", "vector[1]", "vector[2]"]


def test_large_numbers_keep_their_last_digit(tmp_path: Path) -> None:
    every = messages()
    found = field_data(every, "100", tmp_path)
    field = found.index[0]["fields"][0]
    at, n = field["y"]["at"], field["y"]["n"]
    back = numbers(found.inside[0])[at : at + n].astype(float) + field["add"]
    assert np.array_equal(back, every["FAST"].columns["lat"])


def test_data_beside_the_page_are_complete(tmp_path: Path) -> None:
    found = field_data(messages(), "beside", tmp_path)
    assert found.inside == {}
    assert [entry["step"] for entry in found.index] == [1, 1]
    text = (tmp_path / FOLDER / "0.js").read_text()
    assert text.startswith('report.fields.arrived(0,"')


def test_data_0_stores_no_fields(tmp_path: Path) -> None:
    assert field_data(messages(), "0", tmp_path).index == []


@pytest.mark.parametrize("where", ["-1", "aside", "inf"])
def test_an_invalid_size_is_refused_and_the_valid_ones_are_named(
    where: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=f"--data {where}: .*give MB or 'beside'"):
        field_data(messages(), where, tmp_path)
