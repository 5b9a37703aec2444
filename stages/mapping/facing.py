"""Size and facing of a flat panel from how its width and height change from view to view.

A panel that is turned shows wider as the bearing to it grows, or narrower: by cos(turn) + sin(turn) tan(bearing). The
change is small, so widths count from a tenth of a per cent, and what is not observable stays at the prior.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wayside.schemas.settings import AdjustmentSettings
from wayside.stages.kernels import Array

ITERATIONS = 6
_TINY = 1e-4


class Plane(NamedTuple):
    """Across the path at a panel: through point (3,), axes right, down and ahead (3,) of the world."""

    point: Array
    right: Array
    down: Array
    ahead: Array

    def meet(self, centre: Array, points: Array) -> Array:
        """Where lines from a camera centre (3,) through points (n, 3) meet the plane: right and down (n, 2), metres."""
        away = points - centre
        share = ((self.point - centre) @ self.ahead) / (away @ self.ahead)
        gap = centre + share[:, None] * away - self.point
        return np.column_stack([gap @ self.right, gap @ self.down])

    def points(self, places: Array) -> Array:
        """Points (n, 3) of the world at places (n, 2) of the plane."""
        return np.asarray(
            self.point + places[:, :1] * self.right + places[:, 1:] * self.down, np.float64
        )


class Facing(NamedTuple):
    """Turn (rad, clockwise from above), logarithms of width and height (metres); covariance (3, 3) in that order."""

    turn: float
    log_size: Array
    covariance: Array


def solve_facing(
    plane: Plane,
    centres: Array,
    sizes: Array,
    sigmas: Array,
    *,
    turn_sigma: float,
    aspect: tuple[float, float] | None = None,
) -> Facing:
    """Least squares (Cauchy weights) of turn, width and height on the sizes that the views show.

    Parameters
    ----------
    plane
        Through the panel's centre, across the path.
    centres
        Camera centres (v, 3).
    sizes
        Width and height (v, 2) that the panel covers on the plane, metres, seen from each camera.
    sigmas
        Their standard deviations relative to the size, (v, 2).
    turn_sigma
        Scatter of the turn about 0, rad: the prior.
    aspect
        Width over height where the shape has one proportion, and the relative scatter of that.
    """
    x = np.array([0.0, *np.log(np.median(sizes, axis=0))])
    seen = np.log(sizes)
    covariance: Array = np.zeros((3, 3))
    for _ in range(ITERATIONS):
        here = _log_sizes(plane, centres, x)
        slope = (_log_sizes(plane, centres, x + np.array([_TINY, 0, 0])) - here) / _TINY
        gap = (seen - here) / sigmas
        weight = 1 / (1 + (gap / AdjustmentSettings().cauchy_sigmas) ** 2) / sigmas**2
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for side in (0, 1):
            unit = np.zeros((len(sizes), 3))
            unit[:, 0] = slope[:, side]
            unit[:, 1 + side] = 1.0
            normal += unit.T @ (unit * weight[:, side, None])
            right += unit.T @ (weight[:, side] * (seen - here)[:, side])
        normal[0, 0] += 1 / turn_sigma**2
        right[0] -= x[0] / turn_sigma**2
        if aspect is not None:
            by = np.array([0.0, 1.0, -1.0])
            normal += np.outer(by, by) / aspect[1] ** 2
            right += by * (np.log(aspect[0]) - by @ x) / aspect[1] ** 2
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
        change = covariance @ right
        x = x + np.clip(change, -0.3, 0.3)
        if np.abs(change).max() < 1e-6:
            break
    return Facing(float(x[0]), x[1:].copy(), covariance)


def _log_sizes(plane: Plane, centres: Array, x: Array) -> Array:
    """Logarithms (v, 2) of width and height that a panel of turn and log size x covers on the plane."""
    half = np.exp(x[1:]) / 2
    across = (np.cos(x[0]) * plane.right - np.sin(x[0]) * plane.ahead) * half[0]
    below = plane.down * half[1]
    ends = plane.point + np.array([-across, across, -below, below])
    met = np.array([plane.meet(centre, ends) for centre in centres])
    covered = np.column_stack([met[:, 1, 0] - met[:, 0, 0], met[:, 3, 1] - met[:, 2, 1]])
    return np.asarray(np.log(covered), np.float64)
