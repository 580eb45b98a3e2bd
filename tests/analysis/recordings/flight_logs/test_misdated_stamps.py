"""Wrong timestamps, caused by corrupted bytes."""

import numpy as np

from analysis.recordings.flight_logs.misdated_stamps import find_misdated


def test_single_timestamps_far_from_their_neighbours_are_wrong_and_gaps_are_not() -> None:
    times = np.arange(0, 10_000_000, 100_000)
    times[50:] += 3_600_000_000  # an hour's pause
    sparse = np.array([0, 31, 62, 69, 69, 92, 300]) * 1_000_000
    for sound in (times, sparse, np.append(times, times - times[0])):  # the last one restarts
        assert not find_misdated(sound).any()
    times[[20, 98]] += 1 << 38
    times[70] = 5
    assert np.flatnonzero(find_misdated(times)).tolist() == [20, 70, 98]
