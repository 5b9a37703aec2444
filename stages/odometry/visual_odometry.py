"""How the camera moved from picture to picture (report chapters 7 and 8).

Each used picture is compared with the used one before it. A straight line of known length, odometry, poses or fixes
say what to expect; tie points over the whole picture say what was; the adjustment with the baseline held joins both.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import hypot, inf, nan, sqrt

import numpy as np

from wayside.schemas.detections import Detections
from wayside.schemas.frame import Frame, Pose
from wayside.schemas.motion import Motion, PosedDetections, StepPrior, Ties
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import midpoint, pair_residual
from wayside.stages.kernels import Array
from wayside.stages.odometry.epipolar import RelativePosePrior, halfway_direction
from wayside.stages.odometry.motion_prior import (
    MOST_SPEEDS,
    MOST_TRIGGERS,
    MotionPrior,
    predict_motion,
    trigger_speed,
)
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.pose_covariance import parallax_px, relative_pose_covariance
from wayside.stages.odometry.relative_pose import (
    FINE_SCALES_PX,
    RelativePose,
    RelativePoseEstimator,
    estimate_relative_pose,
)
from wayside.stages.odometry.tie_points import REGISTERED_SIGMA_PX, KeypointImage
from wayside.stages.odometry.two_view_adjustment import TwoViewAdjustment, adjust_two_views

MOST_DROPPED = 2
"""How many steps in a row may have lost triggers."""
UNSEEN_TURN_SIGMA = np.radians(1.0)
RATIO_TIES, RATIO_SLACK, SMALLEST_PARALLAX_PX, RATIO_SIGMA = 5, 0.15, 6.0, 0.004
"""Length of a step against the one before by common points: fewest points, how near to a multiple of the spacing it
must be, smallest way of a point through the picture, smallest relative error."""
MOST_DOUBTS = 2
"""Steps in a row for which points are believed against fixes."""
TRIMMED = 0.9


def estimate_motion(
    images: Iterator[Detections], settings: MotionSettings
) -> Iterator[PosedDetections]:
    """Add the camera's motion to each image.

    Frames that are not used pass with motion None. The first used frame is the origin of the drive's own frame.

    Raises
    ------
    InputError
        Where nothing says how far the camera moved.
    """
    drive = VisualOdometry(settings)
    for detections in images:
        yield PosedDetections(
            detections, drive.follow(detections) if detections.frame.used else None
        )


@dataclass(slots=True)
class VisualOdometry:
    """What is kept between pictures: the last view, and a few numbers learnt on the way.

    `measure` turns two views into a step; made-up drives, which have ties but no pixels, bring their own.
    """

    settings: MotionSettings
    measure: RelativePoseEstimator = field(default_factory=lambda: estimate_relative_pose)
    view: KeypointImage | None = None
    frame: Frame | None = None
    motion: Motion | None = None
    depths: Array = field(default_factory=lambda: np.zeros(0))
    turn: Array | None = None
    sigma_m: float = 0.0
    dropped: int = 0
    doubts: int = 0
    speeds: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_SPEEDS))
    vehicle: Mount = field(default_factory=Mount)

    def follow(self, detections: Detections) -> Motion:
        """Motion from the last image to this one."""
        return self.advance(KeypointImage.of(detections), detections.frame)

    def advance(self, view: KeypointImage | None, frame: Frame) -> Motion:
        """Motion from the last view to this one; without a view only what is expected."""
        if self.frame is None or self.motion is None:
            motion = _START
        else:
            expected = predict_motion(
                self.frame,
                frame,
                self.vehicle.law,
                self.turn,
                spacing_sigma_m=self.settings.spacing_sigma_m,
                speeds=self.speeds,
            )
            motion = self._step(self.motion, view, expected)
            self.speeds.append(trigger_speed(self.frame, frame))
        self.view, self.frame, self.motion = view, frame, motion
        return motion

    def _step(self, last: Motion, view: KeypointImage | None, expected: MotionPrior) -> Motion:
        step = None
        if self.view is not None and view is not None:
            fewest = self.settings.smallest_ties
            step = self.measure(self.view, view, expected, self.vehicle, fewest)
        if step is None or view is None or self.view is None:
            # On a curve the next step turns like the last one; after two of these nothing is known of it any more.
            self.depths, self.turn = np.zeros(0), None if last.ties is None else self.turn
            return _unmeasured(last, expected, self.vehicle.height_m)
        focal = (view.camera.fx, view.camera.fy)
        held = step.previous[step.inlier], step.current[step.inlier]
        straight_px = _root_mean(pair_residual(*held, *expected.straight, focal))
        adjusted = adjust_two_views(
            *held,
            (step.rotation, step.direction),
            step.prior,
            focal_px=focal,
            sigma_px=REGISTERED_SIGMA_PX,
            scale_px=FINE_SCALES_PX[-1],
        )
        carried = self._carried_length(step, adjusted, view.focal_px)
        baseline, sigma_m = self._length(carried, expected)
        needed = self.settings.always_adjust or not straight_px <= self.settings.residual_px
        rotation, direction = (
            (adjusted.rotation, adjusted.direction) if needed else expected.straight
        )
        points = _points(step, rotation, direction, baseline)
        self.depths = np.full(len(view.corners), np.nan)
        matched = step.inlier & (step.tied.rows[:, 1] >= 0)
        self.depths[step.tied.rows[matched, 1]] = points[matched, 2]
        self.turn, self.sigma_m = adjusted.rotation, sigma_m
        # Only matched ties tell the height of the road: those sought on it would confirm it.
        self.vehicle.learn(adjusted.rotation, adjusted.direction, points[matched])
        pose = Pose(rotation, baseline * direction)
        return Motion(
            last.pose.compose(pose),
            pose,
            relative_pose_covariance(
                adjusted, held, focal, baseline, sigma_m, scale_px=FINE_SCALES_PX[-1]
            ),
            expected.source,
            baseline,
            last.station_m + baseline,
            Ties(
                step.tied.previous,
                step.tied.current,
                step.inlier,
                points,
                step.tied.rows,
                step.tied.warp,
                step.tied.sigma,
            ),
            straight_px,
            _root_mean(pair_residual(*held, rotation, direction, focal)),
            needed,
            adjusted.iterations if needed else 0,
            self.vehicle.height_m,
            Pose(expected.straight[0], baseline * expected.straight[1]),
            tuple(np.sqrt(adjusted.history / 4).tolist()),
            _ratio(carried, last.baseline_m),
            _known_before(step.prior, expected, baseline, sigma_m),
        )

    def _length(self, by_points: tuple[float, float], expected: MotionPrior) -> tuple[float, float]:
        """The step's length and its sigma, metres, from what the points carry over and what is expected.

        Points that were measured over the last step too say how long this one is against it; none of them was found by
        its depth. A known spacing is held, or a multiple of it where triggers were dropped, by the points or, if they
        are too few, by the times; distances between poses or fixes are noisy, so they are averaged with what the points
        carry over from the steps before. Where both are far apart, a fix has jumped, out and back again at most: if
        they stay so, the points are wrong.
        """
        given, sigma = expected.baseline_m, expected.sigma_m
        carried, scatter = by_points
        if not np.isfinite(carried):
            return given, sigma
        if expected.source == "straight":
            spacing = given / expected.triggers
            steps = round(carried / spacing)
            near = abs(carried / spacing - steps) < RATIO_SLACK * steps
            dropped = near and 1 < steps <= MOST_TRIGGERS
            self.dropped = self.dropped + 1 if dropped else 0
            if near and steps == 1:
                return spacing, sigma
            # Triggers are not dropped time and again: then the points have a wrong scale.
            return (steps * spacing if 0 < self.dropped <= MOST_DROPPED else given), sigma
        carried_sigma = hypot(self.sigma_m, max(scatter, RATIO_SIGMA * carried))
        if abs(carried - given) > 3 * hypot(sigma, carried_sigma):
            self.doubts += 1
            jumps = expected.source == "fixes" and self.doubts <= MOST_DOUBTS
            return (carried, carried_sigma) if jumps else (given, sigma)
        self.doubts = 0
        share = sigma**2 / (sigma**2 + carried_sigma**2)
        return given + share * (carried - given), sigma * sqrt(1 - share)

    def _carried_length(
        self, step: RelativePose, adjusted: TwoViewAdjustment, focal_px: float
    ) -> tuple[float, float]:
        """Length of this step and its scatter, metres, by the depths of the step before; nan with too few points."""
        if len(self.depths) == 0:
            return nan, nan
        rows = step.tied.rows[step.inlier, 0]
        known = np.where(rows >= 0, self.depths[rows], nan)
        lengths = known * adjusted.point[:, 2]
        lengths = lengths[parallax_px(adjusted, focal_px) > SMALLEST_PARALLAX_PX]
        common = lengths[np.isfinite(lengths)]
        if len(common) < RATIO_TIES:
            return nan, nan
        length = float(np.median(common))
        # a median's sigma is 1.25 times a mean's, a normal law's 1.48 times its median deviation
        scatter = 1.86 * float(np.median(np.abs(common - length))) / sqrt(len(common))
        return length, scatter


def _points(step: RelativePose, rotation: Array, direction: Array, baseline_m: float) -> Array:
    """Ties in the current camera's frame (n, 3), nan where rays do not meet ahead of both cameras."""
    ones = np.ones((len(step.previous), 1))
    centre = baseline_m * direction
    found = midpoint(
        np.zeros(3),
        centre,
        np.hstack([step.previous, ones]),
        np.hstack([step.current, ones]) @ rotation.T,
    )
    points = (found.point - centre) @ rotation
    points[~found.ahead] = np.nan
    return points


