import numpy as np
import pytest

from wayside.stages.geometry.linear_algebra import (
    cholesky_solve,
    cross_matrices,
    invert_symmetric,
)


def positive(size, seed):
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_of_a_symmetric_matrix_is_that_of_numpy(seed):
    matrix, result = positive(3, seed), np.empty((3, 3))
    condition = invert_symmetric(np.triu(matrix), 0.0, 0.0, result)
    np.testing.assert_allclose(result, np.linalg.inv(matrix), rtol=1e-8)
    assert condition == pytest.approx(np.linalg.det(matrix) / np.prod(np.diag(matrix)))


def test_damping_and_floor_raise_the_diagonal():
    matrix, result = positive(3, 9), np.empty((3, 3))
    invert_symmetric(matrix, 0.5, 0.2, result)
    damped = matrix + np.diag(0.5 * np.diag(matrix) + 0.2)
    np.testing.assert_allclose(result, np.linalg.inv(damped), rtol=1e-9)


def test_a_singular_matrix_is_told():
    result = np.full((3, 3), 7.0)
    assert invert_symmetric(np.zeros((3, 3)), 0.0, 0.0, result) == 0
    assert (result == 7).all()
    assert abs(invert_symmetric(np.ones((3, 3)), 0.0, 0.0, result)) < 1e-12


def test_the_cross_matrix_multiplies_as_the_cross_product():
    first, second = np.random.default_rng(3).normal(size=(2, 6, 3))
    np.testing.assert_allclose(cross_matrices(first[0]) @ second[0], np.cross(first[0], second[0]))
    many = np.einsum("nij,nj->ni", cross_matrices(first), second)
    np.testing.assert_allclose(many, np.cross(first, second))


def test_cholesky_solves_and_refuses_what_is_not_positive_definite():
    matrix, right = positive(5, 4), np.arange(5.0)
    wanted = np.linalg.solve(matrix, right)
    assert cholesky_solve(np.tril(matrix), right)
    np.testing.assert_allclose(right, wanted, rtol=1e-8)
    assert not cholesky_solve(-np.eye(3), np.ones(3))
