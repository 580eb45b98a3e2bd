"""Stamps that damaged bytes have made."""

import numpy as np

from analysis.recordings.misdated import misdated
from analysis.recordings.ulog import without_misdated


def test_single_stamps_far_from_those_around_them_are_wrong_and_pauses_are_not() -> None:
    times = np.arange(0, 10_000_000, 100_000)
    times[50:] += 3_600_000_000  # an hour's pause
    seldom = np.array([0, 31, 62, 69, 69, 92, 300]) * 1_000_000
    for sound in (times, seldom, np.append(times, times - times[0])):  # the last begins anew
        assert not misdated(sound).any()
    times[[20, 98]] += 1 << 38
    times[70] = 5
    assert np.flatnonzero(misdated(times)).tolist() == [20, 70, 98]


def test_of_a_damaged_ulog_only_what_lies_far_behind_its_densest_topic_is_left_out() -> None:
    dense = np.arange(90_000_000, 150_000_000, 10_000)
    seldom = np.array([2_000_000, 1 << 40, 149_000_000])  # the first from before the log
    topics = {
        ("imu", 0): {"timestamp": dense.astype(np.uint64), "x": dense},
        ("mode", 0): {"timestamp": seldom.astype(np.uint64), "mode": np.array([1, 2, 3])},
        ("text", 0): {"timestamp": np.array([1 << 50], np.uint64)},
    }
    assert without_misdated(topics)
    assert topics["mode", 0]["mode"].tolist() == [1, 3]
    assert len(topics["imu", 0]["x"]) == len(dense)
    assert ("text", 0) not in topics
    assert not without_misdated(topics)
