"""All rotation formats agree with each other and with scipy."""

import numpy as np
from scipy.spatial.transform import Rotation

from mavproxy_fault.numerics.rotations import one_rotation, rotation

RNG = np.random.default_rng(4)
SCIPY = Rotation.random(200, rng=RNG)
QUATS = np.roll(SCIPY.as_quat(), 1, axis=-1)


def test_matrices_agree_with_scipy() -> None:
    assert np.allclose(rotation.matrix_from_quat(QUATS), SCIPY.as_matrix(), atol=1e-14)


def test_a_matrix_gives_its_quaternion_back_up_to_sign() -> None:
    back = rotation.quat_from_matrix(SCIPY.as_matrix())
    assert np.allclose(np.abs(np.sum(back * QUATS, axis=-1)), 1.0, atol=1e-14)


def test_half_turns_have_a_quaternion_too() -> None:
    for axis in np.eye(3):
        q = np.concatenate([[0.0], axis])
        back = rotation.quat_from_matrix(rotation.matrix_from_quat(q))
        assert np.allclose(np.abs(back), q)


def test_euler_angles_agree_with_scipy() -> None:
    yaw, pitch, roll = SCIPY.as_euler("ZYX").T
    assert np.allclose(rotation.euler_from_quat(QUATS), np.stack([roll, pitch, yaw], -1), atol=1e-9)


def test_euler_angles_there_and_back() -> None:
    angles = RNG.uniform(-1.5, 1.5, (100, 3))
    back = rotation.euler_from_quat(rotation.quat_from_euler(*angles.T))
    assert np.allclose(back, angles, atol=1e-12)


def test_angles_wrap_into_one_turn() -> None:
    assert np.allclose(
        rotation.wrap_angles([np.pi, 3.5 * np.pi, -0.1]), [-np.pi, -0.5 * np.pi, -0.1]
    )


def test_single_values_agree_with_arrays() -> None:
    vector = np.array([0.3, -2.0, 5.0])
    for q in QUATS:
        assert np.allclose(one_rotation.euler_angles(q), rotation.euler_from_quat(q), atol=1e-12)
        there = rotation.matrix_from_quat(q).T @ vector
        assert np.allclose(one_rotation.rotate_to_body(q, vector), there, atol=1e-12)
