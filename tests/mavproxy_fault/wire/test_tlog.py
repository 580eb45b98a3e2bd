"""Logs are read completely, however corrupted they are; pymavlink is the reference."""

import random
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire import frame as frames
from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.dialect import message_layout

NOON_US = 1_700_000_000_000_000


def hil_sensor(seq: int, system: int = 1) -> bytes:
    values = {"time_usec": 4000 * seq, "xgyro": 0.5 * seq, "id": seq % 3}
    return frames.build_frame(
        message_layout("HIL_SENSOR"), values, seq=seq % 256, system=system, component=51
    )


def text(seq: int, words: bytes) -> bytes:
    return frames.build_frame(message_layout("STATUSTEXT"), {"severity": 4, "text": words}, seq=seq)


def stamped(raw_frames: list[bytes], first_us: int = NOON_US) -> list[tuple[int, bytes]]:
    return [(first_us + 4000 * i, raw) for i, raw in enumerate(raw_frames)]


def written(path: Path, data: bytes | list[tuple[int, bytes]]) -> Path:
    if isinstance(data, list):
        path.write_bytes(b"".join(tlog.log_record(*record) for record in data))
    else:
        path.write_bytes(data)
    return path


def joined(records: list[tuple[int, bytes]]) -> bytes:
    return b"".join(tlog.log_record(t_us, raw) for t_us, raw in records)


def test_columns_contain_timestamp_sender_sequence_and_fields(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", stamped([hil_sensor(0), hil_sensor(1), text(2, b"hi")]))
    columns = tlog.read_columns(path)
    sensor = columns["HIL_SENSOR"]
    assert sensor["t_us"].tolist() == [NOON_US, NOON_US + 4000]
    assert sensor["component"].tolist() == [51, 51]
    assert sensor["seq"].tolist() == [0, 1]
    assert sensor["xgyro"].tolist() == [0.0, 0.5]
    assert columns["STATUSTEXT"]["text"].tolist() == [b"hi"]


def test_frames_are_read_in_order_as_written(tmp_path: Path) -> None:
    records = stamped([hil_sensor(0), text(1, b"x"), hil_sensor(2)])
    path = written(tmp_path / "a.tlog", records)
    assert [(t_us, frame.raw) for t_us, frame in tlog.read_frames(path)] == records


def test_version_1_and_signed_frames_are_read(tmp_path: Path) -> None:
    link = dialect.MAVLink(None, srcSystem=7, srcComponent=3)
    message = dialect.MAVLink_attitude_message(5, 0.1, 0.2, 0.3, 0, 0, 0)
    version_1 = message.pack(link, force_mavlink1=True)
    link.signing.secret_key = b"k" * 32
    link.signing.sign_outgoing = True
    link.signing.timestamp = 1
    signed = message.pack(link)
    assert version_1[0] == 0xFE
    assert signed[2] & 1
    path = written(tmp_path / "a.tlog", stamped([version_1, signed, version_1]))
    log = tlog.read_log(path)
    assert log.columns["ATTITUDE"]["roll"].tolist() == [np.float32(0.1)] * 3
    assert log.columns["ATTITUDE"]["system"].tolist() == [7, 7, 7]
    assert log.junk_bytes == 0


def test_an_unknown_message_is_kept_as_a_record_without_layout(tmp_path: Path) -> None:
    unknown = bytes((0xFD, 3, 0, 0, 9, 4, 5)) + (70000).to_bytes(3, "little") + b"abcXY"
    path = written(tmp_path / "a.tlog", stamped([hil_sensor(0), unknown, hil_sensor(1), unknown]))
    kinds = [layout.name if layout else None for _, _, layout in tlog.read_records(path)]
    assert kinds == ["HIL_SENSOR", None, "HIL_SENSOR", None]
    log = tlog.read_log(path)
    assert log.frames["id"].tolist() == [107, 70000, 107, 70000]
    assert log.frames["system"].tolist() == [1, 4, 1, 4]
    assert log.frames["seq"].tolist() == [0, 9, 1, 9]


@pytest.mark.parametrize("cut", [1, 8, 9, 20])
def test_a_truncated_end_costs_only_the_last_frame(tmp_path: Path, cut: int) -> None:
    data = joined(stamped([hil_sensor(i + 1) for i in range(10)]))
    path = written(tmp_path / "a.tlog", data[:-cut])
    assert len(tlog.read_columns(path)["HIL_SENSOR"]) == 9


@pytest.mark.parametrize("lost", range(0, 90, 3))
def test_a_lost_byte_costs_at_most_one_frame(tmp_path: Path, lost: int) -> None:
    data = joined(stamped([hil_sensor(i + 1) for i in range(4)]))
    path = written(tmp_path / "a.tlog", data[:lost] + data[lost + 1 :])
    log = tlog.read_log(path)
    assert len(log.columns["HIL_SENSOR"]) >= 3
    assert np.abs(log.frames["t_us"] - NOON_US).max() < 1_000_000


def test_a_frame_with_a_corrupted_timestamp_gets_that_of_its_neighbour(tmp_path: Path) -> None:
    records = stamped([hil_sensor(i) for i in range(6)])
    records[3] = (records[3][0] ^ 1 << 60, records[3][1])
    columns = tlog.read_columns(written(tmp_path / "a.tlog", records))
    assert columns["HIL_SENSOR"]["t_us"].tolist()[3] == NOON_US + 8000


def test_a_lasting_time_jump_is_kept(tmp_path: Path) -> None:
    records = stamped([hil_sensor(i) for i in range(3)])
    records += stamped([hil_sensor(i + 3) for i in range(3)], NOON_US - 86_400_000_000)
    columns = tlog.read_columns(written(tmp_path / "a.tlog", records))
    assert columns["HIL_SENSOR"]["t_us"].tolist() == [t_us for t_us, _ in records]


def test_timestamps_minutes_apart_are_kept(tmp_path: Path) -> None:
    records = [(NOON_US + i * 120_000_000, hil_sensor(i)) for i in range(5)]
    columns = tlog.read_columns(written(tmp_path / "a.tlog", records))
    assert columns["HIL_SENSOR"]["t_us"].tolist() == [t_us for t_us, _ in records]


def test_a_corrupted_first_timestamp_becomes_that_of_the_next(tmp_path: Path) -> None:
    records = stamped([hil_sensor(i) for i in range(4)])
    records[0] = (records[0][0] ^ 1 << 58, records[0][1])
    columns = tlog.read_columns(written(tmp_path / "a.tlog", records))
    assert columns["HIL_SENSOR"]["t_us"].tolist()[0] == records[1][0]


def test_joined_logs_of_two_vehicles_are_read_completely(tmp_path: Path) -> None:
    first = joined(stamped([hil_sensor(i) for i in range(5)]))
    second = joined(stamped([hil_sensor(i, system=2) for i in range(5)], NOON_US * 2))
    columns = tlog.read_columns(written(tmp_path / "a.tlog", first + b"\x00\xfd" + second))
    assert np.bincount(columns["HIL_SENSOR"]["system"]).tolist() == [0, 5, 5]


def test_all_blocks_together_equal_the_entire_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "a.tlog", stamped([hil_sensor(i) for i in range(20)]))
    complete = tlog.read_columns(path)["HIL_SENSOR"]
    monkeypatch.setattr(tlog, "BLOCK_FRAMES", 7)
    blocks = [block["HIL_SENSOR"] for block in tlog.read_blocks(path)]
    assert [len(block) for block in blocks] == [7, 7, 6]
    assert np.array_equal(np.concatenate(blocks), complete)
    assert np.array_equal(tlog.read_columns(path)["HIL_SENSOR"], complete)


