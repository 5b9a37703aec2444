"""Small dense linear algebra: Cholesky solution, inverse of a symmetric 3 x 3 matrix; cross products, medians."""

import numpy as np

from wayside.stages.kernels import Array, compiled


@compiled
def cholesky_solve(matrix: Array, right: Array) -> bool:
    """Solve in place by Cholesky: the lower half of `matrix` becomes its factor, `right` the solution.

    Returns False, with both arrays overwritten, where the matrix is not positive definite.
    """
    size = right.shape[0]
    for j in range(size):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        if not total > 0:
            return False
        root = np.sqrt(total)
        matrix[j, j] = root
        for i in range(j + 1, size):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / root
    for i in range(size):
        rest = right[i]
        for k in range(i):
            rest -= matrix[i, k] * right[k]
        right[i] = rest / matrix[i, i]
    for i in range(size - 1, -1, -1):
        rest = right[i]
        for k in range(i + 1, size):
            rest -= matrix[k, i] * right[k]
        right[i] = rest / matrix[i, i]
    return True


@compiled
def invert_symmetric(matrix: Array, damping: float, floor: float, result: Array) -> float:
    """Fill `result` with the inverse of a symmetric matrix (3, 3), of which the upper half is read.

    The diagonal is first multiplied by 1 + damping and raised by `floor`. Returns the determinant over the product of
    the diagonal: 1 for a diagonal matrix, 0 for a singular one, of which `result` stays as it was.
    """
    a, b, c = matrix[0, 0] * (1 + damping) + floor, matrix[0, 1], matrix[0, 2]
    d, e = matrix[1, 1] * (1 + damping) + floor, matrix[1, 2]
    f = matrix[2, 2] * (1 + damping) + floor
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    determinant, scale = a * m0 + b * m1 + c * m2, a * d * f
    if determinant == 0.0 or scale == 0.0:
        return 0.0
    q = 1.0 / determinant
    result[0, 0], result[0, 1], result[0, 2] = m0 * q, m1 * q, m2 * q
    result[1, 0], result[1, 1], result[1, 2] = m1 * q, (a * f - c * c) * q, (b * c - a * e) * q
    result[2, 0], result[2, 1], result[2, 2] = m2 * q, (b * c - a * e) * q, (a * d - b * b) * q
    return float(determinant / scale)


def cross_matrices(vectors: Array) -> Array:
    """Matrices (..., 3, 3) that multiply by `vectors` (..., 3) in the cross product, from the left."""
    return np.asarray((vectors @ _CROSS).reshape(*vectors.shape, 3))


_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2).reshape(3, 9)
"""These matrices of the three axes, row after row."""
