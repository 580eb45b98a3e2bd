"""Updates by information against the textbook's Kalman filter, and the windows' responses too."""

import numpy as np
import pytest

from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE
from analysis.detection.filter.information import (
    add_error,
    innovation_statistic,
    inverse_covariance,
    lasting_covariance,
    normal_equations,
    reduce_covariance,
)
from analysis.detection.isolation.ramp_windows import WINDOW_COUNT, RampWindows, respond

RNG = np.random.default_rng(9)
COUNT = 9


def measured(
    widened: float = 0.0, count: int = COUNT
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A covariance, ranges' geometry, variance and innovations; the clock's variance more."""
    root = RNG.standard_normal((ERROR_SIZE, ERROR_SIZE))
    p = root @ root.T
    p[15, 15] += widened
    h = np.zeros((count, ERROR_SIZE))
    h[:, :3], h[:, 15], h[5:, 17] = RNG.standard_normal((count, 3)), 1.0, 1.0
    return p, h, RNG.uniform(0.3, 2.0, count), RNG.standard_normal(count)


def test_the_statistic_is_that_of_the_innovation_covariance():
    p, h, variance, v = measured()
    m = np.linalg.inv(h @ p @ h.T + np.diag(variance))
    normal = normal_equations(h, variance, v, variance)
    assert np.allclose(inverse_covariance(p, normal), m, atol=1e-10)
    assert innovation_statistic(p, normal) == pytest.approx(v @ m @ v, rel=1e-9)


@pytest.mark.parametrize("widened", [0.0, 1e6])
def test_an_update_is_that_of_the_kalman_filter(widened: float):
    p, h, variance, v = measured(widened)
    x = np.zeros(X_SIZE)
    x[6] = 1.0
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.diag(variance))
    rest = np.eye(ERROR_SIZE) - gain @ h
    joseph = rest @ p @ rest.T + gain @ np.diag(variance) @ gain.T
    after, _, error = reduce_covariance(p, normal_equations(h, variance, v, variance))
    moved = add_error(x, error)
    assert np.allclose(after, joseph, atol=1e-7)
    assert np.linalg.eigvalsh(after).min() > 0.0
    shift = gain @ v
    assert np.allclose(moved[:6], shift[:6], atol=1e-7)
    assert np.allclose(moved[10:], shift[9:], atol=1e-7)


def test_noise_that_lasts_moves_the_snapshot_and_not_the_prediction():
    p, h, variance, v = measured(count=12)
    white = variance * RNG.uniform(0.05, 0.6, 12)
    seen = np.flatnonzero(h.any(axis=0))
    a, prior = h[:, seen], p[np.ix_(seen, seen)]
    snapshot = np.linalg.inv((a.T / variance) @ a) @ (a.T / variance)
    of_white = (snapshot * white) @ snapshot.T
    lasting = (snapshot * (variance - white)) @ snapshot.T
    m = np.linalg.inv(a @ (prior - lasting) @ a.T + np.diag(variance))
    assert not normal_equations(h[3:], variance[3:], v[3:], white[3:]).white.size  # too few
    normal = normal_equations(h, variance, v, white)
    assert np.allclose(inverse_covariance(p, normal), m, atol=1e-3)
    assert innovation_statistic(p, normal) == pytest.approx(v @ m @ v, rel=1e-3)
    assert np.allclose(lasting_covariance(normal), lasting, atol=1e-3)
    # The update is that of the snapshot as a measurement with its white noise.
    gain = p[:, seen] @ np.linalg.inv(prior + of_white)
    after, (columns, _), moved = reduce_covariance(p, normal)
    assert np.allclose(after, p - gain @ p[seen], atol=1e-3)
    assert np.allclose(moved, gain @ snapshot @ v, atol=1e-3)
    assert np.allclose(columns @ (a.T / variance), gain @ snapshot, atol=1e-3)


def test_the_windows_sum_what_the_formed_innovations_would():
    p, h, variance, v = measured()
    m = np.linalg.inv(h @ p @ h.T + np.diag(variance))
    gain, each = p @ h.T @ m, COUNT + 3
    d = RNG.standard_normal((ERROR_SIZE, WINDOW_COUNT, each))
    offsets, ages = RNG.standard_normal((WINDOW_COUNT, COUNT)), np.array([3.0, 8.0, 13.0, 18.0])
    normal = normal_equations(h, variance, v, variance)
    _, (after, fit), _ = reduce_covariance(p, normal)
    windows = RampWindows(
        np.zeros(WINDOW_COUNT, np.int64),
        d.copy(),
        np.zeros((5, WINDOW_COUNT, COUNT)),
        np.zeros((WINDOW_COUNT, 3)),
        np.zeros((WINDOW_COUNT, 3, 3)),
        np.zeros(COUNT),
        np.zeros(COUNT),
        offsets,
        np.zeros_like(offsets),
    )
    respond(windows, ages, normal, after, fit, True)
    for w in range(WINDOW_COUNT):
        own = d[:, w]
        g = np.hstack([ages[w] * np.eye(COUNT), np.zeros((COUNT, 3))]) - h @ own
        left = m @ (v - offsets[w])
        ramps, turned = g[:, :COUNT], m @ g
        expected = [
            ramps.T @ left,
            left,
            (ramps * turned[:, :COUNT]).sum(axis=0),
            np.diag(turned[:, :COUNT]),
            np.diag(m),
        ]
        assert np.allclose(windows.sums[:, w], expected, rtol=1e-9, atol=1e-8)
        assert np.allclose(windows.c[w], g[:, COUNT:].T @ left, rtol=1e-9, atol=1e-8)
        assert np.allclose(windows.j[w], g[:, COUNT:].T @ turned[:, COUNT:], rtol=1e-9, atol=1e-8)
        assert np.allclose(windows.d[:, w], own + gain @ g, atol=1e-8)
