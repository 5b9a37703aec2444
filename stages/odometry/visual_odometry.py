"""Visual odometry: motion of the camera from image to image (report chapters 7 and 8).

Each used image is compared with the used one before it. The prior is a straight line of known length, odometry, poses
or fixes. Tie points over the whole image measure the motion. A two-view adjustment with the baseline held joins both.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, isfinite, nan, radians, sqrt

import numpy as np

from wayside.schemas.frame import Frame, Pose
from wayside.schemas.motion import Motion, StepPrior, Ties
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import halfway_direction, pair_residual, points_of_second
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import MotionPrior, predict_motion
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.pair_adjustment import PairAdjustment, adjust_pair
from wayside.stages.odometry.pose_noise import PoseNoise
from wayside.stages.odometry.relative_pose import (
    RelativePose,
    RelativePoseEstimator,
    estimate_relative_pose,
)
from wayside.stages.odometry.step_length import StepLength, step_length
from wayside.stages.odometry.tie_points import KeypointImage

FEWEST_COMMON = 5
"""Points common with the step before that give the length of a step."""
SMALLEST_PARALLAX_PX = 6.0
"""Smallest displacement of such a point by travel, px."""
UNMEASURED_SIGMA_DEG = 1.0
"""Rotation of a step without enough ties, degrees."""
TRIMMED = 0.9
"""Fraction of the ties that the residuals are means of."""


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """A step and what it leaves behind for the next one.

    `motion`: None before the first image. `depths` (n,), metres, of the corners of the image. `rotation` (3, 3) or None
    where unknown. `length` and `speed_mps` of the step.
    """

    motion: Motion | None
    depths: Array = field(default_factory=lambda: np.zeros(0))
    rotation: Array | None = None
    length: StepLength = field(default_factory=StepLength)
    speed_mps: float = nan


@dataclass(slots=True)
class VisualOdometry:
    """State between images: the last image and its frame, the step to it, the camera's mount, the noise of poses.

    `estimate` gives the relative pose of two images; simulated drives, which have ties but no pixels, replace it.
    """

    settings: MotionSettings
    estimate: RelativePoseEstimator = field(default_factory=lambda: estimate_relative_pose)
    image: KeypointImage | None = None
    frame: Frame | None = None
    last: OdometryStep = field(default_factory=lambda: OdometryStep(None))
    mount: Mount = field(init=False)
    noise: PoseNoise = field(default_factory=PoseNoise)

    def __post_init__(self) -> None:
        self.mount = Mount()

    def advance(self, image: KeypointImage | None, frame: Frame) -> Motion:
        """Motion from the last image to this one; without pixels the expected one. The step is `last` then."""
        given, step = self.noise.of(frame), OdometryStep(None)
        motion = replace(_START, given=given.pose)
        if self.frame is not None and self.last.motion is not None:
            expected = predict_motion(
                self.noise.of(self.frame),
                given,
                self.mount.travel,
                self.last.rotation,
                self.last.speed_mps,
                self.settings,
                self.last.length.length_in_spacings,
            )
            motion, step = self._step(self.last.motion, image, expected)
            motion = replace(motion, given=given.pose)
            seconds = (frame.time_ns - self.frame.time_ns) * 1e-9
            speed_mps = motion.baseline_m / seconds if seconds > 0 else nan
            step = replace(step, speed_mps=speed_mps)
        self.image, self.frame, self.last = image, frame, replace(step, motion=motion)
        return motion

    def _step(
        self, last: Motion, image: KeypointImage | None, expected: MotionPrior
    ) -> tuple[Motion, OdometryStep]:
        """A motion, and what else of the step is known: `motion` and `speed_mps` there are not set yet."""
        step = None
        if self.image is not None and image is not None:
            fewest = self.settings.smallest_ties
            step = self.estimate(self.image, image, expected, self.mount, fewest)
        if step is None or image is None or self.image is None:
            # The rotation of the last step is kept for one step without measurement, and is unknown after two.
            rotation = None if last.ties is None else self.last.rotation
            kept = replace(self.last, depths=np.zeros(0), rotation=rotation)
            return _unmeasured(last, expected, self.mount.height_m), kept
        focal = (image.camera.fx, image.camera.fy)
        held = step.previous[step.inlier], step.current[step.inlier]
        scatter = step.scatter(image.focal_px)
        straight_px = self._root_mean(pair_residual(*held, *expected.straight, focal))
        adjusted = adjust_pair(
            *held,
            (step.rotation, step.direction),
            expected.prior,
            focal_px=image.focal_px,
            scatter=scatter,
        )
        carried = self._carried_length(step, adjusted)
        length = step_length(self.last.length, carried, expected, self.settings)
        baseline, sigma_m = length.length_m, length.sigma_m
        needed = self.settings.always_adjust or not straight_px <= self.settings.residual_px
        rotation, direction = (
            (adjusted.rotation, adjusted.direction) if needed else expected.straight
        )
        points = points_of_second(step.previous, step.current, rotation, baseline * direction)
        depths = np.full(len(image.corners), np.nan)
        matched = step.inlier & (step.tied.rows[:, 1] >= 0)
        depths[step.tied.rows[matched, 1]] = points[matched, 2]
        # Only matched ties measure the height of the road: those predicted by the ground plane are biased.
        self.mount.learn(adjusted.rotation, adjusted.direction, points[matched])
        self.noise.learn(expected, adjusted)
        pose = Pose(rotation, baseline * direction)
        motion = Motion(
            last.pose.compose(pose),
            pose,
            adjusted.step_covariance(baseline, sigma_m),
            "points" if isfinite(length.length_in_spacings) else expected.source,
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
                scatter,
            ),
            straight_px,
            self._root_mean(pair_residual(*held, rotation, direction, focal)),
            needed,
            adjusted.iterations if needed else 0,
            self.mount.height_m,
            Pose(expected.straight[0], baseline * expected.straight[1]),
            tuple(adjusted.history_px.tolist()),
            _ratio(carried, last.baseline_m),
            _window_prior(expected, baseline, sigma_m),
        )
        return motion, OdometryStep(None, depths, adjusted.rotation, length)

    def _carried_length(self, step: RelativePose, adjusted: PairAdjustment) -> tuple[float, float]:
        """Length of this step and its scatter, metres, by points common with the step before; nan with too few."""
        if len(self.last.depths) == 0:
            return nan, nan
        rows = step.tied.rows[step.inlier, 0]
        known = np.where(rows >= 0, self.last.depths[rows], nan)
        lengths = known * adjusted.points[:, 2]
        lengths = lengths[adjusted.displacement_px > SMALLEST_PARALLAX_PX]
        common = lengths[np.isfinite(lengths)]
        if len(common) < FEWEST_COMMON:
            return nan, nan
        length = float(np.median(common))
        # A median's sigma is 1.25 times a mean's; a normal distribution's is 1.48 times its median absolute deviation.
        scatter = 1.86 * float(np.median(np.abs(common - length))) / sqrt(len(common))
        return length, scatter

    def _root_mean(self, squares: Array) -> float:
        """Eq. 7.5 of each tie (n,) as RMS per coordinate over the smallest of them (`TRIMMED`).

        Midpoints near the focus of expansion can lie to the side of the camera; a few such ties would dominate the
        mean.
        """
        best = np.sort(squares)[: max(1, int(TRIMMED * len(squares)))]
        return float(np.sqrt(best.mean() / 4)) if np.isfinite(best).all() and len(best) else inf


def _ratio(carried: tuple[float, float], last_m: float) -> tuple[float, float]:
    """Length over that of the step before, and its scatter."""
    return (carried[0] / last_m, carried[1] / last_m) if last_m > 0 else (nan, nan)


def _window_prior(expected: MotionPrior, baseline_m: float, sigma_m: float) -> StepPrior:
    """Prior of a step for its adjustment together with its neighbours.

    Distances between poses enter as given: the ties of all steps average them. Those between fixes enter as averaged
    so far, since the final path is fitted to the fixes with these lengths.
    """
    if expected.source in ("poses", "odometry"):
        return expected.prior
    return expected.prior._replace(length_m=baseline_m, sigma_m=sigma_m)


def _unmeasured(last: Motion, expected: MotionPrior, height_m: float) -> Motion:
    """Motion of a step with too few ties: the prior, with the rotation of the step before."""
    prior, rotation, direction = expected.prior, expected.search, expected.straight[1]
    if prior.halfway:
        direction = halfway_direction(rotation, prior.direction)
    baseline = prior.length_m
    sigma_rotation = min(prior.sigma_rotation, radians(UNMEASURED_SIGMA_DEG))
    sigma_aside = baseline * float(prior.sigma_direction.max())
    covariance = np.diag([sigma_rotation**2] * 3 + [sigma_aside**2] * 3)
    covariance[3:, 3:] += prior.sigma_m**2 * np.outer(direction, direction)
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
        prior=prior._replace(rotation=rotation, sigma_rotation=sigma_rotation),
    )


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
