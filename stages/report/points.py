"""SIFT points of a segment in its two nearest views, triangulated (report chapters 5, 7 and 8)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.landmarks import Crop, Landmark, TrackedFrame
from wayside.stages.geometry import pair_residual, points_of_second, to_rays
from wayside.stages.mapping import STEP_COVARIANCE, point_covariance

# Set on learning drives, where no other reason is given.
MOST_POINTS, CONTRAST, EDGE = 60, 0.03, 10.0
"""Of SIFT: strongest points of a view, least contrast, and largest ratio of curvatures."""
RATIO = 0.8
"""Largest distance of a descriptor from its nearest, by that from the nearest elsewhere (Lowe 2004)."""
SAME_PX = 2.0
"""Points nearer than this are at one place: SIFT describes a place in several directions."""
LARGEST_E = 4.0
"""Largest residual of a point (eq. 7.5), px squared: one pixel in each of the four coordinates."""
POINT_PX = 0.25
"""Scatter of a point a coordinate, px."""
AGREE_SIGMAS = 2.5
"""Depths that agree differ by less, standard deviations of one of them."""
WRONG = 0.3
"""Share of matches that are wrong."""
LOG_DEPTHS = 4.1
"""Logarithm of the ratio of the largest and the least depth of a wrong match: 5 to 300 m."""
LEAST_SIGMA = 0.003
"""Least scatter of a depth about that of its panel, by the depth: panels do not face the camera exactly."""
LEAST_EVIDENCE = 1.5
"""Least mean evidence of the points of a segment that stands."""
CENTRE_SIGMA = 0.06
"""Error of the centre of a segment as that of its panel, by its size."""
SIZE_SIGMA = 0.15
"""Error of its size, by the size."""


class PointMatches(NamedTuple):
    """k points that two views show: point (k, 3) in the axes of the second camera, residual (eq. 7.5) (k,), px^2."""

    point: NDArray[np.float64]
    residual: NDArray[np.float64]


class DepthFit(NamedTuple):
    """The depth that most of k points agree on, with its standard deviation, m; which agree, and the evidence.

    `evidence` (k,): log-likelihood ratio of each point, of that depth against any depth.
    """

    depth: float
    sigma: float
    agree: NDArray[np.bool_]
    evidence: NDArray[np.float64]


def match_points(first: Crop, second: Crop, sift: cv2.SIFT) -> PointMatches:
    """SIFT points of two views that are each other's nearest, on each other's epipolar lines, ahead of both cameras."""
    (one, own), (two, other) = (sift.detectAndCompute(crop.grey, None) for crop in (first, second))
    if own is None or other is None:
        return PointMatches(np.zeros((0, 3)), np.zeros(0))
    places = np.asarray(cv2.KeyPoint.convert(two), np.float64)
    start = to_rays(first.camera, np.asarray(cv2.KeyPoint.convert(one)) + first.corner)
    end = to_rays(second.camera, places + second.corner)
    moved = second.motion.pose.relative_to(first.motion.pose)
    shape = len(start), len(end)
    i, j = (numbers.ravel() for numbers in np.indices(shape))
    pair = start[i], end[j], moved.rotation, moved.centre
    e = pair_residual(*pair, (second.camera.fx, second.camera.fy)).reshape(shape)
    point = points_of_second(*pair).reshape(*shape, 3)
    apart = np.linalg.norm(own[:, None] - other[None], axis=2)
    apart[~((e < LARGEST_E) & np.isfinite(point[:, :, 2]))] = np.inf
    nearest, rows = apart.argmin(axis=1), np.arange(len(start))
    elsewhere = np.linalg.norm(places[:, None] - places[None], axis=2) > SAME_PX
    others = np.where(elsewhere[nearest], apart, np.inf).min(axis=1)
    best = apart[rows, nearest]
    mutual = np.isfinite(best) & (apart.argmin(axis=0)[nearest] == rows)
    rows = rows[mutual & (best < RATIO * others)]
    return PointMatches(point[rows, nearest[rows]], e[rows, nearest[rows]])


def depth_sigma(
    point: NDArray[np.float64], travel: NDArray[np.float64], focal_px: float
) -> NDArray[np.float64]:
    """Standard deviation (k,) of the depth of points (k, 3), metres, where a coordinate scatters by one pixel.

    Two views, `travel` (3,) metres apart in the axes of the nearer one: z z' sqrt(z^2 + z'^2) / (f R b), with the depth
    z' in the farther view and the distance R from the line of travel.
    """
    z = point[:, 2]
    before = z + travel[2]
    aside = np.linalg.norm(point[:, :2] - z[:, None] * (travel[:2] / travel[2]), axis=1)
    length = float(np.linalg.norm(travel))
    return z * before * np.hypot(z, before) / (focal_px * length * np.maximum(aside, 1e-3))


def fit_depth(depth: NDArray[np.float64], sigma: NDArray[np.float64]) -> DepthFit | None:
    """The depth that most of some depths (k,) agree on, and how well; None without any."""
    if not len(depth):
        return None
    near = np.abs(depth[:, None] - depth) <= AGREE_SIGMAS * sigma
    agree = near[np.lexsort((sigma, -near.sum(axis=1)))[0]]
    weight = agree / sigma**2
    mean = float(weight @ depth / weight.sum())
    chi2 = float(weight @ (depth - mean) ** 2) / max(1, agree.sum() - 1)
    relative = np.maximum(sigma / depth, LEAST_SIGMA)
    density = np.exp(-0.5 * (np.log(depth / mean) / relative) ** 2) / (relative * np.sqrt(2 * np.pi))
    evidence = np.log(WRONG + (1 - WRONG) * LOG_DEPTHS * density)
    spread = float(np.sqrt(max(1.0, chi2) / weight.sum()))
    return DepthFit(mean, spread, agree, evidence)


def triangulate_points(tracked: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Place accepted landmarks by the SIFT points of their two nearest views; refuse those that scatter (`residual`).

    The points of a face are on a plane that stands, and their midpoints (eq. 7.4) agree on one depth; those of leaves
    and of what passes behind them do not. A landmark without pixels stays as it is.
    """
    sift = cv2.SIFT.create(MOST_POINTS, contrastThreshold=CONTRAST, edgeThreshold=EDGE)
    for frame in tracked:
        landmarks = (
            _placed(one, sift) if one.verdict == "sign" and len(one.crops) > 1 else one
            for one in frame.landmarks
        )
        yield replace(frame, landmarks=tuple(replace(one, crops=()) for one in landmarks))


