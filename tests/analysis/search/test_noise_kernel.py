"""Noise: the logarithm against the library's, Gaussian numbers against their distribution."""

import math

import numpy as np
import pytest
from scipy import stats

from analysis.search.lanes.noise_kernel import gauss_pair, generator_states, log, next_bits
from mavproxy_fault.numerics.compile import compiled


@compiled
def logs(x):
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i] = log(x[i])
    return out


@compiled
def gauss(start, count):
    out = np.empty(2 * count)
    state = start
    for i in range(count):
        state = next_bits(state)
        out[2 * i], out[2 * i + 1] = gauss_pair(state)
    return out


def test_the_logarithm_is_right_to_nine_digits_and_better_near_one():
    x = np.concatenate([np.logspace(-300, 300, 5001), np.linspace(0.5, 2.0, 5001)])
    assert np.abs(logs(x) - np.log(x)).max() < 5e-10
    near_one = 1.0 + np.linspace(-1e-3, 1e-3, 1000)
    assert logs(near_one) == pytest.approx(np.log(near_one), rel=1e-12)


def test_numbers_are_gaussian():
    x = gauss(generator_states(3, np.array([17], dtype=np.uint64))[0], 100_000)
    assert stats.kstest(x, "norm").pvalue > 0.01
    assert abs(np.corrcoef(x[::2], x[1::2])[0, 1]) < 4.0 / math.sqrt(100_000)
    assert abs(np.corrcoef(x[:-2], x[2:])[0, 1]) < 4.0 / math.sqrt(200_000)


def test_neighbouring_generators_are_not_alike():
    states = generator_states(3, np.arange(2000, dtype=np.uint64))
    assert len(set(states.tolist())) == 2000
    first = np.array([gauss(state, 1)[0] for state in states])
    assert stats.kstest(first, "norm").pvalue > 0.01
