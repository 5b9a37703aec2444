"""Size and facing of a flat panel from how its width and height change from view to view.

A panel rotated about the vertical covers a width that changes with the bearing by cos(angle) + sin(angle)
tan(bearing). The change is small: it shows in widths of a tenth of a per cent. What is not observable stays at the
prior.
"""

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array, compiled
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
    away = plane.point - centres
    place = np.stack([away @ plane.right, away @ plane.ahead], axis=1)
    priors, covariance = (cauchy, facing_sigma, aspect or 0.0, aspect_sigma), np.empty((3, 3))
    _gauss_newton(place, np.log(sizes), np.asarray(sigmas, np.float64), priors, x, covariance)
    return Facing(float(x[0]), x[1:].copy(), covariance)


@compiled
def _gauss_newton(
    place: Array,
    observed: Array,
    sigmas: Array,
    priors: tuple[float, float, float, float],
    x: Array,
    covariance: Array,
) -> None:
    # Moves angle and log sizes x (3,). `place` (v, 2): of the panel, to the right of a camera and ahead of it.
    cauchy, facing_sigma, aspect, aspect_sigma = priors
    normal, right, step, by = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for _ in range(FACING_ITERATIONS):
        normal[:] = right[:] = 0.0
        normal[0, 0], right[0] = 1 / facing_sigma**2, -x[0] / facing_sigma**2
        if aspect > 0:
            off = (np.log(aspect) - x[1] + x[2]) / aspect_sigma**2
            right[1], right[2] = off, -off
            normal[1, 1] = normal[2, 2] = 1 / aspect_sigma**2
            normal[1, 2] = normal[2, 1] = -normal[1, 1]
        for v in range(place.shape[0]):
            for side in range(2):
                by[:], residual = 0.0, observed[v, side] - x[1 + side]
                by[1 + side] = 1.0
                if side == 0:
                    # the end that is turned away covers less of the plane than the other one
                    beside, ahead, half = place[v, 0], place[v, 1], np.exp(x[1]) / 2
                    c, s = half * np.cos(x[0]), half * np.sin(x[0])
                    wide, room = beside * s + c * ahead, ahead * ahead - s * s
                    residual = observed[v, 0] - np.log(2 * ahead * wide / room)
                    by[0] = (beside * c - s * ahead) / wide + 2 * s * c / room
                off = residual / sigmas[v, side]
                weight = 1 / (1 + (off / cauchy) ** 2) / sigmas[v, side] ** 2
                for k in range(3):
                    right[k] += weight * residual * by[k]
                    for m in range(3):
                        normal[k, m] += weight * by[k] * by[m]
        invert_symmetric(normal, 0.0, 0.0, covariance)
        for k in range(3):
            step[k] = (covariance[k] * right).sum()
            x[k] += min(max(step[k], -FACING_STEP), FACING_STEP)
        if np.abs(step).max() < FACING_CONVERGED:
            break
