import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.stages.geometry.rotation import (
    rotation_from_vector,
    tangent_basis,
    vector_from_rotation,
)

numbers = st.floats(-1.7, 1.7)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


@given(vectors)
def test_a_rotation_vector_gives_the_matrix_that_scipy_gives_and_comes_back_of_it(vector):
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(vector), expected, atol=1e-12)
    np.testing.assert_allclose(vector_from_rotation(expected), vector, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, np.pi - 1e-6])
def test_tiny_angles_and_half_turns_keep_their_vector(angle):
    axis = np.array([0.6, -0.48, 0.64])
    back = vector_from_rotation(Rotation.from_rotvec(axis * angle).as_matrix())
    np.testing.assert_allclose(back, axis * angle, atol=1e-9)


@given(vectors)
def test_the_two_directions_across_are_unit_and_at_right_angles(vector):
    length = np.linalg.norm(vector)
    if length < 1e-3:
        return
    basis = np.vstack([vector / length, tangent_basis(vector / length)])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-9)
