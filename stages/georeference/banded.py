"""Least squares over a chain: unknowns in blocks, each measurement touching one block or two neighbours.

The normal matrix of such a problem is banded, so that the solution and the covariance of every block cost time and
memory proportional to the length of the chain.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, solve_banded

from wayside.stages.kernels import Array, Numbers, compiled, require_array


class BandedNormal:
    """Normal equations J' J x = J' r of a chain of blocks of `size` unknowns each, lower band by lower band."""

    def __init__(self, blocks: int, size: int) -> None:
        self.blocks, self.size = blocks, size
        self.band: Array = np.zeros((2 * size, blocks * size))  # [i - j, j] is the entry (i, j)
        self.right: Array = np.zeros(blocks * size)

    def add(
        self,
        block: Numbers,
        columns: Sequence[int],
        jacobian: Array,
        residual: Array,
        weight: Array | float = 1.0,
    ) -> None:
        """Add measurements of one kind.

        `block` (m,): the block of each measurement, none twice. `columns`: its c unknowns, counted from the first of
        the block; down to -size for the block before. `jacobian` (m, r, c), `residual` (m, r): of the prediction, and
        measured minus predicted. `weight`: one over the variance: a number, (m, r) or (m, 1).
        """
        weighted = jacobian * np.asarray(weight)[..., None]
        first = block * self.size
        for a, column in enumerate(columns):
            self.right[first + column] += (weighted[:, :, a] * residual).sum(axis=1)
            for b, other in enumerate(columns[: a + 1]):
                high, low = max(column, other), min(column, other)
                product = (weighted[:, :, a] * jacobian[:, :, b]).sum(axis=1)
                self.band[high - low, first + low] += product

    def solve(self) -> tuple[Array, Array]:
        """The unknowns (blocks, size), and the Cholesky factor of the band for `block_covariances`.

        Raises numpy.linalg.LinAlgError where the measurements leave something undetermined.
        """
        factor = cholesky_banded(self.band, lower=True)
        unknown = cho_solve_banded((factor, True), self.right)
        return unknown.reshape(self.blocks, self.size), np.asarray(factor)


def block_covariances(factor: Array, size: int) -> Array:
    """Covariance of each block (blocks, size, size), from the banded Cholesky factor.

    Only entries within the band of the inverse are computed (Takahashi, Fagan and Chin 1973).

    `factor` (2 size, n): lower Cholesky factor in band form, n a multiple of size.
    """
    columns = np.ascontiguousarray(factor.T)
    require_array(columns, "factor", np.float64, (None, 2 * size))
    inverse = _inverse_band(columns).T
    first = np.arange(0, len(columns), size)[:, None, None]
    row, column = np.indices((size, size))
    return np.asarray(inverse[np.abs(row - column), first + np.minimum(row, column)])


def combination_variance(factor: Array, last: Array, gradient: Array) -> float:
    """Variance of a linear combination of the unknowns of neighbouring blocks, first to last.

    The blocks after these do not enter but by the covariance of the last: given it, those before are independent of
    them. The cost is proportional to the number of blocks of the combination.

    `factor` (2 size, k size): columns of the banded Cholesky factor of these k blocks. `last` (size, size): covariance
    of the last block, from `block_covariances`. `gradient` (k size,): the factor of each unknown.
    """
    size = len(last)
    white = np.asarray(solve_banded((len(factor) - 1, 0), factor, gradient))
    row, column = np.indices((size, size))
    lower = np.tril(factor[row - column, column - size])
    rest = lower @ white[-size:]
    return float(white[:-size] @ white[:-size] + rest @ last @ rest)


@compiled
def _inverse_band(factor: Array) -> Array:
    """Band of the inverse of L L', [j, i - j] for entry (i, j), from the last column to the first."""
    n, width = factor.shape
    inverse = np.zeros((n, width))
    for j in range(n - 1, -1, -1):
        reach = min(width - 1, n - 1 - j)
        pivot = factor[j, 0]
        for i in range(j + reach, j - 1, -1):
            total = 1.0 / pivot if i == j else 0.0
            for k in range(j + 1, j + reach + 1):
                high, low = max(i, k), min(i, k)
                total -= factor[j, k - j] * inverse[low, high - low]
            inverse[j, i - j] = total / pivot
    return inverse
