"""Bundle adjustment of a window of frames (report chapter 8, for more than two pictures).

Unknown are the poses of all frames but one, which is held (the gauge), and the points. Known are the rows of points in
the pictures (`numerics.window_rows`) and what is known of each step beforehand, its length above all: that gives the
scale. The cost is the sum of squares in sigmas, robust for rows (Cauchy) as in `numerics.adjust`. Levenberg-Marquardt,
points eliminated by the Schur complement: every point is a block of its own, so an iteration costs as much as there are
rows, and one Cholesky solution for the poses.

It ends when an iteration wins less than a share `SETTLED` of the cost, or after `iterations`, which bounds the time.
With a quadratic cost seven do. Weights of a robust cost change with the residuals, so its convergence is linear: each
iteration leaves about six tenths of what the cost is above its minimum. From chained two-view motion, with weights that
fall from one sigma, 15 leave a place .003 of its sigma off the minimum (median; .16 in 95 %).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.stages.geometry import cholesky_solve, rotation_from_vector
from wayside.stages.kernels import Array, compiled, require_array
from wayside.stages.mapping.normal_equations import (
    NormalEquations,
    linearise,
    point_spans,
    point_uncertainty,
    reduce_points,
)
from wayside.stages.mapping.residuals import (
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    block_residuals,
    constraint_residuals,
)

SETTLED = 1e-9
TRIES = 8


class WindowAdjustment(NamedTuple):
    """Result of `adjust_window`.

    rotations (n, 3, 3), centres (n, 3): poses, that of the held frame as given; points (p, 3): coordinates in their
    charts; squares (m,): of each row, in sigmas; cost, iterations, history (iterations + 1,) of the cost. Of the point
    asked for: place (3,) in the axes of the poses, covariance (3, 3) by the inverse of the normal equations, and gain
    (m, 2, 3): how an error of a row, in units of its rays, moves it.
    """

    rotations: Array
    centres: Array
    points: Array
    squares: Array
    cost: float
    iterations: int
    history: Array
    place: Array
    covariance: Array
    gain: Array


def adjust_window(
    rotations: Array,
    centres: Array,
    held: int,
    points: Array,
    anchors: NDArray[np.int64],
    rows: ResidualBlocks,
    links: StepConstraints,
    *,
    wanted: int = 0,
    iterations: int = 15,
) -> WindowAdjustment:
    """Adjust poses and points together.

    Parameters
    ----------
    rotations, centres
        Poses to start from: world from camera (n, 3, 3), centres (n, 3) in metres.
    held
        The frame whose pose is kept: the axes everything is relative to.
    points
        Coordinates to start from (p, 3): ray (x/z, y/z) in the anchor's frame and one over the depth there.
    anchors
        A frame of each point, from the start pose of which its coordinates count, (p,).
    rows
        Residuals of the points in the pictures.
    links
        What is known of the steps.
    wanted
        The point whose place, covariance and gain are asked for.
    iterations
        At most this many.

    Returns
    -------
    Adjusted
        covariance and gain are nan where the normal equations cannot be solved, very large where nothing holds the
        point.
    """
    n, p = len(rotations), len(points)
    require_array(rotations, "rotations", np.float64, (n, 3, 3))
    require_array(centres, "centres", np.float64, (n, 3))
    require_array(points, "points", np.float64, (p, 3))
    require_array(anchors, "anchors", np.int64, (p,))
    if not (0 <= held < n and 0 <= wanted < p and ((anchors >= 0) & (anchors < n)).all()):
        raise ValueError(
            f"wanted held and anchors below {n} frames and wanted below {p} points, "
            f"found {held}, {anchors.min(initial=0)} to {anchors.max(initial=0)}, {wanted}"
        )
    rows, links = rows.checked(n, p), links.checked(n)
    charts = PointAnchors(rotations[anchors].copy(), centres[anchors].copy())
    turned, moved, solid = rotations.copy(), centres.copy(), points.copy()
    m = len(rows.point)
    gaps, history = np.empty((m, 2)), np.empty(iterations + 1)
    covariance, gain = np.full((3, 3), np.nan), np.full((m, 2, 3), np.nan)
    done = _solve(
        turned, moved, held, charts, solid, rows, links, wanted, iterations, gaps, history,
        covariance, gain,
    )  # fmt: skip
    a, b, rho = solid[wanted]
    ray = charts.rotation[wanted] @ np.array([a, b, 1.0])
    to_place = np.column_stack([charts.rotation[wanted][:, :2], -ray / rho]) / rho
    return WindowAdjustment(
        turned,
        moved,
        solid,
        (gaps**2).sum(axis=1),
        float(history[done]),
        int(done),
        history[: done + 1],
        charts.centre[wanted] + ray / rho,
        to_place @ covariance @ to_place.T,
        gain @ to_place.T,
    )


@compiled
def _total(gaps: Array, scale: Array, known: Array) -> float:
    total = 0.0
    for i in range(gaps.shape[0]):
        square = gaps[i, 0] ** 2 + gaps[i, 1] ** 2
        total += scale[i] ** 2 * np.log1p(square / scale[i] ** 2)
    for i in range(known.shape[0]):
        for k in range(6):
            total += known[i, k] ** 2
    return total


@compiled
def _take_step(
    rotations: Array, centres: Array, points: Array, normal: NormalEquations, step: Array,
    out_r: Array, out_c: Array, out_p: Array,
) -> None:  # fmt: skip
    for f in range(rotations.shape[0]):
        turn = rotation_from_vector(step[6 * f : 6 * f + 3])
        for i in range(3):
            out_c[f, i] = centres[f, i] + step[6 * f + 3 + i]
            for j in range(3):
                out_r[f, i, j] = 0.0
                for k in range(3):
                    out_r[f, i, j] += turn[i, k] * rotations[f, k, j]
    rest = np.empty(3)
    for n in range(points.shape[0]):
        for k in range(3):
            out_p[n, k] = points[n, k]
        if normal.span[n, 1] < 0:
            continue
        for k in range(3):
            rest[k] = normal.own_right[n, k]
            for f in range(normal.span[n, 0], normal.span[n, 1] + 1):
                for j in range(6):
                    rest[k] -= normal.mixed[n, f, j, k] * step[6 * f + j]
        for k in range(3):
            for j in range(3):
                out_p[n, k] += normal.inverse[n, k, j] * rest[j]


@compiled
def _solve(
    rotations: Array,
    centres: Array,
    held: int,
    charts: PointAnchors,
    points: Array,
    rows: ResidualBlocks,
    links: StepConstraints,
    wanted: int,
    iterations: int,
    gaps: Array,
    history: Array,
    covariance: Array,
    gain: Array,
) -> int:
    n, p, m, count = len(rotations), len(points), len(rows.point), len(links.frames)
    span = np.empty((p, 2), np.int64)
    normal = NormalEquations(
        np.empty((6 * n, 6 * n)), np.empty(6 * n), np.empty((p, n, 6, 3)), np.empty((p, 3, 3)),
        np.empty((p, 3)), np.empty((p, 3, 3)), span,
    )  # fmt: skip
    reduced, step = np.empty((6 * n, 6 * n)), np.empty(6 * n)
    trial_r, trial_c, trial_p = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((p, 3))
    known, trial_gaps, trial_known = np.empty((count, 6)), np.empty((m, 2)), np.empty((count, 6))
    point_spans(rows, span)
    block_residuals(rotations, centres, charts, points, rows, gaps)
    constraint_residuals(rotations, centres, links, known)
    history[0] = cost = _total(gaps, rows.scale, known)
    damping, done, settled = 1e-4, 0, False
    while True:
        linearise(rotations, centres, held, charts, points, rows, links, gaps, known, normal)
        if settled or done >= iterations:
            break
        done += 1
        settled, better = True, cost
        for _ in range(TRIES):
            reduce_points(normal, damping, reduced, step)
            if cholesky_solve(reduced, step, 6 * n):
                _take_step(rotations, centres, points, normal, step, trial_r, trial_c, trial_p)
                block_residuals(trial_r, trial_c, charts, trial_p, rows, trial_gaps)
                constraint_residuals(trial_r, trial_c, links, trial_known)
                better = _total(trial_gaps, rows.scale, trial_known)
                if better < cost:
                    settled = cost - better < SETTLED * cost
                    rotations[:], centres[:], points[:] = trial_r, trial_c, trial_p
                    gaps[:], known[:] = trial_gaps, trial_known
                    cost = better
                    break
            damping *= 10.0
        history[done] = cost
        damping = max(1e-10, damping * 0.1)
    point_uncertainty(rotations, centres, held, charts, points, rows, wanted, gaps, normal, reduced, step,
                 covariance, gain)  # fmt: skip
    return done
