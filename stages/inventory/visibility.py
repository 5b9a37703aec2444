"""Whether a panel would have shown in the images of a drive."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wayside.schemas.frame import Camera

NEAREST_M = 1.0
"""A place nearer to the camera, along its axis, is not in view: no panel is measured from so near."""
OBLIQUE_DEG = 60.0
"""A face seen at a larger angle from its normal is not in view, as in the truth of rendered drives."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_FORBIDDEN = 1e9


@dataclass(frozen=True, slots=True)
class PanelPlaces:
    """Where panels are: n rows, metres and radians, nan where unknown.

    `position` (n, 3): east, north, up. `bearing_rad` (n,): compass direction that the face looks in. `size_m` (n, 2):
    width and height.
    """

    position: Floats
    bearing_rad: Floats
    size_m: Floats


@dataclass(frozen=True, slots=True)
class PanelViews:
    """What k images show of n places.

    `height` (n, k): of the panel in each, pixels, 0 where it does not show. `box` (n, k, 4): where it would, pixels.
    """

    height: Floats
    box: Floats


def views_of(
    places: PanelPlaces, centre: Floats, rotation: Floats, camera: Camera, smallest_px: float
) -> PanelViews:
    """Images in which a panel would show whole, at least so high, and from the front.

    Objects between the camera and the place are not considered (see `measure_occlusion`), nor is the distortion of the
    lens.

    Parameters
    ----------
    places
        The panels.
    centre, rotation
        Cameras: (k, 3) east, north, up, metres, and (k, 3, 3) camera to these axes.
    camera
        Calibration.
    smallest_px
        Height of the face.
    """
    n, k = len(places.position), len(centre)
    if not n or not k:
        return PanelViews(np.zeros((n, k)), np.zeros((n, k, 4)))
    ray = places.position[:, None] - centre[None]
    right, down, ahead = np.moveaxis(np.einsum("nki,kij->nkj", ray, rotation), 2, 0)
    far = np.maximum(ahead, NEAREST_M)
    u, v = camera.cx + camera.fx * right / far, camera.cy + camera.fy * down / far
    wide, high = camera.fx * places.size_m[:, :1] / far, camera.fy * places.size_m[:, 1:] / far
    box = np.stack([u - wide / 2, v - high / 2, u + wide / 2, v + high / 2], axis=2)
    whole = (box[..., 0] >= 0) & (box[..., 1] >= 0)
    whole &= (box[..., 2] <= camera.width) & (box[..., 3] <= camera.height)
    normal = np.stack([np.sin(places.bearing_rad), np.cos(places.bearing_rad)], axis=1)
    facing = -np.einsum("nki,ni->nk", ray[..., :2], normal) / np.linalg.norm(ray[..., :2], axis=2)
    turned = facing < cos(radians(OBLIQUE_DEG))  # false where the bearing is unknown
    shown = (ahead > NEAREST_M) & whole & (high >= smallest_px) & ~turned
    return PanelViews(np.where(shown, high, 0.0), box)


def match_moved(pairs: Ints, distance_m: Floats) -> Ints:
    """Which of the pairs (m, 2) hold, one to one: as many as can, then of least total distance.

    Parameters
    ----------
    pairs
        Numbers of what is gone and of what is new.
    distance_m
        (m,) between them.
    """
    if not len(pairs):
        return np.zeros(0, np.int64)
    gone, new = (np.unique(side, return_inverse=True)[1].ravel() for side in pairs.T)
    count = int(gone.max()) + 1
    size = count + int(new.max()) + 1
    graph = coo_array((np.ones(len(pairs), bool), (gone, count + new)), shape=(size, size))
    part = connected_components(graph, directed=False)[1][gone]
    order = np.argsort(part, kind="stable")
    kept: list[int] = []
    for rows in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        a, b = (np.unique(side[rows], return_inverse=True)[1].ravel() for side in (gone, new))
        cost = np.full((int(a.max()) + 1, int(b.max()) + 1), _FORBIDDEN)
        cost[a, b] = distance_m[rows]
        number = np.full(cost.shape, -1, np.int64)
        number[a, b] = rows
        kept += [k for k in number[linear_sum_assignment(cost)].tolist() if k >= 0]
    return np.array(sorted(kept), np.int64)
