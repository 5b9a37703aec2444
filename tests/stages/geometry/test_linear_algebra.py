import numpy as np
import pytest

from wayside.stages.geometry.linear_algebra import cholesky_solve, invert_symmetric


def positive(size, seed):
    root = np.random.default_rng(seed).normal(size=(size, size))
    return root @ root.T + 0.1 * np.eye(size)


@pytest.mark.parametrize(("damping", "floor"), [(0.0, 0.0), (0.5, 0.2)])
def test_the_inverse_of_a_damped_symmetric_matrix_is_that_of_numpy(damping, floor):
    matrix, result = positive(3, 9), np.empty((3, 3))
    condition = invert_symmetric(np.triu(matrix), damping, floor, result)
    damped = matrix + np.diag(damping * np.diag(matrix) + floor)
    np.testing.assert_allclose(result, np.linalg.inv(damped), rtol=1e-8)
    assert condition == pytest.approx(np.linalg.det(damped) / np.prod(np.diag(damped)))


def test_a_singular_matrix_is_told():
    result = np.full((3, 3), 7.0)
    assert invert_symmetric(np.zeros((3, 3)), 0.0, 0.0, result) == 0
    assert (result == 7).all()
    assert abs(invert_symmetric(np.ones((3, 3)), 0.0, 0.0, result)) < 1e-12


def test_cholesky_solves_and_refuses_what_is_not_positive_definite():
    matrix, right = positive(5, 4), np.arange(5.0)
    wanted = np.linalg.solve(matrix, right)
    assert cholesky_solve(np.tril(matrix), right)
    np.testing.assert_allclose(right, wanted, rtol=1e-8)
    assert not cholesky_solve(-np.eye(3), np.ones(3))
