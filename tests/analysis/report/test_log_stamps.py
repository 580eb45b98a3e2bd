"""The vehicle's clock places messages; the log's timestamps only place boots one after another."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.recordings.flight_sources import read_flight
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

SECONDS, NOON_US = 60, 1_700_000_000_000_000
HOUR_US, DAY_US = 3_600_000_000, 86_400_000_000

Records = list[tuple[int, bytes]]


def records(*, boot_ms: int = 100_000, start_s: float = 0.0, companion: bool = False) -> Records:
    """Ten frames a second of a copter in the air from 10 to 50 s, which vibrates from 35 to 45."""
    found: Records = []
    seq = {1: 0, 191: 0}

    def send(t_s: float, name: str, component: int = 1, **values: object) -> None:
        raw = build_frame(
            message_layout(name), values, seq=seq[component] % 256, system=1, component=component
        )
        seq[component] += 1
        found.append((NOON_US + round((start_s + t_s) * 1e6), raw))

    for tick in range(SECONDS * 10):
        t_s, ms = tick / 10, boot_ms + tick * 100
        if tick % 10 == 0:
            armed = 0x80 if 10 <= t_s < 50 else 0
            send(t_s, "HEARTBEAT", type=2, autopilot=3, base_mode=armed, custom_mode=5)
            shaken = 90.0 if 35 <= t_s < 45 else 5.0
            send(t_s, "VIBRATION", time_usec=ms * 1000, vibration_x=shaken)
        place = {"lat": 470_000_000, "lon": 80_000_000, "alt": 500_000}
        send(t_s, "ATTITUDE", time_boot_ms=ms, roll=0.01)
        send(t_s, "GLOBAL_POSITION_INT", time_boot_ms=ms, relative_alt=0, **place)
        if companion and tick % 2 == 0:
            send(t_s, "SET_POSITION_TARGET_LOCAL_NED", 191, time_boot_ms=5_000_000 + ms)
    return found


def judged(path: Path, found: Records, stamped: bool = True) -> FlightAssessment:
    path.write_bytes(
        b"".join((struct.pack(">Q", t_us) if stamped else b"") + raw for t_us, raw in found)
    )
    return assess_flight(read_flight([path], ()), Thresholds())


def checks(found: FlightAssessment) -> dict[str, tuple[str, list[tuple[float, float]]]]:
    return {
        check.name: (check.verdict, [(round(a, 1), round(b, 1)) for a, b in check.windows])
        for check in found.checks
    }


HALF = SECONDS * 11
STAMPS: dict[str, Callable[[int, int], int]] = {
    "an hour back": lambda t_us, i: t_us - HOUR_US * (i > HALF),
    "40 s back": lambda t_us, i: t_us - 40_000_000 * (i > HALF),
    "10 days on": lambda t_us, i: t_us + 10 * DAY_US * (i > HALF),
    "for a while": lambda t_us, i: t_us + HOUR_US * (HALF // 2 < i < HALF),
    "1970 first": lambda t_us, i: t_us - NOON_US * (i < HALF),
    "1970": lambda t_us, i: t_us - NOON_US,
    "zero": lambda t_us, i: 0,
    "zero later": lambda t_us, i: t_us * (i < HALF),
    "the same": lambda t_us, i: NOON_US,
}


@pytest.mark.parametrize("name", STAMPS)
def test_a_log_is_judged_alike_whatever_its_timestamps(tmp_path: Path, name: str) -> None:
    usual = records()
    right = judged(tmp_path / "a.tlog", usual)
    moved = [(STAMPS[name](t_us, i), raw) for i, (t_us, raw) in enumerate(usual)]
    found = judged(tmp_path / "b.tlog", moved)
    assert right.verdict == "FAIL"
    assert checks(found) == checks(right)
    assert found.flight.recording.duration_s == pytest.approx(
        right.flight.recording.duration_s, abs=0.1
    )
    said = " ".join(found.flight.recording.notes)
    assert ("clock of the computer" in said or "no timestamps" in said) != (name == "1970")


def test_a_log_of_frames_without_timestamps_is_judged_alike(tmp_path: Path) -> None:
    right = judged(tmp_path / "a.tlog", records())
    found = judged(tmp_path / "b.tlog", records(), stamped=False)
    assert checks(found) == checks(right)
    assert any("no timestamps" in note for note in found.flight.recording.notes)


def test_a_restart_between_two_flights_is_no_silence_and_no_loss(tmp_path: Path) -> None:
    both = records() + records(start_s=300.0)
    found = judged(tmp_path / "two.tlog", both)
    link = found.flight.recording.links[0]
    assert (link.lost, round(link.longest_gap_s, 1)) == (0, 0.1)
    assert checks(found)["vibration"] == ("FAIL", [(35.0, 45.0), (335.0, 345.0)])


def test_a_companions_clock_is_not_the_vehicles(tmp_path: Path) -> None:
    found = judged(tmp_path / "a.tlog", records(companion=True))
    assert checks(found)["vibration"] == ("FAIL", [(35.0, 45.0)])
    assert found.flight.recording.notes == []


def test_a_stalled_link_is_a_silence_and_no_clock_that_was_set(tmp_path: Path) -> None:
    usual = records()
    # Frames of 30 to 38 s arrive together at 38 s.
    late = [
        (max(t_us, NOON_US + 38_000_000) if t_us >= NOON_US + 30_000_000 else t_us, raw)
        for t_us, raw in usual
    ]
    found = judged(tmp_path / "a.tlog", late)
    assert found.flight.recording.links[0].longest_gap_s == pytest.approx(8.1, abs=0.1)
    assert not any("clock of the computer" in note for note in found.flight.recording.notes)
    assert checks(found)["link from 1/1"][0] == "WARN"


def test_frames_of_an_unknown_dialect_are_whole(tmp_path: Path) -> None:
    usual = records()
    mixed: Records = []
    for i, (t_us, raw) in enumerate(usual):
        mixed.append((t_us, raw))
        # MAVLink 2 with the id of a known message that no other frame has: its checksum is wrong.
        head = struct.pack("<BBBBBBB", 0xFD, 28, 0, 0, i % 256, 1, 1)
        number = message_layout("ODOMETRY").id.to_bytes(3, "little")
        mixed.append((t_us, head + number + bytes(28) + b"\x12\x34"))
    found = judged(tmp_path / "a.tlog", mixed)
    assert found.flight.recording.junk_bytes == 0
    assert checks(found)["log is complete"][0] == "PASS"
    assert any("331" in note for note in found.flight.recording.notes)


def test_estimates_that_are_no_numbers_fail(tmp_path: Path) -> None:
    def blind(raw: bytes, t_us: int) -> bytes:
        if 20 <= (t_us - NOON_US) * 1e-6 < 40 and raw[7:10] == b"\x1e\0\0":
            ms = struct.unpack("<I", raw[10:14])[0]
            values = {name: np.nan for name in ("roll", "pitch", "yaw")}
            return build_frame(
                message_layout("ATTITUDE"), {"time_boot_ms": ms, **values}, seq=raw[4], system=1
            )
        return raw

    usual = [(t_us, blind(raw, t_us)) for t_us, raw in records()]
    found = checks(judged(tmp_path / "a.tlog", usual))
    assert found["estimates are numbers"] == ("FAIL", [(20.0, 40.0)])


def test_samples_without_a_time_and_old_ones_do_not_stretch_the_axis(tmp_path: Path) -> None:
    usual = records(boot_ms=400_000)
    for at, old_us in ((3, 0), (5, 20_000_000)):
        fix = build_frame(message_layout("GPS_RAW_INT"), {"time_usec": old_us, "fix_type": 3})
        usual.insert(at, (usual[at][0], fix))
    for i in range(100, len(usual), 100):
        ms = 400_000 + round((usual[i][0] - NOON_US) * 1e-3)
        fix = build_frame(message_layout("GPS_RAW_INT"), {"time_usec": ms * 1000, "fix_type": 3})
        usual[i] = (usual[i][0], fix)
    found = judged(tmp_path / "a.tlog", usual).flight.recording
    assert found.duration_s == pytest.approx(SECONDS, abs=0.2)
