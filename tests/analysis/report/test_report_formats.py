"""ULog and dataflash logs give the same kinds of curves as tlogs do."""

import struct
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from analysis.recordings.flight_logs.dataflash import read_dataflash
from analysis.recordings.flight_logs.ulog import read_ulog
from analysis.report.curves.vehicle_phase import armed_windows
from analysis.report.export import read_tables
from analysis.report.flight_verdict import assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.recordings.flight_sources import RecordedFlight as Source
from analysis.report.recordings.flight_sources import read_flight
from analysis.report.recordings.from_autopilot_log import recording_of_log
from mavproxy_fault.documents.errors import ConfigError

HEAD = b"\xa3\x95"
FORMATS = {  # name: (type, struct code, dataflash code, columns)
    "FMT": (128, "BB4s16s64s", "BBnNZ", "Type,Length,Name,Format,Columns"),
    "ATT": (10, "Qfff", "Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "GPS": (11, "QBBfiiff", "QBBfLLff", "TimeUS,Status,NSats,HDop,Lat,Lng,Alt,Spd"),
    "MODE": (12, "QBBB", "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "EV": (13, "QB", "QB", "TimeUS,Id"),
    "MSG": (14, "Q64s", "QZ", "TimeUS,Message"),
    "PARM": (15, "Q16sf", "QNf", "TimeUS,Name,Value"),
    "RCOU": (18, "QHHHH", "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "VIBE": (16, "QfffI", "QfffI", "TimeUS,VibeX,VibeY,VibeZ,Clip"),
    "MAG": (17, "Qhhh", "Qhhh", "TimeUS,MagX,MagY,MagZ"),
}


def row(name: str, *values: object) -> bytes:
    number, code, _, _ = FORMATS[name]
    return HEAD + bytes((number,)) + struct.pack("<" + code, *values)


def dataflash(
    path: Path,
    events: Mapping[int, int] = MappingProxyType({2_000_000: 10}),
    turning_s: float | None = None,
) -> Path:
    """Ten seconds of a copter that vibrates, armed from 1 s; `events` by their time in us. Its
    motors turn from `turning_s` on, if they are logged."""
    data = bytearray()
    for name, (number, code, form, columns) in FORMATS.items():
        length = 3 + struct.calcsize("<" + code)
        data += row("FMT", number, length, name.encode(), form.encode(), columns.encode())
    data += row("MSG", 1_000_000, b"ArduCopter V4.5")
    data += row("PARM", 1_000_000, b"INS_GYRO_FILTER", 20.0)
    for i in range(1, 5):
        data += row("PARM", 1_000_000, f"SERVO{i}_FUNCTION".encode(), 32.0 + i)
    data += row("MODE", 1_100_000, 5, 5, 1)
    for t_us, number in events.items():
        data += row("EV", t_us, number)
    for tick in range(100):
        t_us = 1_000_000 + tick * 100_000
        data += row("ATT", t_us, 1.0, 2.0, 90.0)
        data += row("GPS", t_us, 3, 12, 0.8, 470_000_000 + tick, 80_000_000, 500.0, 0.1)
        data += row("VIBE", t_us, 5.0, 5.0, 70.0, 0)
        data += row("MAG", t_us, 300, 0, 400)
        if turning_s is not None:
            data += row("RCOU", t_us, *(4 * [1100 if tick >= 10 * turning_s else 1000]))
    path.write_bytes(bytes(data))
    return path


@pytest.mark.parametrize(("turning_s", "armed"), [(20.0, []), (4.0, [4.0])])
def test_without_events_a_copter_is_armed_while_its_motors_turn(
    tmp_path: Path, turning_s: float, armed: list[float]
) -> None:
    path = dataflash(tmp_path / "a.bin", {}, turning_s)
    found = armed_windows(read_flight([path], ()).recording)
    assert found is not None
    assert [round(start, 1) for start, _ in found] == armed


def old_dataflash(path: Path) -> Path:
    """Five seconds of a log of 2014: milliseconds, centivolts, events without a time, in flight."""
    forms = {
        "FMT": FORMATS["FMT"],
        "ATT": (10, "Ihh", "Icc", "TimeMS,Roll,Pitch"),
        "CURR": (11, "Ihh", "Ihh", "TimeMS,Volt,Curr"),
        "EV": (12, "B", "B", "Id"),
        "ERR": (13, "BB", "BB", "Subsys,ECode"),
    }

    def line(name: str, *values: object) -> bytes:
        return HEAD + bytes((forms[name][0],)) + struct.pack("<" + forms[name][1], *values)

    data = b"".join(
        line("FMT", n, 3 + struct.calcsize("<" + code), name.encode(), form.encode(), cols.encode())
        for name, (n, code, form, cols) in forms.items()
    )
    for tick in range(50):
        data += line("ATT", 1000 + tick * 100, 150, -250)
        if tick == 20:
            data += line("EV", 11) + line("ERR", 12, 1)
        data += line("CURR", 1000 + tick * 100, 1640, 300)
    path.write_bytes(data)
    return path


def test_a_dataflash_log_has_curves_modes_texts_and_parameters(tmp_path: Path) -> None:
    found = recording_of_log(read_dataflash(dataflash(tmp_path / "a.bin")), "a")
    assert found.of("yaw")[0].value[:2].tolist() == [90.0, 90.0]
    assert found.of("mag")[0].value[0] == pytest.approx(0.5)
    assert found.tracks[0].lat_deg[0] == pytest.approx(47.0)
    lanes = {(span.lane, span.text) for span in found.spans}
    assert lanes == {("mode", "LOITER"), ("armed", "disarmed"), ("armed", "armed")}
    assert found.parameters["INS_GYRO_FILTER"][0][1] == 20.0
    assert "ArduCopter V4.5" in [event.text for event in found.events]


def test_a_dataflash_log_is_judged_like_any_other(tmp_path: Path) -> None:
    flight = read_flight([dataflash(tmp_path / "a.bin")], ())
    checks = {check.name: check.verdict for check in assess_flight(flight, Thresholds()).checks}
    assert checks["vibration"] == "FAIL"
    assert checks["GPS satellites"] == "PASS"


@pytest.mark.parametrize(
    ("events", "since_s", "until_s"),
    [
        ({2_000_000: 10, 9_000_000: 11}, 1.0, 8.0),
        ({9_000_000: 11}, 0.0, 8.0),  # the log begins in flight
        ({4_000_000: 57, 5_000_000: 28, 9_000_000: 11}, 3.0, 8.0),  # the arming was not logged
        ({4_000_000: 57, 5_000_000: 28}, 3.0, 9.9),  # nor was the disarming
        ({4_000_000: 28, 5_000_000: 10, 9_000_000: 11}, 4.0, 8.0),
    ],
)
def test_arming_is_derived_from_the_events_in_the_log(
    tmp_path: Path, events: dict[int, int], since_s: float, until_s: float
) -> None:
    log = read_dataflash(dataflash(tmp_path / "log.bin", events))
    found = recording_of_log(log, "log")
    (armed,) = armed_windows(found) or ()
    assert armed == pytest.approx((since_s, until_s))


def test_an_old_dataflash_log_in_milliseconds_is_read(tmp_path: Path) -> None:
    path = old_dataflash(tmp_path / "old.bin")
    found = recording_of_log(read_dataflash(path), "old")
    assert found.duration_s == pytest.approx(4.9)
    assert found.of("battery-voltage")[0].value[0] == pytest.approx(16.4)
    assert [s.end_s for s in found.spans if s.text == "armed"] == [2.0]
    assert ("crash check: error 1", 3) in [(e.text, e.severity) for e in found.events]


def test_a_dataflash_log_is_exported(tmp_path: Path) -> None:
    tables = dict(read_tables(dataflash(tmp_path / "a.bin")))
    assert tables["ATT_0"]["Yaw"].tolist() == [90.0] * 100
    assert tables["GPS_0"]["Lat"][0] == pytest.approx(47.0)


def test_corrupted_bytes_in_a_dataflash_log_are_skipped(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "a.bin")
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2] = b"\x00\x01\x02\x03\x04"
    path.write_bytes(bytes(data[:-7]))
    found = read_dataflash(path)
    assert found.corrupted
    assert found.cut
    assert len(found.topics["ATT", 0]["Roll"]) >= 98


def test_a_dataflash_log_without_messages_is_a_config_error(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(HEAD + bytes(400))
    with pytest.raises(ConfigError, match=r"a\.bin"):
        read_flight([path], ())


def test_the_real_ulog_shows_its_interference(shared_data: Path) -> None:
    found = assess_flight(
        read_flight([shared_data / "ulog" / "gps_interference.ulg"], ()), Thresholds()
    )
    checks = {check.name: check.verdict for check in found.checks}
    assert checks["GPS jamming indicator"] == "WARN"
    assert checks["GPS fix"] == "WARN"
    recording = found.flight.recording
    assert recording.duration_s == pytest.approx(62, abs=1)
    assert len(recording.of("accel")[0].value) == 12_321
    assert "[commander] Takeoff detected" in [event.text for event in recording.events]


def test_a_truncated_ulog_gives_its_readable_part(tmp_path: Path, shared_data: Path) -> None:
    whole = (shared_data / "ulog" / "gps_interference.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(whole[: len(whole) // 2])
    assert read_ulog(path).cut
    assert 0 < len(read_ulog(path).topics["vehicle_attitude", 0]["timestamp"]) < 1247


def test_a_ulog_header_without_content_is_a_config_error(tmp_path: Path) -> None:
    path = tmp_path / "a.ulg"
    path.write_bytes(b"ULog\x01\x12\x35" + bytes(3))
    with pytest.raises(ConfigError, match=r"a\.ulg"):
        read_flight([path], ())


def test_a_wrong_byte_in_a_ulog_loses_at_most_two_messages(
    tmp_path: Path, shared_data: Path
) -> None:
    whole = bytearray((shared_data / "ulog" / "gps_interference.ulg").read_bytes()[:1_500_000])
    path, rng = tmp_path / "a.ulg", np.random.default_rng(1)

    def rows() -> int:
        path.write_bytes(whole)
        return sum(len(topic["timestamp"]) for topic in read_ulog(path).topics.values())

    # Behind the definitions.
    complete = rows()
    for at in rng.integers(150_000, len(whole), 25).tolist():
        whole[at] ^= 0x55
        assert complete - rows() <= 2, at
        whole[at] ^= 0x55


def test_a_gps_glitch_of_ardupilots_estimator_is_a_flag(tmp_path: Path) -> None:
    log = read_dataflash(dataflash(tmp_path / "a.bin"))
    t_us = np.arange(1_000_000, 11_000_000, 100_000)
    glitching = (t_us >= 4_000_000) & (t_us < 6_000_000)
    zeros = np.zeros(len(t_us), np.int64)
    log.topics[("XKF4", 0)] = {"TimeUS": t_us, "TS": zeros, "SS": 0x1F + (glitching << 14)}
    found = recording_of_log(log, "a")
    (span,) = [span for span in found.spans if span.kind == "flag"]
    assert (span.lane, span.start_s, span.end_s) == ("estimator: GPS glitch", 3.0, 5.0)
    assert [(e.t_s, e.text) for e in found.events if e.kind == "flag"] == [
        (3.0, "estimator: GPS glitch raised"),
        (5.0, "estimator: GPS glitch cleared"),
    ]


def test_an_estimator_that_uses_no_position_yet_has_not_lost_it(tmp_path: Path) -> None:
    """Its timeouts (TS, bits 0 and 1) are set while it holds a constant position (SS, bit 7)."""
    log = read_dataflash(dataflash(tmp_path / "a.bin"))
    t_us = np.arange(1_000_000, 11_000_000, 100_000)
    timeouts = np.where((t_us < 4_000_000) | (t_us >= 8_000_000), 0b11, 0)
    log.topics[("XKF4", 0)] = {"TimeUS": t_us, "TS": timeouts, "SS": 0x80 * (t_us < 4_000_000)}
    spans = [span for span in recording_of_log(log, "a").spans if span.kind == "flag"]
    assert {(span.lane, span.start_s) for span in spans} == {
        ("estimator: position timeout", 7.0), ("estimator: velocity timeout", 7.0),
    }  # fmt: skip


def test_a_measurement_that_ardupilot_rejects_for_a_second_is_a_flag(tmp_path: Path) -> None:
    log = read_dataflash(dataflash(tmp_path / "a.bin"))
    t_us = np.arange(1_000_000, 11_000_000, 100_000)
    ratio = np.where((t_us >= 4_000_000) & (t_us < 6_000_000), 1.1, 0.4)
    short = np.where((t_us >= 4_000_000) & (t_us < 4_500_000), 1.1, 0.4)
    zeros = np.zeros(len(t_us), np.int64)
    log.topics[("XKF4", 0)] = {"TimeUS": t_us, "TS": zeros, "SH": ratio, "SP": short}
    found = recording_of_log(log, "a")
    (span,) = [span for span in found.spans if span.kind == "flag"]
    assert (span.lane, span.start_s, span.end_s) == ("estimator: height rejected", 3.0, 5.0)


def test_solution_status_bits_of_px4s_estimator_are_flags(shared_data: Path) -> None:
    log = read_ulog(shared_data / "ulog" / "gps_interference.ulg")
    topic = log.topics[("estimator_status", 0)]
    assert not [s for s in recording_of_log(log, "a").spans if s.lane.startswith("estimator: ")]
    raised = np.arange(len(topic["timestamp"])) // 100 == 1
    solution = topic["solution_status_flags"] | raised << 11
    log.topics[("estimator_status", 0)] = {
        **topic,
        "solution_status_flags": solution,
        "gps_check_fail_flags": raised << 5,
        "innovation_check_flags": raised << 7,
    }
    spans = [s for s in recording_of_log(log, "a").spans if s.lane.startswith("estimator: ")]
    # A receiver that fails the estimator's quality checks is a warning, not a flag.
    assert {(span.text, span.kind) for span in spans} == {
        ("accelerometer error", "flag"),
        ("GPS speed accuracy rejected", "warn"),
        ("airspeed rejected", "flag"),
    }
    seconds = (topic["timestamp"][[100, 200]] - log.start_us) * 1e-6
    assert {(span.start_s, span.end_s) for span in spans} == {tuple(seconds.tolist())}


def test_a_measurement_that_px4_rejects_for_a_second_is_a_flag(shared_data: Path) -> None:
    log = read_ulog(shared_data / "ulog" / "gps_interference.ulg")
    name = ("estimator_aid_src_baro_hgt", 0)
    topic = log.topics[name]
    t_s = (topic["timestamp"] - log.start_us) * 1e-6
    begin_s = float(t_s[len(t_s) // 2])
    for for_s, texts in ((0.4, []), (3.0, ["baro height rejected"])):
        refused = (t_s >= begin_s) & (t_s < begin_s + for_s)
        log.topics[name] = {**topic, "innovation_rejected": refused.astype(np.uint8)}
        found = recording_of_log(log, "a")
        spans = [s for s in found.spans if s.lane.startswith("estimator: ")]
        assert [span.text for span in spans] == texts
        assert all(span.start_s == begin_s and span.kind == "flag" for span in spans)


def test_a_battery_that_is_not_connected_fails_no_log(shared_data: Path) -> None:
    log = read_ulog(shared_data / "ulog" / "gps_interference.ulg")
    battery = log.topics[("battery_status", 0)]
    rows = len(battery["timestamp"])
    empty = {**battery, "remaining": np.zeros(rows, np.float32)}
    found = {}
    for connected in (0, 1):
        log.topics[("battery_status", 0)] = {**empty, "connected": np.full(rows, connected)}
        flight = Source(recording_of_log(log, "a"), (Path("a.ulg"),), [])
        checks = assess_flight(flight, Thresholds()).checks
        found[connected] = {check.name: check.verdict for check in checks}["battery remaining"]
    assert found == {0: "not judged", 1: "FAIL"}
