"""A receiver that comes back from a slow drift, and one that jumps away."""

import numpy as np
import pytest

from analysis.detection.receiver.drift_return import follow_drift, has_returned
from analysis.detection.receiver.position_test import VELOCITY_VARIANCE, FixMeasurement
from analysis.detection.receiver.receiver_state import DriftTrack, LastFix

FIX_US, FIXES = 200_000, 300  # a minute at 5 Hz
AXES = np.eye(3)


def last_steps(offsets_m: list[float], noise_m: float = 0.3) -> tuple[bool, bool]:
    """Whether the receiver is back at the last fix and at the one before; it is off to the north by
    `offsets_m`, which its velocity does not show, while it flies east."""
    rng = np.random.default_rng(4)
    track, last, found = DriftTrack(), None, [False]
    for k, offset_m in enumerate(offsets_m):
        t_us = 1_000_000 + k * FIX_US
        place_m = np.array([offset_m, 3.0 * k * FIX_US * 1e-6, 0.0]) + rng.normal(0.0, noise_m, 3)
        velocity_mps = np.array([0.0, 3.0, 0.0]) + rng.normal(0.0, 0.05, 3)
        fix = FixMeasurement(
            place_m, AXES, np.array([1.0, 1.0, 2.25]), velocity_mps, VELOCITY_VARIANCE
        )
        before, track = track, follow_drift(track, last, fix, t_us)
        found.append(has_returned(before, track, fix, t_us))
        last = LastFix(t_us, place_m, velocity_mps, (), np.zeros(3))
    return found[-1], found[-2]


@pytest.mark.parametrize("rate_mps", [0.3, -0.4])
def test_a_receiver_is_back_from_a_drift(rate_mps: float) -> None:
    drift = [rate_mps * max(k - 150, 0) * FIX_US * 1e-6 for k in range(FIXES)]
    assert last_steps([*drift, 0.0]) == (True, False)


@pytest.mark.parametrize("jump_m", [6.0, -20.0])
def test_a_jump_away_is_no_return(jump_m: float) -> None:
    assert last_steps([*[0.0] * FIXES, jump_m]) == (False, False)


def test_a_jump_from_a_drift_to_elsewhere_is_no_return() -> None:
    drift = [0.3 * max(k - 150, 0) * FIX_US * 1e-6 for k in range(FIXES)]
    assert last_steps([*drift, -20.0]) == (False, False)
