"""Rotations for arrays, plain floats and compiled code agree."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavproxy_fault.numerics.rotations import (
    one_rotation,
    rotation,
    rotation_kernel,
)

ANGLES = st.tuples(*(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
VECTORS = st.tuples(*[st.floats(-1e3, 1e3)] * 3)


@settings(deadline=None)
@given(ANGLES, VECTORS)
def test_a_rotated_vector_is_the_same_in_every_implementation(
    angles: tuple[float, float, float], vector: tuple[float, float, float]
) -> None:
    q = rotation.quat_from_euler(*angles)
    assert rotation_kernel.quaternion_of_euler(*angles) == pytest.approx(q, abs=1e-15)
    expected = rotation.matrix_from_quat(q).T @ vector
    near = {"abs": 1e-12 * (1.0 + float(np.abs(vector).max()))}
    assert rotation_kernel.to_body(*q, *vector) == pytest.approx(expected, **near)
    assert rotation_kernel.to_ned(*q, *expected) == pytest.approx(vector, **near)
    assert rotation_kernel.rotation_matrix(q).T @ vector == pytest.approx(expected, **near)
    assert one_rotation.rotate_to_body(q.tolist(), vector) == pytest.approx(expected, **near)
    assert np.array(one_rotation.body_matrix(*angles)) @ vector == pytest.approx(expected, **near)


@settings(deadline=None)
@given(ANGLES, st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_angles_and_small_rotations_are_the_same_in_every_implementation(
    angles: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    q = rotation.quat_from_euler(*angles)
    for found in (rotation_kernel.euler_of_quaternion(q), one_rotation.euler_angles(q.tolist())):
        assert found == pytest.approx(rotation.euler_from_quat(q).tolist(), abs=1e-12)
    before, turned = Rotation.from_quat(np.roll(q, -1)), Rotation.from_rotvec(turn)
    after = rotation_kernel.rotate_attitude(q, *turn)
    assert rotation.matrix_from_quat(after) == pytest.approx(
        (before * turned).as_matrix(), abs=1e-12
    )
    assert one_rotation.rotate_quaternion(q.tolist(), turn) == pytest.approx(after, abs=1e-12)
    outside = rotation.matrix_from_quat(rotation_kernel.rotate_in_reference(q, *turn))
    assert outside == pytest.approx((turned * before).as_matrix(), abs=1e-12)
    angle = rotation_kernel.attitude_errors(q, after)[3]
    assert angle == pytest.approx(math.sqrt(sum(x * x for x in turn)), abs=1e-7)
