"""The time of the rows of a log whose stamps are wrong, moved or missing."""

import numpy as np
import pytest

from analysis.recordings.flight_logs.log_time import RowStamps, RowTimes, place_rows

DENSE_US = np.arange(90_000_000, 150_000_000, 10_000)
AT = np.arange(len(DENSE_US)) * 60
HOUR_US, DAY_US = 3_600_000_000, 86_400_000_000


def placed(stamps: np.ndarray, begin_us: int | None = None, **more: RowStamps) -> RowTimes:
    return place_rows({"imu": RowStamps(AT, stamps), **more}, begin_us=begin_us)


def test_only_rows_with_wrong_stamps_are_removed() -> None:
    stamps = DENSE_US.copy()
    stamps[70] += 1 << 40
    found = placed(stamps)
    assert found.misdated
    assert np.flatnonzero(~found.keep["imu"]).tolist() == [70]


def test_samples_from_before_a_log_count_as_of_its_beginning() -> None:
    mode = RowStamps(AT[[1, 5000]] + 7, np.array([2_000_000, 149_000_000]))
    mission = RowStamps(AT[[2]] + 9, np.array([89_999_000]))
    found = placed(DENSE_US, 90_000_000, mode=mode, mission=mission)
    assert found.times["mode"].tolist() == [90_000_000, 149_000_000]
    assert found.times["mission"].tolist() == [89_999_000]
    assert (found.stale, found.begin_us) == (1, 90_000_000)


@pytest.mark.parametrize("header_us", [0, 90_000_000 - HOUR_US, 90_000_000 + 10 * DAY_US])
def test_a_wrong_time_in_the_header_of_a_log_moves_nothing(header_us: int) -> None:
    assert placed(DENSE_US, header_us).begin_us == 90_000_000


@pytest.mark.parametrize("by_us", [-HOUR_US, -40_000_000, 10 * DAY_US])
@pytest.mark.parametrize("begin_us", [None, 90_000_000])
def test_a_clock_that_is_set_moves_no_row(by_us: int, begin_us: int | None) -> None:
    stamps = DENSE_US + np.where(DENSE_US > 120_000_000, by_us, 0)
    found = placed(stamps.astype(np.uint64), begin_us)
    assert np.abs(found.times["imu"] - DENSE_US).max() < 20_000
    assert (len(found.clock.edges), found.clock.restarts) == (1, 0)


def test_stamps_at_the_ends_of_their_range_overflow_nothing() -> None:
    rng = np.random.default_rng(1)
    stamps = DENSE_US[:2000] + np.where(np.arange(2000) < 1000, -46_000_000, 0)
    stamps[:1000][rng.random(1000) < 0.35] = (1 << 63) - 1
    stamps[:1000][rng.random(1000) < 0.2] = -(1 << 63)
    found = place_rows({"parameters": RowStamps(AT[:2000], stamps)})
    assert np.isin(DENSE_US[1000:2000] - DENSE_US[1000], found.times["parameters"] - found.times[
        "parameters"][1000]).all()  # fmt: skip


def test_rows_without_stamps_lie_between_those_that_have_one() -> None:
    some = RowStamps(AT[::100] + 30, None)
    for stamps in (np.where(DENSE_US < 120_000_000, DENSE_US, 0), DENSE_US):
        found = placed(stamps, texts=some)
        assert np.abs(found.times["imu"] - DENSE_US).max() < 20_000
        assert np.abs(found.times["texts"] - DENSE_US[::100]).max() < 30_000
    assert not found.unstamped


def test_the_receivers_time_counts_where_a_log_has_no_stamps() -> None:
    fixes = RowStamps(AT[::20] + 30, np.zeros(300, np.int64), 5_000_000_000 + DENSE_US[::20])
    found = placed(np.zeros(len(AT), np.int64), gps=fixes)
    assert found.unstamped
    assert np.abs(found.times["imu"] - (DENSE_US - DENSE_US[0])).max() < 20_000
