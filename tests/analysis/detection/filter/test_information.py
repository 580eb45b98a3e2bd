"""Updates by information against the textbook's Kalman filter, and the windows' responses too."""

import numpy as np
import pytest

from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE
from analysis.detection.filter.information import (
    innovation_statistic,
    inverse_covariance,
    measurement_update,
    normal_equations,
    select_columns,
    visible_states,
)
from analysis.detection.isolation.ramp_windows import WINDOW_COUNT, RampWindows, respond_to_ranges

RNG = np.random.default_rng(9)
COUNT = 9


def measured(widened: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A covariance, nine ranges' geometry, variance and innovations; the clock's variance more."""
    root = RNG.standard_normal((ERROR_SIZE, ERROR_SIZE))
    p = root @ root.T
    p[15, 15] += widened
    h = np.zeros((COUNT, ERROR_SIZE))
    h[:, :3], h[:, 15], h[5:, 17] = RNG.standard_normal((COUNT, 3)), 1.0, 1.0
    return p, h, RNG.uniform(0.3, 2.0, COUNT), RNG.standard_normal(COUNT)


def test_the_statistic_is_that_of_the_innovation_covariance():
    p, h, variance, v = measured()
    m = np.linalg.inv(h @ p @ h.T + np.diag(variance))
    assert np.allclose(inverse_covariance(p, h, variance), m, atol=1e-10)
    assert innovation_statistic(p, h, variance, v) == pytest.approx(v @ m @ v, rel=1e-9)


@pytest.mark.parametrize("widened", [0.0, 1e6])
def test_an_update_is_that_of_the_kalman_filter(widened: float):
    p, h, variance, v = measured(widened)
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.diag(variance))
    rest = np.eye(ERROR_SIZE) - gain @ h
    joseph = rest @ p @ rest.T + gain @ np.diag(variance) @ gain.T
    moved, after = measurement_update(x, p, h, variance, v)
    assert np.allclose(after, joseph, atol=1e-7)
    assert np.linalg.eigvalsh(after).min() > 0.0
    shift = gain @ v
    assert np.allclose(moved[:6], shift[:6], atol=1e-7)
    assert np.allclose(moved[10:], shift[9:], atol=1e-7)


def test_the_windows_sum_what_the_formed_innovations_would():
    p, h, variance, v = measured()
    m = np.linalg.inv(h @ p @ h.T + np.diag(variance))
    gain, each = p @ h.T @ m, COUNT + 3
    d = RNG.standard_normal((ERROR_SIZE, WINDOW_COUNT * each))
    offsets, ages = RNG.standard_normal((WINDOW_COUNT, COUNT)), np.array([3.0, 8.0, 13.0, 18.0])
    phi = np.eye(ERROR_SIZE) + 0.1 * RNG.standard_normal((ERROR_SIZE, ERROR_SIZE))
    states, after = (
        visible_states(h),
        measurement_update(np.eye(1, X_SIZE, 6)[0], p, h, variance, v)[1],
    )
    out, sums = respond_to_ranges(
        RampWindows(
            np.zeros(WINDOW_COUNT, np.int64),
            d,
            np.zeros((WINDOW_COUNT, 5 * COUNT + 12)),
            np.zeros(COUNT),
            np.zeros(COUNT),
            offsets,
            np.zeros_like(offsets),
        ),
        ages,
        phi,
        select_columns(after, states),
        normal_equations(h, variance, v),
        0.0,
    )
    d = phi @ d
    for w in range(WINDOW_COUNT):
        own = d[:, w * each : (w + 1) * each]
        g = np.hstack([ages[w] * np.eye(COUNT), np.zeros((COUNT, 3))]) - h @ own
        left = m @ (v - offsets[w])
        ramps, turned = g[:, :COUNT], m @ g
        expected = [
            *(ramps.T @ left),
            *left,
            *(ramps * turned[:, :COUNT]).sum(axis=0),
            *np.diag(turned[:, :COUNT]),
            *np.diag(m),
            *(g[:, COUNT:].T @ left),
            *(g[:, COUNT:].T @ turned[:, COUNT:]).ravel(),
        ]
        assert np.allclose(sums[w], expected, rtol=1e-9, atol=1e-8)
        assert np.allclose(out[:, w * each : (w + 1) * each], own + gain @ g, atol=1e-8)
