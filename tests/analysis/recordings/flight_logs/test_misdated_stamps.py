"""Wrong timestamps, caused by corrupted bytes."""

import numpy as np

from analysis.recordings.flight_logs.misdated_stamps import find_misdated
from analysis.recordings.flight_logs.ulog import remove_misdated


def test_single_timestamps_far_from_their_neighbours_are_wrong_and_gaps_are_not() -> None:
    times = np.arange(0, 10_000_000, 100_000)
    times[50:] += 3_600_000_000  # an hour's pause
    sparse = np.array([0, 31, 62, 69, 69, 92, 300]) * 1_000_000
    for sound in (times, sparse, np.append(times, times - times[0])):  # the last one restarts
        assert not find_misdated(sound).any()
    times[[20, 98]] += 1 << 38
    times[70] = 5
    assert np.flatnonzero(find_misdated(times)).tolist() == [20, 70, 98]


def test_of_a_corrupted_ulog_only_rows_with_wrong_timestamps_are_removed() -> None:
    dense = np.arange(90_000_000, 150_000_000, 10_000)
    dense[70] += 1 << 40
    topics = {
        ("imu", 0): {"timestamp": dense.astype(np.uint64), "x": np.arange(len(dense))},
        # A topic published before the log began, and a single row long after it.
        ("mode", 0): {"timestamp": np.array([2_000_000, 149_000_000], np.uint64)},
        ("mission", 0): {"timestamp": np.array([1_194_000_000], np.uint64)},
        ("unstamped", 0): {"timestamp": np.zeros(9000, np.uint64)},
    }
    assert remove_misdated(topics)
    assert len(topics["imu", 0]["x"]) == len(dense) - 1
    assert 70 not in topics["imu", 0]["x"]
    assert [len(topics[name, 0]["timestamp"]) for name in ("mode", "mission", "unstamped")] == [
        2, 1, 9000,
    ]  # fmt: skip
    assert not remove_misdated(topics)
