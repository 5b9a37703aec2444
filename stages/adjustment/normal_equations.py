"""Normal equations of a window of frames, in blocks, reduced to the poses; covariance and gain of one point.

Each point is measured in few frames and with no other point. Its block is inverted separately and eliminated from the
equations of the poses (Schur complement; Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.adjustment.residuals import ResidualBlocks, WindowEstimate
from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array, compiled

FLOOR = 1e-9
"""Added to every diagonal: a point or frame without measurements stays where it is."""


class NormalEquations(NamedTuple):
    """Normal equations in blocks: poses (6 n, 6 n), lower half, mixed (p, 3, 6 n), own (p, 3, 3), and right sides.

    `inverse` (p, 3, 3): of `own`. `reduced`, `step`: equations of the poses alone, and their right side or solution.
    `span` (p, 2): first and last frame that measures a point, the held one aside; without any the last is -1.
    """

    poses: Array
    poses_right: Array
    mixed: Array
    own: Array
    own_right: Array
    inverse: Array
    reduced: Array
    step: Array
    span: NDArray[np.int64]

    @staticmethod
    def empty(frames: int, points: int) -> "NormalEquations":
        """Room for so many."""
        size = 6 * frames
        span = np.stack([np.full(points, 1 << 30), np.full(points, -1)], axis=1)
        of_poses, of_points = ((size, size), (size,)), ((points, 3, 3), (points, 3), (points, 3, 3))
        shapes = (*of_poses, (points, 3, size), *of_points, *of_poses)
        return NormalEquations._make([*(np.empty(shape) for shape in shapes), span])


@compiled
def add_blocks(
    normal: NormalEquations, estimate: WindowEstimate, blocks: ResidualBlocks, held: int
) -> None:
    """Add the residual blocks to the normal equations."""
    residuals, frames, mixed, poses = estimate.residuals, blocks.frames, normal.mixed, normal.poses
    for i in range(residuals.shape[0]):
        n, scale = blocks.point[i], blocks.scale[i] * blocks.scale[i]
        by_pose, by_point, span = estimate.by_pose[i], estimate.by_point[i], normal.span[n]
        u, v = residuals[i, 0], residuals[i, 1]
        weight = 1.0 / (1.0 + (u * u + v * v) / scale)
        for k in range(3):
            a, b = weight * by_point[0, k], weight * by_point[1, k]
            normal.own_right[n, k] -= a * u + b * v
            for j in range(3):
                normal.own[n, k, j] += a * by_point[0, j] + b * by_point[1, j]
        for y in range(int(frames[i, 0] == frames[i, 1]), 2):
            f = frames[i, y]
            if f == held:
                continue
            span[0], span[1] = min(span[0], f), max(span[1], f)
            for k in range(6):
                a, b, at = weight * by_pose[0, 6 * y + k], weight * by_pose[1, 6 * y + k], 6 * f + k
                normal.poses_right[at] -= a * u + b * v
                for j in range(3):
                    mixed[n, j, at] += a * by_point[0, j] + b * by_point[1, j]
                for z in range(y + 1):
                    g = frames[i, z]
                    if g != held and (g < f or z == y):
                        for j in range(6):
                            part = a * by_pose[0, 6 * z + j] + b * by_pose[1, 6 * z + j]
                            poses[at, 6 * g + j] += part


@compiled
def reduce_points(normal: NormalEquations, damping: float) -> None:
    """Write the Schur complement of the points (lower half), its right side, and the points' inverses into `normal`."""
    reduced, right, mixed = normal.reduced, normal.step, normal.mixed
    for k in range(right.shape[0]):
        right[k] = normal.poses_right[k]
        for j in range(k + 1):
            reduced[k, j] = normal.poses[k, j]
        reduced[k, k] += damping * normal.poses[k, k] + FLOOR
    for n in range(mixed.shape[0]):
        first, after = 6 * normal.span[n, 0], 6 * normal.span[n, 1] + 6
        inverse = normal.inverse[n]
        invert_symmetric(normal.own[n], damping, FLOOR, inverse)
        for row in range(first, after):
            a, b, c = mixed[n, 0, row], mixed[n, 1, row], mixed[n, 2, row]
            x = a * inverse[0, 0] + b * inverse[1, 0] + c * inverse[2, 0]
            y = a * inverse[0, 1] + b * inverse[1, 1] + c * inverse[2, 1]
            z = a * inverse[0, 2] + b * inverse[1, 2] + c * inverse[2, 2]
            own = normal.own_right[n]
            right[row] -= x * own[0] + y * own[1] + z * own[2]
            for j in range(first, row + 1):
                reduced[row, j] -= x * mixed[n, 0, j] + y * mixed[n, 1, j] + z * mixed[n, 2, j]


def uncertainty(
    normal: NormalEquations, estimate: WindowEstimate, blocks: ResidualBlocks
) -> tuple[Array, Array]:
    """Covariance (3, 3) of the coordinates of the first point, and their gain (m, 2, 3).

    From the inverse of the normal equations at the estimate; the gain is the derivative by the targets of the blocks.
    Both are nan where there is no inverse.
    """
    reduce_points(normal, 0.0)
    own = normal.inverse[0]
    reach = own @ normal.mixed[0]  # change of the right side by the point, negative
    try:
        half = np.linalg.inv(np.linalg.cholesky(normal.reduced))
    except np.linalg.LinAlgError:
        return np.full((3, 3), np.nan), np.full((len(blocks.point), 2, 3), np.nan)
    # covariance of the poses with the point
    spread = half.T @ (half @ reach.T)
    # change (p, 3, 3) of it by each point's right side
    back = normal.inverse @ np.tensordot(normal.mixed, spread, 1)
    back[0] += own
    weight = 1 / ((1 + (estimate.residuals**2).sum(axis=1) / blocks.scale**2) * blocks.sigma)
    by_frame = spread.reshape(-1, 6, 3)[blocks.frames].reshape(-1, 12, 3)
    gain = estimate.by_point @ back[blocks.point] - estimate.by_pose @ by_frame
    return reach @ spread + own, weight[:, None, None] * gain
