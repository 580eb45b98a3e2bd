"""Texts and events of a ULog in one list, and what the system printed."""

from pathlib import Path
from typing import Any

import pytest

from analysis.recordings.flight_logs.ulog import read_ulog
from analysis.recordings.flight_logs.ulog_texts import (
    MAX_CHARACTERS,
    LoggedTexts,
    logged_texts,
    printed_texts,
)


def texts(
    said: list[tuple[int, int, str]], events: list[tuple[int, str, str]], monkeypatch: Any
) -> LoggedTexts:
    """The texts of a log whose events pyulog reads as given."""
    from pyulog.px4_events import PX4Events

    monkeypatch.setattr(PX4Events, "get_logged_events", lambda self, log: events)
    return logged_texts(said, {}, {}, {})


def test_a_message_logged_as_text_and_event_is_kept_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found = texts(
        [(5_000_000, 4, "[commander] Takeoff detected"), (9_000_000, 4, "[x] bye")],
        [
            (5_400_000, "INFO", "Takeoff detected"),
            (7_000_000, "EMERGENCY", "Accelerometer sensor #0 failure: Timeout"),
            (7_100_000, "WARNING", "Failsafe warning:\t"),
            (8_000_000, "INFO", "Takeoff detected"),
            (8_100_000, "INFO", "[Unknown event with ID 7]"),
            (8_200_000, "UNKNOWN", "?"),
        ],
        monkeypatch,
    )
    assert found == [
        (5_000_000, 4, "[commander] Takeoff detected"),
        (7_000_000, 0, "Accelerometer sensor #0 failure: Timeout"),
        (7_100_000, 4, "Failsafe warning"),
        (8_000_000, 6, "Takeoff detected"),
        (9_000_000, 4, "[x] bye"),
    ]


def test_a_corrupted_log_keeps_its_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    from pyulog.px4_events import PX4Events

    def broken(self: PX4Events, log: Any) -> None:
        raise TypeError("damaged")

    monkeypatch.setattr(PX4Events, "get_logged_events", broken)
    assert logged_texts([(1, 4, "[x] a")], {}, {}, {}) == [(1, 4, "[x] a")]


def test_printed_texts_are_cut_and_joined() -> None:
    parts = {"boot_console_output": [["HW ar", "ch: X\n"]], "perf_top_preflight": [["a", "b"]],
             "perf_top_postflight": [[" "]], "hardfault_plain": [["x" * 10**6]],
             "metadata_events": [[b"\xfd"]]}  # fmt: skip
    found = printed_texts(parts)
    assert found["Console"] == "HW arch: X\n"
    assert found["Processes before the flight"] == "a\nb"
    assert len(found["Hard fault"]) == MAX_CHARACTERS
    assert len(found) == 3


def test_a_real_log_has_the_texts_that_flight_review_shows(shared_data: Path) -> None:
    found = read_ulog(shared_data / "ulog" / "gps_interference.ulg")
    said = [text for _, _, text in found.messages]
    # Five of its events are texts too, partly in other words.
    assert sum("Takeoff detected" in text for text in said) == 1
    assert "HW arch: CUAV_7_NANO" in found.printed["Console"]
    assert "wq:rate_ctrl" in found.printed["Processes after the flight"]
    assert "ekf2: IMU message missed: 0 events" in found.printed[
        "Performance counters after the flight"
    ]  # fmt: skip


def test_a_preallocated_log_is_read_as_far_as_it_was_written(
    shared_data: Path, tmp_path: Path
) -> None:
    data = (shared_data / "ulog" / "gps_interference.ulg").read_bytes()
    with (tmp_path / "a.ulg").open("wb") as file:
        file.write(data)
        file.truncate(1 << 33)
    shares: list[float] = []
    found = read_ulog(tmp_path / "a.ulg", shares.append)
    assert len(found.topics) == len(read_ulog(shared_data / "ulog" / "gps_interference.ulg").topics)
    assert 0.7 < shares[-1] <= 1.0
