"""Size and facing of a flat panel from how its width and height change from view to view.

A panel rotated about the vertical covers a width that changes with the bearing by cos(angle) + sin(angle)
tan(bearing). The change is small: it shows in widths of a tenth of a per cent. What is not observable stays at the
prior.
"""

from typing import NamedTuple

import numpy as np

from wayside.stages.kernels import Array
from wayside.stages.panel.rectification import PanelPlane

FACING_SIGMA = float(np.radians(8.0))
"""Scatter of the facing of panels along a road, rad (prior)."""
ASPECT_SIGMA = 0.02
"""Relative scatter of the proportion of shapes that have one, outline included."""
FACING_ITERATIONS = 6
"""Gauss-Newton steps of size and facing at most."""
FACING_CONVERGED = 1e-6
"""Shorter steps end them, rad (of the sizes: relative)."""
FACING_STEP = 0.3
"""Largest change in one of these steps, rad (of the sizes: relative)."""
_TINY = 1e-4
"""Step of forward differences, radians."""


class Facing(NamedTuple):
    """Angle (rad, clockwise from above), logarithms of width and height (metres); covariance (3, 3) in that order."""

    angle: float
    log_size: Array
    covariance: Array


def solve_facing(
    plane: PanelPlane,
    centres: Array,
    sizes: Array,
    sigmas: Array,
    *,
    cauchy: float,
    aspect: float | None,
    facing_sigma: float = FACING_SIGMA,
    aspect_sigma: float = ASPECT_SIGMA,
) -> Facing:
    """Least squares (Cauchy weights) of angle, width and height on the sizes that the views show.

    `plane`: through the panel's centre, across the path. `centres` (v, 3): of the cameras. `sizes` (v, 2): width and
    height that the panel covers on the plane, metres, seen from each camera. `sigmas` (v, 2): their relative standard
    deviations. `cauchy`: scale of the Cauchy weights, standard deviations. `aspect`: width over height if the shape has
    one proportion. `facing_sigma`, `aspect_sigma`: prior scatter of the angle, rad, and of the proportion, relative.
    """
    x = np.array([0.0, *np.log(np.median(sizes, axis=0))])
    observed = np.log(sizes)
    covariance: Array = np.zeros((3, 3))
    for _ in range(FACING_ITERATIONS):
        predicted = _log_sizes(plane, centres, x)
        derivative = (_log_sizes(plane, centres, x + np.array([_TINY, 0, 0])) - predicted) / _TINY
        weight = 1 / (1 + ((observed - predicted) / sigmas / cauchy) ** 2) / sigmas**2
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for side in (0, 1):
            jacobian = np.zeros((len(sizes), 3))
            jacobian[:, 0] = derivative[:, side]
            jacobian[:, 1 + side] = 1.0
            normal += jacobian.T @ (jacobian * weight[:, side, None])
            right += jacobian.T @ (weight[:, side] * (observed - predicted)[:, side])
        normal[0, 0] += 1 / facing_sigma**2
        right[0] -= x[0] / facing_sigma**2
        if aspect is not None:
            by = np.array([0.0, 1.0, -1.0])
            normal += np.outer(by, by) / aspect_sigma**2
            right += by * (np.log(aspect) - by @ x) / aspect_sigma**2
        covariance = np.asarray(np.linalg.inv(normal), np.float64)
        step = covariance @ right
        x = x + np.clip(step, -FACING_STEP, FACING_STEP)
        if np.abs(step).max() < FACING_CONVERGED:
            break
    return Facing(float(x[0]), x[1:].copy(), covariance)


def _log_sizes(plane: PanelPlane, centres: Array, x: Array) -> Array:
    """Logarithms (v, 2) of width and height that a panel of angle and log size x covers on the plane."""
    half = np.exp(x[1:]) / 2
    across = (np.cos(x[0]) * plane.right - np.sin(x[0]) * plane.ahead) * half[0]
    below = plane.down * half[1]
    ends = plane.point + np.array([-across, across, -below, below])
    met = plane.meet(centres[:, None], ends)
    covered = np.column_stack([met[:, 1, 0] - met[:, 0, 0], met[:, 3, 1] - met[:, 2, 1]])
    return np.asarray(np.log(covered), np.float64)
