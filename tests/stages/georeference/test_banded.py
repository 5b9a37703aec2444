"""Least squares over a chain, against dense algebra."""

import numpy as np
import pytest

from wayside.stages.georeference.banded import BandedNormal, block_covariances


def chain_of(rng, blocks, size):
    """A chain with five measurements in every block and five over every joint; and the same as one dense matrix."""
    own, own_wanted = rng.normal(size=(blocks, 5, size)), rng.normal(size=(blocks, 5))
    joint, joint_wanted = (
        rng.normal(size=(blocks - 1, 5, 2 * size)),
        rng.normal(size=(blocks - 1, 5)),
    )
    normal = BandedNormal(blocks, size)
    normal.add(np.arange(blocks), range(size), own, own_wanted)
    normal.add(np.arange(1, blocks), range(-size, size), joint, joint_wanted)
    rows = []
    for k in range(blocks):
        row = np.zeros((5, blocks * size))
        row[:, k * size : (k + 1) * size] = own[k]
        rows.append(row)
    for k in range(1, blocks):
        row = np.zeros((5, blocks * size))
        row[:, (k - 1) * size : (k + 1) * size] = joint[k - 1]
        rows.append(row)
    wanted = np.concatenate([own_wanted.ravel(), joint_wanted.ravel()])
    return normal, np.concatenate(rows), wanted


@pytest.mark.parametrize(("blocks", "size"), [(1, 3), (2, 1), (6, 4), (40, 3)])
def test_the_solution_is_that_of_dense_least_squares(blocks, size):
    normal, dense, wanted = chain_of(np.random.default_rng(blocks), blocks, size)
    found, _ = normal.solve()
    expected = np.linalg.lstsq(dense, wanted)[0]
    np.testing.assert_allclose(found.ravel(), expected, atol=1e-10)


@pytest.mark.parametrize(("blocks", "size"), [(1, 3), (2, 1), (6, 4), (40, 3)])
def test_the_block_covariances_is_that_of_the_dense_inverse(blocks, size):
    normal, dense, _ = chain_of(np.random.default_rng(blocks), blocks, size)
    own = block_covariances(normal.solve()[1], size)
    inverse = np.linalg.inv(dense.T @ dense)
    for k in range(blocks):
        rows = slice(k * size, (k + 1) * size)
        np.testing.assert_allclose(own[k], inverse[rows, rows], atol=1e-10)


def test_an_undetermined_unknown_is_refused():
    normal = BandedNormal(2, 2)
    normal.add(np.arange(2), (0,), np.ones((2, 1, 1)), np.ones((2, 1)))
    with pytest.raises(np.linalg.LinAlgError):
        normal.solve()


def test_a_factor_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"factor: .* instead of any x 6"):
        block_covariances(np.ones((4, 10)), 3)