def _ratio(carried: tuple[float, float], last_m: float) -> tuple[float, float]:
    """Length against that of the step before, and its scatter."""
    return (carried[0] / last_m, carried[1] / last_m) if last_m > 0 else (nan, nan)


def _known_before(
    prior: RelativePosePrior, expected: MotionPrior, baseline_m: float, sigma_m: float
) -> StepPrior:
    """What to adjust a step with, together with its neighbours.

    Distances between poses as given: the ties of all steps will average them. Those between fixes as averaged so far,
    since what the end of the drive makes of them stretches the drive by these lengths.
    """
    if expected.source in ("poses", "odometry"):
        baseline_m, sigma_m = expected.baseline_m, expected.sigma_m
    return StepPrior(
        prior.rotation,
        prior.sigma_rotation,
        prior.direction,
        prior.sigma_direction,
        prior.halfway,
        baseline_m,
        sigma_m,
    )


def _unmeasured(last: Motion, expected: MotionPrior, height_m: float) -> Motion:
    """Too few ties: the expectation as it is, with the turn of the step before."""
    rotation, direction = expected.search, expected.straight[1]
    if expected.prior.halfway:
        direction = halfway_direction(rotation, expected.prior.direction)
    baseline = expected.baseline_m
    turn = min(expected.prior.sigma_rotation, UNSEEN_TURN_SIGMA)
    aside = baseline * float(expected.prior.sigma_direction.max())
    covariance = np.diag([turn**2] * 3 + [aside**2] * 3)
    covariance[3:, 3:] += expected.sigma_m**2 * np.outer(direction, direction)
    pose = Pose(rotation, baseline * direction)
    return Motion(
        last.pose.compose(pose),
        pose,
        covariance,
        expected.source,
        baseline,
        last.station_m + baseline,
        None,
        nan,
        nan,
        False,
        0,
        height_m,
        prior=_known_before(
            expected.prior._replace(rotation=rotation, sigma_rotation=turn),
            expected,
            baseline,
            expected.sigma_m,
        ),
    )


def _root_mean(squares: Array) -> float:
    """Eq. 7.5 of each tie (n,) as RMS per coordinate over the best nine tenths.

    Midpoints near the focus of expansion may fall beside the camera; a few such ties would say all.
    """
    best = np.sort(squares)[: max(1, int(TRIMMED * len(squares)))]
    return float(np.sqrt(best.mean() / 4)) if np.isfinite(best).all() and len(best) else inf


_START = Motion(
    Pose(np.eye(3), np.zeros(3)),
    None,
    None,
    "start",
    0.0,
    0.0,
    None,
    nan,
    nan,
    False,
    0,
    nan,
)