def _placed(one: Landmark, sift: cv2.SIFT) -> Landmark:
    first, second = one.crops
    found = match_points(first, second, sift)
    pose, motion = second.motion.pose, second.motion
    focal = (second.camera.fx + second.camera.fy) / 2
    travel = -pose.to_camera(first.motion.pose.centre)
    sigma = POINT_PX * depth_sigma(found.point, travel, focal)
    fit = fit_depth(found.point[:, 2], sigma)
    if fit is None or fit.evidence.mean() < LEAST_EVIDENCE:
        return replace(one, verdict="residual")
    centre = pose.to_camera(one.best_pose.to_world(one.position))
    centre *= fit.depth / centre[2]
    point = pose.to_world(centre)
    noise = np.full(2, fit.sigma / float(depth_sigma(centre[None], travel, focal)[0]) / focal)
    step = STEP_COVARIANCE if motion.covariance is None else motion.covariance
    poses = [crop.motion.pose for crop in one.crops]
    world = point_covariance(
        np.stack([p.rotation for p in poses]),
        np.stack([p.centre for p in poses]),
        point,
        np.arange(2),
        noise,
        noise,
        np.stack([step, step]),
        1,
    )
    axes, position = one.best_pose.rotation, one.best_pose.to_camera(point)
    right, down, ahead = position - one.position
    scale = float(position[2] / one.position[2])
    width, height = scale * one.width_m, scale * one.height_m
    across = CENTRE_SIGMA * np.array([width, height, 0.0])
    return replace(
        one,
        position=position,
        covariance=axes.T @ world @ axes + np.diag(across**2),
        right_m=one.right_m + right,
        above_m=one.above_m - down,
        station_m=one.station_m + ahead,
        width_m=width,
        height_m=height,
        sigma_width_m=SIZE_SIGMA * width,
        sigma_height_m=SIZE_SIGMA * height,
        residual_px=float(np.sqrt(found.residual[fit.agree].mean() / 2)),
        evidence=(("rigidity", float(fit.evidence.sum())),),
    )
