"""Noise: the logarithm against the library's, Gaussian numbers against their distribution."""

import math

import numpy as np
from scipy import stats

from analysis.search.noise_kernel import gauss_pair, generator_states, log, next_bits
from simvehicle.compiled import compiled


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


def test_the_logarithm_is_right_to_the_last_digits():
    x = np.concatenate([np.logspace(-300, 300, 5001), np.linspace(0.5, 2.0, 5001)])
    assert np.abs(logs(x) - np.log(x)).max() <= 4.0 * np.spacing(np.abs(np.log(x)).max())
    near_one = 1.0 + np.linspace(-0.3, 0.3, 1001)
    assert np.abs(logs(near_one) - np.log(near_one)).max() < 3e-16


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
