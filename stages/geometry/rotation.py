"""Rotations as matrices and rotation vectors, for kernels; outside of kernels scipy's `Rotation` does the same."""

import numpy as np

from wayside.stages.kernels import Array, compiled


@compiled
def rotation_from_vector(vector: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) in radians (Rodrigues)."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = np.sqrt(x * x + y * y + z * z)
    if angle < 1e-8:
        a, b = 1.0 - angle * angle / 6.0, 0.5
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    matrix = np.empty((3, 3))
    matrix[0, 0] = 1 - b * (y * y + z * z)
    matrix[0, 1] = -a * z + b * x * y
    matrix[0, 2] = a * y + b * x * z
    matrix[1, 0] = a * z + b * x * y
    matrix[1, 1] = 1 - b * (x * x + z * z)
    matrix[1, 2] = -a * x + b * y * z
    matrix[2, 0] = -a * y + b * x * z
    matrix[2, 1] = a * x + b * y * z
    matrix[2, 2] = 1 - b * (x * x + y * y)
    return matrix


@compiled
def vector_from_rotation(matrix: Array) -> Array:
    """Rotation vector (3,) in radians, angle in [0, pi], of a rotation matrix (3, 3)."""
    # By the quaternion's largest component: accurate for small angles and for angles near pi.
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    q = np.empty(4)  # x, y, z, w
    largest = 3
    value = trace
    for k in range(3):
        if matrix[k, k] > value:
            largest, value = k, matrix[k, k]
    if largest == 3:
        q[0] = matrix[2, 1] - matrix[1, 2]
        q[1] = matrix[0, 2] - matrix[2, 0]
        q[2] = matrix[1, 0] - matrix[0, 1]
        q[3] = 1.0 + trace
    else:
        i = largest
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 - trace + 2.0 * matrix[i, i]
        q[j] = matrix[j, i] + matrix[i, j]
        q[k] = matrix[k, i] + matrix[i, k]
        q[3] = matrix[k, j] - matrix[j, k]
    if q[3] < 0:
        for i in range(4):
            q[i] = -q[i]
    sine = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    factor = 2.0 / q[3] if sine < 1e-12 * q[3] else 2.0 * np.arctan2(sine, q[3]) / sine
    vector = np.empty(3)
    for i in range(3):
        vector[i] = q[i] * factor
    return vector


@compiled
def halfway_direction(rotation: Array, direction: Array) -> Array:
    """Direction (3,), given in the axes half way through a rotation, in the axes before it."""
    vector = vector_from_rotation(rotation)
    for i in range(3):
        vector[i] *= 0.5
    half, turned = rotation_from_vector(vector), np.empty(3)
    for i in range(3):
        row = half[i]
        turned[i] = row[0] * direction[0] + row[1] * direction[1] + row[2] * direction[2]
    return turned


@compiled
def tangent_basis(direction: Array) -> Array:
    """Two unit vectors (2, 3) at right angles to a unit vector (3,) and to each other.

    For a direction near the camera's z axis they are nearly the x and the y axis.
    """
    first = np.empty(3)
    if abs(direction[1]) < 0.9:
        first[0], first[1], first[2] = direction[2], 0.0, -direction[0]
    else:
        first[0], first[1], first[2] = 0.0, direction[2], -direction[1]
    length = np.sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2])
    result = np.empty((2, 3))
    for i in range(3):
        first[i] /= length
        result[0, i] = first[i]
    result[1, 0] = direction[1] * first[2] - direction[2] * first[1]
    result[1, 1] = direction[2] * first[0] - direction[0] * first[2]
    result[1, 2] = direction[0] * first[1] - direction[1] * first[0]
    return result
