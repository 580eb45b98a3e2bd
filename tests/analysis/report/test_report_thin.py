"""A report on a log too large for memory keeps its peaks and says that rows were omitted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.recordings import thinning as thin
from analysis.report.recordings.flight_sources import read_flight
from analysis.report.recordings.link_quality import sum_stretches
from mavproxy_fault.wire import tlog

Flight = Callable[..., Path]


@pytest.fixture
def small_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs count as large beyond 4 kB and are read 3,000 frames at a time."""
    monkeypatch.setattr(thin, "WHOLE_BYTES", 4_000)
    monkeypatch.setattr(thin, "ROWS", 100)
    monkeypatch.setattr(tlog, "BLOCK_FRAMES", 3_000)


def outcome(path: Path) -> FlightAssessment:
    return assess_flight(read_flight([path], ()), Thresholds())


@pytest.mark.usefixtures("small_memory")
def test_a_large_log_is_thinned_and_says_so(flight: Flight) -> None:
    path = flight(seconds=200)
    shares: list[float] = []
    found = thin.read_contents(path, shares.append)
    assert found.thinned
    # A bar shows it.
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(found.columns["ATTITUDE"]) < 0.8 * len(tlog.read_columns(path)["ATTITUDE"])
    assert any("is large" in note for note in outcome(path).summary["notes"])


@pytest.mark.usefixtures("small_memory")
def test_rare_messages_are_kept_where_they_change(flight: Flight) -> None:
    found = outcome(flight(seconds=200, texts=((150, 2, b"Radio failsafe"),))).flight.recording
    assert "Radio failsafe" in [event.text for event in found.events]
    assert [span.text for span in found.spans if span.lane == "mode"] == ["LOITER", "AUTO"]
    assert [value for _, value in found.parameters["WPNAV_SPEED"]] == [500.0, 300.0]


def test_a_single_peak_survives_thinning(flight: Flight) -> None:
    rows = tlog.read_columns(flight(seconds=200))["VIBRATION"].copy()
    rows["vibration_y"][777] = 99.0
    rows["vibration_x"][5] = -1.0
    kept = thin.thin_rows(rows, 100)
    assert len(kept) < 200
    assert (kept["vibration_y"].max(), kept["vibration_x"].min()) == (99.0, -1.0)
    assert np.all(np.diff(kept["t_us"]) >= 0)


def test_losses_counted_block_by_block_equal_those_of_the_entire_log(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = flight(seconds=60, lost=3)
    whole = sum_stretches(tlog.read_log(path).frames, {})
    monkeypatch.setattr(tlog, "BLOCK_FRAMES", 100)
    last: dict[int, thin.LastFrame] = {}
    parts = np.concatenate([sum_stretches(part.frames, last) for part in tlog.read_parts(path)])
    for column in ("frames", "lost"):
        assert parts[column].sum() == whole[column].sum() > 0
    assert parts["gap_us"].max() == whole["gap_us"].max()
