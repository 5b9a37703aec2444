"""Size and facing of a flat panel from how its width and height change from view to view.

A panel rotated about the vertical covers a width that changes with the bearing by cos(angle) + sin(angle)
tan(bearing). The change is small: it shows in widths of a tenth of a per cent. What is not observable stays at the
prior.
"""

from typing import NamedTuple

import numpy as np

from wayside.stages.geometry import invert_symmetric
from wayside.stages.kernels import Array
from wayside.stages.panel.rectification import PanelPlane

FACING_SIGMA = float(np.radians(8.0))
"""Scatter of the facing of panels along a road, rad (prior)."""
ASPECT_SIGMA = 0.02
"""Relative scatter of the proportion of shapes that have one, outline included."""
FACING_ITERATIONS = 6
"""Gauss-Newton steps of size and facing at most."""
FACING_CONVERGED = 1e-3
"""Shorter steps end them, rad (of the sizes: relative): within 0.02 standard deviations."""
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
    observed = np.log(sizes)
    x = np.array([0.0, *np.sort(observed, axis=0)[len(observed) // 2]])
    beside, ahead = ((plane.point - centres) @ axis for axis in (plane.right, plane.ahead))
    jacobian = np.zeros((len(sizes), 2, 3))
    jacobian[:, 0, 1] = jacobian[:, 1, 2] = 1.0
    prior, pull = np.diag([1 / facing_sigma**2, 0.0, 0.0]), np.zeros(3)
    if aspect is not None:
        by = np.array([0.0, 1.0, -1.0]) / aspect_sigma
        prior, pull = prior + np.outer(by, by), by * np.log(aspect) / aspect_sigma
    covariance: Array = np.zeros((3, 3))
    for _ in range(FACING_ITERATIONS):
        c, s = np.exp(x[1]) / 2 * np.array([np.cos(x[0]), np.sin(x[0])])
        # the end that is turned away covers less of the plane than the other one
        wide, room = beside * s + ahead * c, ahead**2 - s**2
        jacobian[:, 0, 0] = (beside * c - ahead * s) / wide + 2 * s * c / room
        residual = observed - x[1:]
        residual[:, 0] = observed[:, 0] - np.log(2 * ahead * wide / room)
        weight = 1 / (1 + (residual / sigmas / cauchy) ** 2) / sigmas**2
        weighted = (jacobian * weight[..., None]).reshape(-1, 3).T
        invert_symmetric(weighted @ jacobian.reshape(-1, 3) + prior, 0.0, 0.0, covariance)
        step = covariance @ (weighted @ residual.ravel() + pull - prior @ x)
        x += np.minimum(np.maximum(step, -FACING_STEP), FACING_STEP)
        if np.abs(step).max() < FACING_CONVERGED:
            break
    return Facing(float(x[0]), x[1:].copy(), covariance)
