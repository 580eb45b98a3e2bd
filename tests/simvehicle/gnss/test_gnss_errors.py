"""The error processes have the configured statistics."""

import math

import numpy as np
import pytest

from simvehicle.gnss.gnss_config import ClockConfig
from simvehicle.gnss.signal_errors import (
    ReceiverClock,
    multipath_sigma_m,
    step_clock,
    step_gauss_markov,
)


def test_a_gauss_markov_process_keeps_unit_variance_and_decorrelates_exponentially() -> None:
    rng = np.random.default_rng(7)
    n = 4000
    start = rng.standard_normal(n)
    value = start
    for _ in range(50):
        value = step_gauss_markov(value, 20.0, 0.2, rng.standard_normal(n))
    assert np.var(value) == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / n))
    assert np.mean(value * start) == pytest.approx(math.exp(-10.0 / 20.0), abs=5.0 / math.sqrt(n))


def test_without_a_correlation_time_it_is_white() -> None:
    draws = np.array([1.0, -2.0])
    assert np.array_equal(step_gauss_markov(np.array([9.0, 9.0]), 0.0, 0.2, draws), draws)


def test_the_clock_has_the_covariance_of_its_model() -> None:
    config = ClockConfig(h0_s=2e-19, h2_hz=2e-20)
    rng = np.random.default_rng(3)
    step_s, n = 2.0, 20_000
    ends = [
        step_clock(ReceiverClock(0.0, 0.0), config, step_s, rng.standard_normal(2))
        for _ in range(n)
    ]
    offset = np.array([e.offset_s for e in ends])
    drift = np.array([e.drift for e in ends])
    q_o, q_d = 1e-19, 2.0 * math.pi**2 * 2e-20
    bound = 5.0 * math.sqrt(2.0 / n)
    assert np.var(offset) == pytest.approx(q_o * step_s + q_d * step_s**3 / 3.0, rel=bound)
    assert np.var(drift) == pytest.approx(q_d * step_s, rel=bound)
    assert np.mean(offset * drift) == pytest.approx(q_d * step_s**2 / 2.0, rel=2.0 * bound)


def test_the_clock_of_many_steps_is_that_of_one_long_step() -> None:
    config = ClockConfig(h0_s=0.0, h2_hz=2e-20)
    rng = np.random.default_rng(4)
    ends = []
    for _ in range(1500):
        clock = ReceiverClock(0.0, 0.0)
        for _ in range(10):
            clock = step_clock(clock, config, 0.2, rng.standard_normal(2))
        ends.append(clock.offset_s)
    q_d = 2.0 * math.pi**2 * 2e-20
    assert np.var(ends) == pytest.approx(q_d * 2.0**3 / 3.0, rel=5.0 * math.sqrt(2.0 / 1500))


def test_a_perfect_clock_only_drifts() -> None:
    config = ClockConfig(h0_s=0.0, h2_hz=0.0)
    clock = step_clock(ReceiverClock(1e-6, 1e-7), config, 3.0, np.array([4.0, 4.0]))
    assert (clock.offset_s, clock.drift) == (pytest.approx(1.3e-6, rel=1e-12), 1e-7)


def test_a_clock_off_by_half_a_millisecond_is_stepped_by_one() -> None:
    config = ClockConfig(h0_s=0.0, h2_hz=0.0)
    clock = step_clock(ReceiverClock(0.4999e-3, 1e-6), config, 1.0, np.zeros(2))
    assert clock.offset_s == pytest.approx(0.5009e-3 - 1e-3, abs=1e-15)


def test_multipath_is_largest_at_the_horizon() -> None:
    sigma = multipath_sigma_m(np.radians([0.0, 10.0, 90.0]))
    assert sigma == pytest.approx([0.66, 0.13 + 0.53 / math.e, 0.13], abs=1e-4)
