"""ULog and dataflash logs as samples for the monitor."""

import struct
from pathlib import Path

import numpy as np
import pytest

from analysis.recordings.flight_logs import autopilot_logs, dataflash_blocks, ulog_messages
from analysis.recordings.flight_logs.dataflash import read_dataflash
from analysis.recordings.flight_logs.log_condition import LogCondition
from analysis.recordings.read_recordings import read_log
from analysis.samples.block import ATTITUDE, BARO, COMMAND, FIX, IMU, MAG, SPARE
from analysis.samples.sample import CommandSample, GpsFix, ImuSample, MagSample
from mavproxy_fault.documents.errors import ConfigError

HEAD = b"\xa3\x95"
FORMATS = {  # name: (type, struct code, dataflash code, columns)
    "FMT": (128, "BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
    "IMU": (10, "Qffffff", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "IMU2": (16, "Qffffff", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "MAG": (11, "Qhhh", "Qhhh", "TimeUS,MagX,MagY,MagZ"),
    "BARO": (12, "Qff", "Qff", "TimeUS,Alt,Press"),
    "GPS": (13, "QBBfiiffff", "QBBfLLffff", "TimeUS,Status,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"),
    "GPA": (18, "QHHH", "QCCC", "TimeUS,HAcc,VAcc,SAcc"),
    "ATT": (14, "Qfff", "Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "RATE": (17, "Qff", "Qff", "TimeUS,RDes,R"),
    "MAG3": (20, "QhhhB", "QhhhB", "TimeUS,MagX,MagY,MagZ,Health"),
    "DSF": (19, "QI", "QI", "TimeUS,Dp"),
    "RCOU": (15, "QHHHH", "QHHHH", "TimeUS,C1,C2,C3,C4"),
}


def row(name: str, *values: object) -> bytes:
    number, code, _, _ = FORMATS[name]
    return HEAD + bytes((number,)) + struct.pack("<" + code, *values)


def dataflash(path: Path, *names: str, rate: float = 6.0) -> Path:
    """A second of a flight to the east, with messages of some names."""
    data = b"".join(
        row("FMT", n, 3 + struct.calcsize("<" + code), name.encode(), form.encode(), cols.encode())
        for name, (n, code, form, cols) in FORMATS.items()
    )
    for tick in range(10):
        t_us = 1_000_000 + tick * 100_000
        rows = {
            "GPS": (t_us + 3, 3, 12, 0.8, 470_000_000, 80_000_000 + tick, 500.0, 5.0, 90.0, -1.0),
            "GPA": (t_us + 3, 80, 120, 25),
            "IMU": (t_us, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8),
            "IMU2": (t_us, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8),
            "MAG": (t_us + 1, 200, 0, 400),
            "BARO": (t_us + 2, 0.0, 95_000.0),
            "ATT": (t_us + 4, 0.0, 0.0, 90.0),
            "RATE": (t_us + 6, rate, rate),
            "RCOU": (t_us + 5, 1500, 1510, 1520, 1000),
        }
        data += b"".join(row(name, *rows[name]) for name in names)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("rate", [5.0, 500.0])
def test_rates_are_in_degrees_even_if_the_log_has_hundredths(tmp_path: Path, rate: float) -> None:
    topics = read_dataflash(dataflash(tmp_path / "a.bin", "IMU", "RATE", rate=rate)).topics
    assert topics["RATE", 0]["R"] == pytest.approx([5.0] * 10)
    assert topics["RATE", 0]["RDes"] == pytest.approx([5.0] * 10)


def test_a_dataflash_log_holds_what_the_monitor_needs(tmp_path: Path) -> None:
    (block,) = read_log(dataflash(tmp_path / "a.bin", "GPS", "IMU", "MAG", "BARO", "ATT"))
    assert np.all(np.diff(block.t_us) > 0)
    assert block.kind[:5].tolist() == [IMU, MAG, BARO, FIX, ATTITUDE]
    imu, mag, fix = (block.sample(at) for at in (0, 1, 3))
    assert isinstance(imu, ImuSample)
    assert imu.gyro_b_rps == pytest.approx([0.1, 0.2, 0.3])
    assert isinstance(mag, MagSample)
    assert mag.field_b_gauss == pytest.approx([0.2, 0.0, 0.4])
    assert isinstance(fix, GpsFix)
    assert (fix.lat_deg, fix.fix_type, fix.satellites) == (pytest.approx(47.0), 3, 12)
    assert fix.v_ned_mps == pytest.approx([0.0, 5.0, -1.0], abs=1e-6)
    assert block.sample(4).q_nb == pytest.approx([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_the_accuracy_of_a_receiver_is_read_from_gpa(
    tmp_path: Path,
) -> None:
    for names, said in ((("GPS", "GPA", "IMU"), (0.8, 1.2)), (("GPS", "IMU"), (np.nan, np.nan))):
        (block,) = read_log(dataflash(tmp_path / "a.bin", *names))
        fixes = [block.sample(row) for row in block.rows(FIX).tolist()]
        assert len(fixes) == 10
        for fix in fixes:
            assert isinstance(fix, GpsFix)
            assert (fix.eph_m, fix.epv_m) == pytest.approx(said, nan_ok=True)


def test_a_message_with_an_impossible_time_is_corruption(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "a.bin", "GPS", "IMU")
    data = bytearray(path.read_bytes())
    data[data.index(row("IMU", 1_500_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)) + 3 + 4] ^= 0x40
    path.write_bytes(data)
    found = read_dataflash(path)
    assert found.corrupted
    assert (found.start_us, found.end_us) == (1_000_000, 1_900_003)
    assert len(found.topics["IMU", 0]["TimeUS"]) == 9
    assert len(found.topics["GPS", 0]["TimeUS"]) == 10


@pytest.mark.parametrize("content", [b"\x00" * 5000, b"no log at all, but some words\n" * 40])
def test_a_file_without_any_message_of_a_sensor_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="holds no sensor message; give a log"):
        list(read_log(path))


def test_all_imus_of_a_dataflash_log_are_read(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "a.bin", "GPS", "IMU", "IMU2")
    (block,) = read_log(path)
    assert block.values[block.rows(IMU), 6].tolist() == 10 * [0.0, 1.0]


def test_the_outputs_of_a_dataflash_log_are_read(tmp_path: Path) -> None:
    (block,) = read_log(dataflash(tmp_path / "a.bin", "GPS", "IMU", "RCOU"))
    sample = block.sample(int(block.rows(COMMAND)[0]))
    assert isinstance(sample, CommandSample)
    assert sample.outputs.tolist() == pytest.approx([1.5, 1.51, 1.52, 1.0] + 8 * [0.0])
    assert sample.source == "OUTPUTS"


@pytest.mark.parametrize(("names", "missing"), [(("IMU", "MAG"), "GPS"), (("GPS",), "IMU")])
def test_a_log_without_imu_or_gps_is_refused(
    tmp_path: Path, names: tuple[str, ...], missing: str
) -> None:
    with pytest.raises(ConfigError, match=f"no samples of {missing}; the monitor needs"):
        list(read_log(dataflash(tmp_path / "a.bin", *names)))


def test_a_real_ulog_is_read_with_all_its_sensors(shared_data: Path) -> None:
    (block,) = read_log(shared_data / "ulog" / "gps_interference.ulg")
    assert {IMU, MAG, BARO, FIX, ATTITUDE, COMMAND} <= set(block.kind.tolist())
    outputs = block.values[block.rows(COMMAND), :12]
    assert outputs.max(axis=0) == pytest.approx([0.65, 0.762, 0.759, 0.826] + 8 * [0.0])
    force = np.median(block.values[block.rows(IMU), 5])
    assert force == pytest.approx(-9.8, abs=0.5)
    strength = np.linalg.norm(block.values[block.rows(MAG), :3], axis=1)
    assert 0.2 < np.median(strength) < 0.7


def test_without_outputs_the_commands_to_the_motors_are_read(
    shared_data: Path, tmp_path: Path
) -> None:
    whole = shared_data / "ulog" / "gps_interference.ulg"
    # By another name the topic is unknown; both are logged in this flight.
    without = tmp_path / "motors.ulg"
    without.write_bytes(whole.read_bytes().replace(b"actuator_outputs", b"actuator_unknown"))
    blocks = (next(iter(read_log(path))) for path in (whole, without))
    by_outputs, by_motors = (block.values[block.rows(COMMAND), :4] for block in blocks)
    assert len(by_motors) == len(by_outputs) == 624
    assert by_motors.min() >= 0.0
    assert by_motors.max() == pytest.approx(0.30857205)
    # The same commands in other units: the one is a straight line of the other.
    for output, motor in zip(by_outputs.T, by_motors.T, strict=True):
        assert np.corrcoef(output, motor)[0, 1] > 0.99


def test_lost_parts_of_a_log_are_reported(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "a.bin", "GPS", "IMU")
    whole = LogCondition()
    list(read_log(path, whole))
    assert (whole.damage, whole.lost_us) == ([], [])
    counts = [(1_000_000, 5), (2_000_000, 5), (3_000_000, 40), (4_000_000, 41), (5_000_000, 41)]
    path.write_bytes(path.read_bytes() + b"".join(row("DSF", *count) for count in counts))
    lossy = LogCondition()
    list(read_log(path, lossy))
    assert lossy.lost_us == [(2_000_000, 3_000_000), (3_000_000, 4_000_000)]
    data = bytearray(path.read_bytes())
    data[data.index(row("IMU", 1_500_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)) + 3 + 4] ^= 0x40
    path.write_bytes(data)
    broken = LogCondition()
    list(read_log(path, broken))
    assert broken.damage == ["parts of the file are corrupted and were skipped"]


def test_a_tlog_with_foreign_bytes_is_corrupted() -> None:
    condition = LogCondition()
    condition.note_junk(20, 100_000)
    assert condition.damage == []
    condition.note_junk(2_000, 100_000)
    assert condition.damage == ["2000 of 100000 bytes (2 %) are not frames"]


def test_unhealthy_measurements_are_ignored(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "a.bin", "GPS", "IMU")
    rows = [row("MAG3", 1_000_000 + 100_000 * k, 200, 0, 400, int(k < 4)) for k in range(10)]
    path.write_bytes(path.read_bytes() + b"".join(rows))
    topics = read_dataflash(path).topics
    assert len(topics["MAG", 2]["TimeUS"]) == 10
    (block,) = read_log(path)
    assert len(block.rows(SPARE)) == 4


def in_blocks(
    path: Path, size: int, monkeypatch: pytest.MonkeyPatch
) -> tuple[int, list[np.ndarray], LogCondition]:
    """How many blocks a log is read in, kinds, times and values, and what was noted."""
    for module in (autopilot_logs, dataflash_blocks, ulog_messages):
        monkeypatch.setattr(module, "BLOCK_BYTES", size)
    condition = LogCondition()
    blocks = list(read_log(path, condition))
    columns = [np.concatenate([np.asarray(block[i]) for block in blocks]) for i in range(3)]
    return len(blocks), columns, condition


@pytest.mark.parametrize("damage", ["none", "restart", "wrong stamp", "dropped"])
def test_a_dataflash_log_in_blocks_gives_the_same_samples(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, begin = dataflash(tmp_path / "a.bin", "IMU").read_bytes(), 15_000_000
    data = data[: len(FORMATS) * 89]
    head = data
    for tick in range(6000):
        t_us = begin + tick * 10_000
        if damage == "restart" and tick >= 3000:
            data += head if tick == 3000 else b""
            t_us -= 40_000_000
        wrong = 1 << 40 if damage == "wrong stamp" and tick in (2001, 4400) else 0
        data += row("IMU", t_us + wrong, tick, 0.2, 0.3, 0.0, 0.0, -9.8)
        if tick % 20 == 0:
            # Logged after the next samples, as by a driver that is late.
            data += row("GPS", t_us - 30_000, 3, 12, 0.8, 470_000_000, tick, 500.0, 5.0, 90.0, -1)
            data += row("GPA", t_us - 30_000, 80, tick % 90, 25)
            data += row("DSF", t_us, 1000 * (damage == "dropped") * (tick > 900))
    path = tmp_path / "log.bin"
    path.write_bytes(data)
    _, whole, noted = in_blocks(path, 1 << 25, monkeypatch)
    for size in (20_000, 33_333):
        count, found, condition = in_blocks(path, size, monkeypatch)
        assert count > 5
        assert condition == noted
        # How long a restart took is not logged: a second after the last row that was kept.
        assert np.abs(found[1] - whole[1]).max() <= (20_000 if damage == "restart" else 0)
        for one, other in zip(found[::2], whole[::2], strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_ulog_in_blocks_gives_the_same_samples(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_data / "ulog" / "gps_interference.ulg"
    _, whole, _ = in_blocks(path, 1 << 25, monkeypatch)
    count, found, _ = in_blocks(path, 300_000, monkeypatch)
    assert count > 5
    for one, other in zip(found, whole, strict=True):
        np.testing.assert_array_equal(one, other)
