"""SIFT points of a segment, triangulated from its two nearest views, and one row a panel (report chapters 5 and 7)."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Crop, Landmark, TrackedFrame
from wayside.schemas.models import GaussianModel
from wayside.stages.classifiers import log_ratios
from wayside.stages.geometry import pair_residual, points_of_second, to_rays
from wayside.stages.kernels import Array
from wayside.stages.mapping import BOX_SIGMA, STEP_COVARIANCE, point_covariance

# Set on learning drives, where no other reason is given.
MOST_POINTS, CONTRAST = 60, 0.03
"""Strongest SIFT points of a view, and their least contrast."""
RATIO, SAME_PX = 0.8, 2.0
"""Largest distance of a descriptor from its nearest, by that from the nearest at another place (Lowe 2004), px away."""
LARGEST_E = 4.0
"""Largest residual of a point (eq. 7.5), px squared: a pixel in each of four coordinates."""
POINT_PX, AGREE_SIGMAS = 0.25, 2.5
"""Scatter of a point a coordinate, px; depths that agree differ by less, standard deviations."""
LEAST_SIGMA = 0.003
"""Least scatter of the depth of a point about that of its panel, by the depth: panels are turned a little."""
WRONG, LOG_DEPTHS = 0.3, 4.1
"""Share of wrong matches; logarithm of the ratio of their largest and least depth: 5 to 300 m."""
MOST_EVIDENCE = np.log(WRONG + (1 - WRONG) * LOG_DEPTHS / (LEAST_SIGMA * np.sqrt(2 * np.pi)))
"""Most evidence of a point."""
RIGIDITY = 1.7
"""Weight of the logarithm of one plus the evidence of all points together, since they depend on each other (fitted with
those in `match.py`)."""
LEAST_EVIDENCE = 8.0
"""Least sum of the evidence on a landmark: 85 % of the signs that have one reach it, on six learning drives in turn."""
CENTRE_SIGMA, SIZE_SIGMA = 0.25, 0.9
"""Errors of centre and size of a segment as those of its panel, by its size: most are only parts of their panel."""
PLANE_SIGMAS, PLANE_M = 2.5, 0.6
"""Stations of one plane differ by less, standard deviations of both, or metres."""


def match_points(first: Crop, second: Crop, sift: cv2.SIFT, fewest: float) -> tuple[Array, Array]:
    """Midpoints (k, 3) of the SIFT points that match, in the axes of the second camera, and their residual e (k,).

    Points match that are each other's nearest among those on each other's epipolar lines and ahead of both cameras.
    None where a view has none or fewer than `fewest`, of most evidence with the centre: too few for a sign.
    """
    views = list[Any]()
    for crop in (first, second):
        found, codes = sift.detectAndCompute(crop.grey, None)
        if len(found) < max(1, fewest):
            return np.zeros((0, 3)), np.zeros(0)
        place = np.asarray(cv2.KeyPoint.convert(found), np.float64)
        views.append((place, to_rays(crop.camera, place + crop.corner), codes))
    (_, start, own), (at, end, other) = views
    moved = second.motion.pose.relative_to(first.motion.pose)
    shape = len(start), len(end)
    i, j = (numbers.ravel() for numbers in np.indices(shape))
    focal, pose = (second.camera.fx, second.camera.fy), (moved.rotation, moved.centre)
    e = pair_residual(start[i], end[j], *pose, focal).reshape(shape)
    i, j = np.nonzero(e < LARGEST_E)
    point = points_of_second(start[i], end[j], *pose)
    ahead = np.isfinite(point[:, 2])
    i, j, point = i[ahead], j[ahead], point[ahead]
    # exact: sums of 128 products of whole numbers below 256
    square = (own**2).sum(axis=1)[:, None] + (other**2).sum(axis=1)
    apart = np.full(shape, np.inf)
    apart[i, j] = np.sqrt(square[i, j] - 2 * (own @ other.T)[i, j])
    nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
    elsewhere = ((at[nearest][:, None] - at) ** 2).sum(axis=2) > SAME_PX**2
    others = np.where(elsewhere, apart, np.inf).min(axis=1)
    match = (nearest[i] == j) & (back[j] == i) & (apart[i, j] < RATIO * others[i])
    return point[match], e[i, j][match]


def depth_sigma(point: Array, travel: Array) -> Array:
    """Scatter (k,) of the depth of points (k, 3) by that of a ray, metres: z z' sqrt(z^2 + z'^2) / (R b).

    Two views, `travel` (3,) apart in the axes of the nearer one; z' is the depth in the other, R the distance from the
    line of travel.
    """
    z = point[:, 2]
    before = np.maximum(z + travel[2], 1e-3)
    aside = np.linalg.norm(point[:, :2] - z[:, None] * (travel[:2] / travel[2]), axis=1)
    base = float(np.linalg.norm(travel))
    return np.asarray(z * before * np.hypot(z, before) / (np.maximum(aside, 1e-3) * base))


class DepthFit(NamedTuple):
    """The depth that most of k points agree on, and its standard deviation, metres; which agree (k,).

    `evidence` (k,): log-likelihood ratio of each point, of that depth against any depth.
    """

    depth: float
    sigma: float
    agree: NDArray[np.bool_]
    evidence: Array


def fit_depth(depth: Array, sigma: Array) -> DepthFit:
    """The depth of k > 0 points by their depths and standard deviations (k,)."""
    near = np.abs(depth[:, None] - depth) <= AGREE_SIGMAS * sigma
    agree = near[np.lexsort((sigma, -near.sum(axis=1)))[0]]
    weight = agree / sigma**2
    mean = float(weight @ depth / weight.sum())
    chi2 = float(weight @ (depth - mean) ** 2) / max(1, agree.sum() - 1)
    relative = np.maximum(sigma / depth, LEAST_SIGMA)
    off = np.log(depth / mean) / relative
    density = np.exp(-0.5 * off**2) / (relative * np.sqrt(2 * np.pi))
    evidence = np.log(WRONG + (1 - WRONG) * LOG_DEPTHS * density)
    return DepthFit(mean, float(np.sqrt(max(1.0, chi2) / weight.sum())), agree, evidence)


def triangulate_points(
    tracked: Iterator[TrackedFrame], sizes: GaussianModel
) -> Iterator[TrackedFrame]:
    """Place accepted landmarks by the SIFT points of their two nearest views; refuse those that scatter (`residual`).

    The points of a face lie on an upright plane. Their midpoints (eq. 7.4) therefore agree on one depth, which is also
    the depth of the segment's centre. Points of leaves and of things behind them do not. A landmark without pixels
    stays as it is. `sizes`: of the logarithms of width and height, metres.
    """
    sift = cv2.SIFT.create(MOST_POINTS, contrastThreshold=CONTRAST)
    for frame in tracked:
        sides = np.array([(one.width_m, one.height_m) for one in frame.landmarks]).reshape(-1, 2)
        ratios = log_ratios(np.log(sides), sizes).max(axis=1).tolist()
        landmarks = (
            _placed(one, sift, size) if one.verdict == "sign" and len(one.crops) > 1 else one
            for one, size in zip(frame.landmarks, ratios, strict=True)
        )
        yield replace(frame, landmarks=tuple(landmarks))


def _placed(one: Landmark, sift: cv2.SIFT, size: float) -> Landmark:
    first, second = one.crops
    others = size + sum(ratio for _, ratio in one.evidence)
    fewest = np.expm1((LEAST_EVIDENCE - others) / RIGIDITY) / MOST_EVIDENCE - 1
    points, e = match_points(first, second, sift, fewest)
    poses = [crop.motion.pose for crop in one.crops]
    travel, focal = -poses[1].to_camera(poses[0].centre), second.camera.fx
    centre = poses[1].to_camera(one.best_pose.to_world(one.position))
    tall_px = focal * one.height_m / centre[2]
    points = np.vstack([centre, points])
    scatter = depth_sigma(points, travel) / focal
    scatter *= [BOX_SIGMA[0] + BOX_SIGMA[1] * tall_px, *(POINT_PX for _ in e)]
    fit = fit_depth(points[:, 2], scatter)
    rigidity = RIGIDITY * float(np.log1p(max(0.0, fit.evidence.sum())))
    evidence = (*one.evidence, ("size", size), ("rigidity", rigidity))
    if sum(ratio for _, ratio in evidence) < LEAST_EVIDENCE:
        return replace(one, verdict="residual", crops=())
    centre *= fit.depth / centre[2]
    point = poses[1].to_world(centre)
    rays = np.full(2, fit.sigma / float(depth_sigma(centre[None], travel)[0]))
    step = STEP_COVARIANCE if second.motion.covariance is None else second.motion.covariance
    rotations, centres = np.stack([p.rotation for p in poses]), np.stack([p.centre for p in poses])
    steps = np.stack([step, step])
    world = point_covariance(rotations, centres, point, np.arange(2), rays, rays, steps, 1)
    axes, position = one.best_pose.rotation, one.best_pose.to_camera(point)
    right, down, ahead = position - one.position
    width, height = position[2] / one.position[2] * np.array([one.width_m, one.height_m])
    across = CENTRE_SIGMA * np.array([width, height, 0.0])
    return replace(
        one,
        crops=(),
        position=position,
        covariance=axes.T @ world @ axes + np.diag(across**2),
        right_m=one.right_m + right,
        above_m=one.above_m - down,
        station_m=one.station_m + ahead,
        width_m=float(width),
        height_m=float(height),
        sigma_width_m=SIZE_SIGMA * float(width),
        sigma_height_m=SIZE_SIGMA * float(height),
        residual_px=float(np.sqrt(e[fit.agree[1:]].mean() / 2)) if fit.agree[1:].any() else np.nan,
        evidence=evidence,
    )


def merge_segments(tracked: Iterator[TrackedFrame]) -> Iterator[TrackedFrame]:
    """Of accepted landmarks on one panel, such as legend, face and frame, keep that of most evidence (`duplicate`).

    Frames come out in order, when the camera has passed their landmarks: then all others there are known.
    """
    waiting: deque[TrackedFrame] = deque()
    known: list[Landmark] = []
    for frame in tracked:
        waiting.append(frame)
        known += [one for one in frame.landmarks if one.verdict == "sign"]
        while waiting and frame.motion is not None:
            station = frame.motion.station_m
            if any(o.verdict == "sign" and o.station_m > station for o in waiting[0].landmarks):
                break
            first = waiting.popleft()
            yield _merged(first, known)
            if first.motion is not None:
                passed = first.motion.station_m
                known = [one for one in known if one.station_m > passed]
    yield from (_merged(frame, known) for frame in waiting)


def _merged(frame: TrackedFrame, known: Sequence[Landmark]) -> TrackedFrame:
    def rank(one: Landmark) -> tuple[float, int]:
        return dict(one.evidence).get("rigidity", 0.0), -one.track_id

    landmarks = (
        replace(one, verdict="duplicate")
        if one.verdict == "sign"
        and any(rank(other) > rank(one) and same_plane(one, other) for other in known)
        else one
        for one in frame.landmarks
    )
    return replace(frame, landmarks=tuple(landmarks))


def same_plane(one: Landmark, other: Landmark) -> bool:
    """Whether two landmarks at one depth overlap in the camera that sees the nearer one best."""
    variance = one.covariance[2, 2] + other.covariance[2, 2]
    if abs(one.station_m - other.station_m) > max(PLANE_M, PLANE_SIGMAS * float(np.sqrt(variance))):
        return False
    camera = min(one, other, key=lambda each: float(each.position[2])).best_pose
    (low, high), (least, most) = _box_seen(camera, one), _box_seen(camera, other)
    return bool((np.minimum(high, most) > np.maximum(low, least)).all())


def _box_seen(camera: Pose, one: Landmark) -> Array:
    """Least and largest x/z and y/z (2, 2) of a landmark."""
    centre = camera.to_camera(one.best_pose.to_world(one.position))
    half = np.array([one.width_m, one.height_m]) / 2
    return np.asarray(np.stack([centre[:2] - half, centre[:2] + half]) / centre[2])
