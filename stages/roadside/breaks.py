"""Where the ground along a road changes its slope: edge of the shoulder, ditch, and the slopes between."""

import math

import numpy as np

from wayside.schemas.roadside import Roadside
from wayside.stages.kernels import Array

_STEP_M = 0.25
_SHOULDERS_M = np.arange(2.0, 10.0, _STEP_M)
"""Where the first break may lie."""
_LEAST_APART_M = 1.5
"""Between both breaks: a slope needs two strips."""
_LEAST_GAIN = 16.0
"""Fall of chi-square that a break must bring: 4 standard deviations."""
_LEAST_CHANGE = 0.06
"""Change of slope at a break, at least."""


def breaks_of(distance: Array, height: Array, sigma: Array) -> Roadside:
    """One side of the road with the breaks of the ground alone, by a polyline of up to three pieces.

    distance, height and sigma (n,), metres; heights that are nan are left out.
    """
    known = np.isfinite(height)
    far = distance[known].max(initial=0.0)
    if known.sum() < 6 or far < _SHOULDERS_M[0] + 2 * _LEAST_APART_M:
        return Roadside()
    at, value, weight = distance[known], height[known], 1 / sigma[known]
    end = far - _LEAST_APART_M
    first = _SHOULDERS_M[_SHOULDERS_M < end]
    pairs = [(a, b) for a in first for b in np.arange(a + _LEAST_APART_M, end + 0.01, _STEP_M)]
    least, found, fit = np.inf, np.zeros(0), np.zeros(0)
    for breaks in (np.zeros((1, 0)), first[:, None], np.array(pairs).reshape(-1, 2)):
        squares, fits = _fitted(at, value, weight, breaks)
        if least - squares.min(initial=np.inf) < _LEAST_GAIN:
            break
        best = int(squares.argmin())
        least, found, fit = squares[best], breaks[best], fits[best]
    slope = np.cumsum(fit[1:])
    if len(found) < 2:
        if not len(found) or abs(fit[2]) < _LEAST_CHANGE:
            return Roadside()
        return Roadside(shoulder_m=float(found[0]), fore_slope=float(slope[1]))
    shoulder, ditch = found.tolist()
    bottom = float(fit[0] + fit[1] * ditch + fit[2] * (ditch - shoulder))
    return Roadside(math.nan, math.nan, shoulder, ditch, bottom, float(slope[1]), float(slope[2]))


def _fitted(at: Array, value: Array, weight: Array, breaks: Array) -> tuple[Array, Array]:
    """Chi-square (k,) and coefficients (k, 2 + b) of polylines with b breaks each, (k, b): height, slope, changes."""
    hinges = np.maximum(at[None, :, None] - breaks[:, None, :], 0.0)
    straight = np.broadcast_to(np.stack([np.ones_like(at), at], axis=-1), (len(breaks), len(at), 2))
    design = np.concatenate([straight, hinges], axis=-1) * weight[:, None]
    target = value * weight
    normal = np.swapaxes(design, 1, 2) @ design + 1e-9 * np.eye(design.shape[-1])
    found = np.linalg.solve(normal, np.swapaxes(design, 1, 2) @ target[:, None])[..., 0]
    left = target - (design @ found[..., None])[..., 0]
    return np.asarray((left**2).sum(axis=1), np.float64), np.asarray(found, np.float64)
