"""A dataflash log with wrong, missing and foreign bytes is read as far as it is whole."""

import struct
from pathlib import Path

import numpy as np
import pytest

from analysis.recordings.flight_logs.dataflash import HEAD, is_dataflash, read_dataflash

FORMATS = {  # name: (type, struct code, dataflash code, columns)
    "FMT": (128, "BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (129, "Q16sf", "QNf", "TimeUS,Name,Value"),
    "ATT": (130, "Qhhhhhh", "Qcccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "POS": (131, "Qiifff", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "VIBE": (132, "QBfffI", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    "EV": (133, "QB", "QB", "TimeUS,Id"),
}
SECONDS = 20


def row(name: str, *values: object) -> bytes:
    number, code, _, _ = FORMATS[name]
    return b"\xa3\x95" + bytes((number,)) + struct.pack("<" + code, *values)


def form(name: str) -> bytes:
    number, code, letters, columns = FORMATS[name]
    length = 3 + struct.calcsize("<" + code)
    return row("FMT", number, length, name.encode(), letters.encode(), columns.encode())


def log(*, without: str = "", boot_us: int = 60_000_000, lon: int = 85_000_000) -> bytes:
    """Twenty seconds of a flight at 10 Hz."""
    data = b"".join(form(name) for name in FORMATS if name != without)
    data += row("PARM", boot_us, b"FRAME_CLASS", 1.0) + row("EV", boot_us, 10)
    for tick in range(SECONDS * 10):
        t_us = boot_us + tick * 100_000
        data += row("ATT", t_us, 10, 12, 20, 22, 9000, 9000)
        data += row("POS", t_us + 9, 474_000_000, lon, 400.0, 10.0, 10.0)
        if tick % 10 == 0:
            data += row("VIBE", t_us + 20, 0, 5.0, 5.0, 6.0, 0)
    return data


def counts(path: Path, data: bytes) -> dict[tuple[str, int], int]:
    path.write_bytes(data)
    return {key: len(topic["TimeUS"]) for key, topic in read_dataflash(path).topics.items()}


def lost(before: dict[tuple[str, int], int], after: dict[tuple[str, int], int]) -> int:
    return sum(max(count - after.get(key, 0), 0) for key, count in before.items())


def test_any_one_wrong_byte_of_a_message_loses_at_most_two_messages(tmp_path: Path) -> None:
    whole = log()
    before = counts(tmp_path / "whole.bin", whole)
    rng = np.random.default_rng(1)
    first = len(FORMATS) * 89
    for place in rng.integers(first, len(whole), 300).tolist():
        data = bytearray(whole)
        data[place] ^= int(rng.integers(1, 256))
        assert lost(before, counts(tmp_path / "flip.bin", bytes(data))) <= 2, place


def test_a_wrong_byte_in_a_format_loses_at_most_two_messages(tmp_path: Path) -> None:
    whole = log()
    before = counts(tmp_path / "whole.bin", whole)
    # 0xff: outside of every alphabet, as most wrong bytes; the first format is that of formats.
    for place in range(89, len(FORMATS) * 89):
        data = bytearray(whole)
        data[place] ^= 0xFF
        assert lost(before, counts(tmp_path / "flip.bin", bytes(data))) <= 2, place


def test_a_wrong_byte_in_the_characters_of_a_format_gives_no_wrong_values(tmp_path: Path) -> None:
    data = bytearray(log())
    place = data.index(b"Qcccccc") + 2
    data[place] = 0x01
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(data))
    att = read_dataflash(path).topics["ATT", 0]
    assert "Roll" not in att  # its type is unknown
    assert att["Pitch"][0] == pytest.approx(0.22)


def test_messages_without_a_format_are_passed_over(tmp_path: Path) -> None:
    whole, without = (
        counts(tmp_path / "a.bin", log()),
        counts(tmp_path / "b.bin", log(without="VIBE")),
    )
    assert without == {key: count for key, count in whole.items() if key[0] != "VIBE"}


def test_text_in_front_of_a_log_is_passed_over(tmp_path: Path) -> None:
    text = b"INFO [blackbox] logging to file 12\n" * 3
    assert is_dataflash((text + log())[:HEAD])
    assert counts(tmp_path / "a.bin", text + log()) == counts(tmp_path / "b.bin", log())


def test_a_second_boot_in_the_file_comes_after_the_first(tmp_path: Path) -> None:
    path = tmp_path / "two.bin"
    path.write_bytes(log() + log())
    found = read_dataflash(path)
    assert found.times.clock.restarts == 1
    times = found.topics["ATT", 0]["TimeUS"]
    assert len(times) == 2 * SECONDS * 10
    assert np.all(np.diff(times) > 0)
    assert found.end_us - found.start_us == pytest.approx(2 * SECONDS * 1e6, abs=2e6)


def test_a_log_of_several_blocks_is_read_like_one_of_one_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = counts(tmp_path / "a.bin", log())
    monkeypatch.setattr("analysis.recordings.flight_logs.dataflash_blocks.BLOCK_BYTES", 5_003)
    assert counts(tmp_path / "a.bin", log()) == whole


def test_only_the_wanted_messages_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(log())
    assert {name for name, _ in read_dataflash(path, ("ATT",)).topics} == {"ATT"}


def test_an_old_log_keeps_its_milliseconds(tmp_path: Path) -> None:
    fields = b"TimeMS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"
    data = form("FMT") + row("FMT", 130, 19, b"ATT", b"Icccccc", fields)
    for tick in range(100):
        data += b"\xa3\x95\x82" + struct.pack("<Ihhhhhh", 60_000 + tick * 100, 1, 1, 1, 1, 1, 1)
    path = tmp_path / "old.bin"
    path.write_bytes(data)
    times = read_dataflash(path).topics["ATT", 0]["TimeUS"]
    assert times[[0, -1]].tolist() == [60_000_000, 69_900_000]


@pytest.mark.parametrize("at", [4, 10, 11, 12, 14])  # length, and characters of the columns
def test_a_wrong_byte_in_a_format_loses_no_message(tmp_path: Path, at: int) -> None:
    path, data = tmp_path / "a.bin", bytearray(log())
    whole = counts(path, bytes(data))
    begin = data.index(b"VIBE") - 5
    for wrong in (data[begin + at] ^ 1, ord("h"), ord("I"), ord("d"), ord("B")):
        changed = data.copy()
        changed[begin + at] = wrong
        assert counts(path, bytes(changed)) == whole, (at, wrong)