def test_a_block_does_not_count_the_frames_of_those_that_follow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = [*(hil_sensor(i) for i in range(7)), *(text(i, b"x") for i in range(7))]
    path = written(tmp_path / "a.tlog", stamped(sent))
    monkeypatch.setattr(tlog, "BLOCK_FRAMES", 7)
    parts = list(tlog.read_parts(path))
    assert [len(part.frames) for part in parts] == [7, 7]
    assert all(part.frames["known"].all() for part in parts)


def test_only_the_requested_messages_are_returned(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", stamped([hil_sensor(0), text(1, b"x")]))
    assert list(tlog.read_columns(path, only={"STATUSTEXT"})) == ["STATUSTEXT"]


def test_a_missing_or_empty_log_is_a_user_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        tlog.read_columns(tmp_path / "none.tlog")
    with pytest.raises(ConfigError, match="empty"):
        tlog.read_columns(written(tmp_path / "a.tlog", b""))


def test_bytes_that_are_not_a_log_give_no_columns(tmp_path: Path) -> None:
    path = written(tmp_path / "a.tlog", random.Random(1).randbytes(20_000))
    log = tlog.read_log(path)
    assert sum(len(rows) for rows in log.columns.values()) <= 1
    assert log.junk_bytes > 19_000


def test_the_real_flight_has_75477_good_frames_and_pymavlinks_values(shared_data: Path) -> None:
    path = shared_data / "tlog" / "dronekit_flight_replay.tlog"
    columns = tlog.read_columns(path)
    assert sum(len(rows) for rows in columns.values()) == 75_477
    judge = mavutil.mavlink_connection(str(path))
    attitude = columns["ATTITUDE"]
    for row in attitude[:200]:
        message = judge.recv_match(type="ATTITUDE")
        assert message.time_boot_ms == row["time_boot_ms"]
        assert message.roll == row["roll"]
        assert message.get_seq() == row["seq"]
    judge.close()


def mutated(records: list[tuple[int, bytes]], seed: int, drop: bool) -> tuple[bytes, int]:
    """A log with one byte in a thousand changed or lost; how many frames are still intact."""
    rng = random.Random(seed)
    data = bytearray()
    intact = 0
    for t_us, raw in records:
        complete = bytearray(tlog.log_record(t_us, raw))
        hit = [i for i in range(len(complete)) if rng.random() < 0.001]
        intact += all(i < 8 for i in hit)
        for i in reversed(hit):
            if drop:
                del complete[i]
            else:
                complete[i] ^= rng.randrange(1, 256)
        data += complete
    return bytes(data), intact


@pytest.mark.parametrize("drop", [False, True])
def test_corruption_of_one_byte_in_a_thousand_loses_almost_no_intact_frame(
    tmp_path: Path, shared_data: Path, drop: bool
) -> None:
    source = shared_data / "px4_hil" / "hover_gps_jump_hil.tlog"
    records = [(t_us, frame.raw) for t_us, frame in tlog.read_frames(source)][:15_000]
    data, intact = mutated(records, 5, drop)
    path = written(tmp_path / "a.tlog", data)
    sent = {raw for _, raw in records}
    found = [frame.raw for _, frame in tlog.read_frames(path)]
    right = sum(raw in sent for raw in found)
    assert right >= 0.999 * intact
    judge = mavutil.mavlink_connection(str(path), notimestamps=False)
    recovered = 0
    while (message := judge.recv_match()) is not None:
        recovered += bytes(message.get_msgbuf()) in sent
    judge.close()
    assert right > recovered
