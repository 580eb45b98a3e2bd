"""IMU samples on their way to the next epoch, in runs of any length."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from analysis.detection.filter import propagation as motion
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import NO_RUN, add_pending, imu_segment, split_pending
from analysis.samples.block import ImuRun

NOWHERE = MotionEstimate(0, np.empty(0), np.empty(0))


def run_at(stamps_us: list[int]) -> ImuRun:
    t_us = np.array(stamps_us, np.int64)
    return ImuRun(t_us, np.outer(t_us * 1e-6, np.arange(1.0, 7.0)))


def kept(stamps_us: list[int], cuts: list[int]) -> ImuRun:
    pending = NO_RUN
    for begin, end in pairwise([0, *cuts, len(stamps_us)]):
        pending = add_pending(run_at(stamps_us[begin:end]), pending)
    return pending


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=60), st.data())
def test_runs_cut_anywhere_make_the_same_segment(stamps, data):
    cuts = sorted(data.draw(st.sets(st.integers(0, len(stamps)), max_size=10)))
    until_us = data.draw(st.integers(0, 1200))
    segments = []
    for pending in (kept(stamps, []), kept(stamps, cuts)):
        run, rest = split_pending(pending, until_us)
        assert (rest.t_us > until_us).all()
        segments.append(imu_segment(run, NOWHERE, until_us))
    assert (segments[0].samples == segments[1].samples).all()
    assert segments[0][1:] == segments[1][1:]


def test_a_sample_from_the_past_is_left_out():
    run, _ = split_pending(kept([10, 30, 20, 30, 40], []), 100)
    assert run.t_us.tolist() == [10, 30, 40]


def test_a_segment_holds_the_last_sample_to_the_end():
    part = imu_segment(run_at([1_000_000, 1_500_000]), NOWHERE, 1_600_000)
    assert np.allclose(part.samples[:, 0], [1.0, 0.5, 0.1])
    assert (part.samples[2, 1:] == part.samples[1, 1:]).all()
    assert part.gap_s == 1.0


def test_without_epochs_the_newest_samples_are_kept(monkeypatch):
    monkeypatch.setattr(motion, "PENDING_MAX", 10)
    for cuts in ([], list(range(1, 100)), [37, 61]):
        pending = kept(list(range(1, 101)), cuts)
        assert len(pending.t_us) <= 10
        assert split_pending(pending, 1000)[0].t_us.tolist() == list(range(91, 101))
