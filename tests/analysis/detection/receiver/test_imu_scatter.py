"""Samples of an IMU that scatter as they never did."""

import numpy as np

from analysis.detection.filter.propagation import ImuSegment
from analysis.detection.receiver.imu_scatter import ImuScatter, update_scatter

SECOND_US = 1_000_000


def shaken_at(
    noises: list[float], spike_at: int | None = None, turn_at: int | None = None
) -> set[int]:
    """The seconds in which an IMU of such noise, in m/s^2, is shaken; one may have a spike, one a
    turn that begins at once."""
    rng, known, found = np.random.default_rng(3), ImuScatter(), set()
    for second, noise in enumerate(noises):
        samples = np.column_stack([np.full(100, 0.01), rng.normal(0.0, noise, (100, 6))])
        if second == spike_at:
            samples[50, 4] += 50.0
        if second == turn_at:
            samples[50:60, 1] += 6.0 * np.arange(10)
            samples[60:, 1] += 54.0
        known = update_scatter(known, ImuSegment(samples, 0.0, True), second * SECOND_US)
        found |= {second} if known.shaken_us == second * SECOND_US else set()
    return found


def test_a_spike_is_noticed_at_once() -> None:
    assert shaken_at([0.05] * 60, spike_at=40) == {40}


def test_the_turn_of_a_wing_is_no_spike() -> None:
    assert shaken_at([0.05] * 60, turn_at=40) == set()


def test_noise_that_grows_by_a_take_off_is_not() -> None:
    assert shaken_at([0.05] * 30 + [0.4] * 30) == set()


def test_a_lasting_change_becomes_usual() -> None:
    found = shaken_at([0.05] * 30 + [5.0] * 90)
    assert min(found) == 30
    assert max(found) < 110
