"""Least squares over a chain, against dense algebra."""

import numpy as np
import pytest

from wayside.stages.georeference.banded import BandedNormal, block_covariances


def chain_of(rng, blocks, size):
    """A chain with five measurements in every block and five over every joint; and the same as one dense matrix."""
    own, own_wanted = rng.normal(size=(blocks, 5, size)), rng.normal(size=(blocks, 5))
    joint = rng.normal(size=(blocks - 1, 5, 2 * size))
    joint_wanted = rng.normal(size=(blocks - 1, 5))
    normal = BandedNormal(blocks, size)
    normal.add(np.arange(blocks), range(size), own, own_wanted)
    normal.add(np.arange(1, blocks), range(-size, size), joint, joint_wanted)
    dense = np.zeros((2 * blocks - 1, 5, blocks * size))
    for k in range(blocks):
        dense[k, :, k * size : (k + 1) * size] = own[k]
    for k in range(1, blocks):
        dense[blocks + k - 1, :, (k - 1) * size : (k + 1) * size] = joint[k - 1]
    wanted = np.concatenate([own_wanted.ravel(), joint_wanted.ravel()])
    return normal, dense.reshape(-1, blocks * size), wanted


@pytest.mark.parametrize(("blocks", "size"), [(1, 3), (2, 1), (6, 4), (40, 3)])
def test_the_solution_and_its_covariances_are_those_of_dense_least_squares(blocks, size):
    normal, dense, wanted = chain_of(np.random.default_rng(blocks), blocks, size)
    found, factor = normal.solve()
    np.testing.assert_allclose(found.ravel(), np.linalg.lstsq(dense, wanted)[0], atol=1e-10)
    inverse = np.linalg.inv(dense.T @ dense).reshape(blocks, size, blocks, size)
    own = np.einsum("kikj->kij", inverse)
    np.testing.assert_allclose(block_covariances(factor, size), own, atol=1e-10)


def test_an_undetermined_unknown_is_refused():
    normal = BandedNormal(2, 2)
    normal.add(np.arange(2), (0,), np.ones((2, 1, 1)), np.ones((2, 1)))
    with pytest.raises(np.linalg.LinAlgError):
        normal.solve()


def test_a_factor_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"factor: .* instead of any x 6"):
        block_covariances(np.ones((4, 10)), 3)
