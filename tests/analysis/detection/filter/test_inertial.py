"""The covariance between epochs against its transition."""

import numpy as np
import pytest

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE, propagate_inertial

RNG = np.random.default_rng(8)
START_M = np.array([4.2e6, 6.0e5, 4.7e6])
UPHOLDING_MPS2 = np.array([0.0, 0.0, -9.8])

NO_NOISE = ProcessNoise(**dict.fromkeys(ProcessNoise.__struct_fields__, 0.0))


def moving() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A state, a covariance with every correlation, and a second of a lively IMU."""
    x = np.zeros(X_SIZE)
    x[:3], x[3:6], x[6] = START_M, (20.0, -3.0, 5.0), 1.0
    root = RNG.standard_normal((ERROR_SIZE, ERROR_SIZE))
    samples = np.hstack(
        [
            np.full((100, 1), 0.01),
            RNG.normal(0.0, 0.5, (100, 3)),
            RNG.normal(UPHOLDING_MPS2, 2.0, (100, 3)),
        ]
    )
    return x, root @ root.T, samples


def test_without_noise_the_covariance_follows_the_transition():
    x, p, samples = moving()
    _, after, phi = propagate_inertial(x, p, samples, NO_NOISE)
    assert np.allclose(after, phi @ p @ phi.T, rtol=1e-11, atol=1e-9)
    assert (after == after.T).all()


@pytest.mark.parametrize("rate_hz", [10, 25])
def test_unmeasured_motion_of_a_slow_imu_is_in_the_sigma_of_the_velocity(rate_hz: int):
    x = moving()[0]
    x[3:6] = 0.0
    step = 400 // rate_hz
    errors, variances = [], []
    for _ in range(200):
        fast = RNG.normal(UPHOLDING_MPS2, 10.0, (1 + 400, 3))
        forces = fast[::step][1:]
        samples = np.hstack([np.full((rate_hz, 1), 1 / rate_hz), np.zeros((rate_hz, 3)), forces])
        exact = np.hstack([np.full((400, 1), 1 / 400), np.zeros((400, 3)), fast[1:]])
        seen, p, _ = propagate_inertial(x, np.zeros((ERROR_SIZE, ERROR_SIZE)), samples, NO_NOISE)
        true, none, _ = propagate_inertial(x, np.zeros((ERROR_SIZE, ERROR_SIZE)), exact, NO_NOISE)
        assert not none.any()
        errors.append(seen[3:6] - true[3:6])
        variances.append(np.diag(p)[3:6])
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(variances))
    assert 0.8 < ratio < 1.25


def test_the_transition_is_the_derivative_of_the_motion():
    x, p, samples = moving()
    end, _, phi = propagate_inertial(x, p, samples, NO_NOISE)
    for state, error in ((3, 3), (13, 12), (17, 16)):  # velocity, accelerometer bias, drift
        other = x.copy()
        other[state] += 1e-3
        moved = propagate_inertial(other, p, samples, NO_NOISE)[0] - end
        assert np.allclose(moved[:6], 1e-3 * phi[:6, error], atol=1e-5)  # position by Euler's step
        assert np.isclose(moved[16], 1e-3 * phi[15, error])
