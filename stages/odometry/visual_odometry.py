"""The motion stage: which images of a drive show motion, and the camera's motion between them (report chapters 7, 8).

Each used image is compared with the used one before it. The prior is a straight line of known length, odometry, poses
or fixes. Tie points over the whole image measure the motion. A two-view adjustment with the baseline held joins both.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import inf, isfinite, nan, radians, sqrt

import numpy as np

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Detections, Regions
from wayside.schemas.frame import DUPLICATE, Frame, Image, Pose
from wayside.schemas.motion import Motion, PosedDetections
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import (
    halfway_direction,
    pair_residual,
    points_of_second,
    vector_from_rotation,
)
from wayside.stages.kernels import Array
from wayside.stages.odometry.motion_prior import MotionPrior, PoseNoise, predict_motion
from wayside.stages.odometry.mount import Mount
from wayside.stages.odometry.pair_adjustment import PairAdjustment, adjust_pair
from wayside.stages.odometry.relative_pose import (
    RelativePose,
    RelativePoseEstimator,
    estimate_relative_pose,
)
from wayside.stages.odometry.step_length import StepLength, step_length
from wayside.stages.odometry.tie_points import GUIDED_RATIO, SEARCH_PX, KeypointImage, match_around

FEWEST_COMMON = 5
"""Points common with the step before that give the length of a step."""
SMALLEST_PARALLAX_PX = 6.0
"""Smallest displacement of such a point by travel, px."""
UNMEASURED_SIGMA_DEG = 1.0
"""Rotation of a step without enough ties, degrees."""
TRIMMED = 0.9
"""Fraction of the ties that the residuals are means of."""

STANDING_SHARE = 0.4
"""Share of corners found again in place of a camera that stands: drives show 0.26 at most, shaken images 0.43."""


def estimate_motion(
    images: Iterator[Detections], settings: MotionSettings
) -> Iterator[PosedDetections]:
    """Add the camera's motion to each image.

    Frames that are not used pass with motion None. The first used frame is the origin of the drive's own frame. An
    image that shows no motion since the last used one becomes a frame with the status `duplicate`, without candidates.
    Rays of both have no baseline, and a panel would get the same measurement twice. Slow motion adds up, since images
    are compared with the one that was used last.

    Raises InputError where no source gives the length of a step.
    """
    odometry = VisualOdometry(settings)
    for item in images:
        if not item.frame.used:
            yield PosedDetections(item, None)
            continue
        image = KeypointImage.of(item)
        if shows_no_motion(odometry.image, image, settings):
            yield PosedDetections(_left_out(item), None)
        else:
            yield PosedDetections(item, odometry.advance(image, item.frame))


def shows_no_motion(
    before: KeypointImage | None, now: KeypointImage | None, settings: MotionSettings
) -> bool:
    """Whether enough corners of an image are found again at the same place to show that the camera stands.

    This needs no prior: a wrong pose or spacing does not hide a copy. Travel moves most corners, and leaves only those
    that are far away, or on the vehicle itself; corners on other vehicles move while the camera stands. False where an
    image has too few corners to tell.
    """
    if before is None or now is None or before.grey.shape != now.grey.shape:
        return False
    most = min(len(before.corners), len(now.corners))
    if most < settings.smallest_ties:
        return False
    again = match_around(before, now, SEARCH_PX, GUIDED_RATIO, before.stride)
    return len(again) * before.stride >= STANDING_SHARE * most


def _left_out(item: Detections) -> Detections:
    """An image that takes no part, without pixels and candidates; the number of its regions stays.

    So none is lost uncounted. Recorded bytes go as well: where a vehicle stands, any number of duplicates waits behind
    the tracking window.
    """
    frame = replace(item.frame, status=DUPLICATE, data=b"")
    image, none = Image(frame, None, None), Regions.empty()
    segmentation = replace(item.segmentation, image=image, regions=none, dropped=NOTHING_DROPPED)
    return Detections(segmentation, Candidates.of(none))


@dataclass(slots=True)
class VisualOdometry:
    """State between images: the last one and its frame, the motion to it, the camera's mount, the noise of poses.

    `estimate` gives the relative pose of two images; simulated drives, which have ties but no pixels, replace it.
    """

    settings: MotionSettings
    estimate: RelativePoseEstimator = field(default_factory=lambda: estimate_relative_pose)
    image: KeypointImage | None = None
    frame: Frame | None = None
    motion: Motion | None = None
    depths: Array = field(default_factory=lambda: np.zeros(0))
    """Of the corners of the last image, (n,), metres."""
    rotation: Array | None = None
    """Of the last step, (3, 3), None where unknown."""
    length: StepLength = field(default_factory=StepLength)
    speed_mps: float = nan
    mount: Mount = field(default_factory=Mount)
    noise: PoseNoise = field(default_factory=PoseNoise)

    def advance(self, image: KeypointImage | None, frame: Frame) -> Motion:
        """Motion from the last image to this one; without pixels the expected one."""
        given, motion = self.noise.of(frame), Motion(Pose(np.eye(3), np.zeros(3)))
        if self.frame is not None and self.motion is not None:
            last = self.mount.travel, self.rotation, self.speed_mps
            stated = self.settings, self.length.length_in_spacings
            expected = predict_motion(self.noise.of(self.frame), given, *last, *stated)
            step = None
            if self.image is not None and image is not None:
                fewest = self.settings.smallest_ties
                step = self.estimate(self.image, image, expected, self.mount, fewest)
            if step is None or image is None:
                motion = self._unmeasured(self.motion, expected)
            else:
                motion = self._measured(self.motion, step, image, expected)
            seconds = (frame.time_ns - self.frame.time_ns) * 1e-9
            self.speed_mps = motion.baseline_m / seconds if seconds > 0 else nan
        self.image, self.frame = image, frame
        self.motion = replace(motion, given=given.pose)
        return self.motion

    def _measured(
        self, last: Motion, step: RelativePose, image: KeypointImage, expected: MotionPrior
    ) -> Motion:
        focal = (image.camera.fx, image.camera.fy)
        held = step.previous[step.inlier], step.current[step.inlier]
        ahead = self.mount.travel.direction
        start = step.rotation, step.direction
        adjusted = adjust_pair(*held, start, expected.prior, focal_px=image.focal_px)
        straight_px = root_mean(pair_residual(*held, *expected.straight, focal))
        carried = self._carried_length(step, adjusted)
        self.length = step_length(self.length, carried, expected, self.settings)
        baseline, sigma_m = self.length.length_m, self.length.sigma_m
        needed = not straight_px <= self.settings.residual_px
        rotation, direction = adjusted[:2] if needed else expected.straight
        covariance = adjusted.step_covariance(baseline, sigma_m)
        if not needed:  # its error is what the adjustment would have changed
            turn = vector_from_rotation(rotation @ adjusted.rotation.T)
            off = np.concatenate([turn, baseline * (direction - adjusted.direction)])
            covariance += np.outer(off, off)
        points = points_of_second(step.previous, step.current, rotation, baseline * direction)
        self.rotation, self.depths = adjusted.rotation, np.full(len(image.corners), np.nan)
        # Only matched ties measure lengths and the height of the road: those predicted by the ground plane are biased.
        matched = step.inlier & (step.tied.rows[:, 1] >= 0)
        self.depths[step.tied.rows[matched, 1]] = points[matched, 2]
        self.mount.learn(adjusted.rotation, adjusted.direction, points[matched])
        self.noise.learn(expected, adjusted)
        prior = expected.prior
        if expected.source not in ("poses", "odometry"):
            # Averaged so far, as the path is fitted to the fixes with these lengths; poses enter as they are given.
            prior = prior._replace(length_m=baseline, sigma_m=sigma_m)
        pose = Pose(rotation, baseline * direction)
        return Motion(
            pose=last.pose.compose(pose),
            step=pose,
            covariance=covariance,
            source="points" if isfinite(self.length.length_in_spacings) else expected.source,
            baseline_m=baseline,
            station_m=last.station_m + baseline,
            ties=step.ties(points, adjusted.scatter),
            residual_straight_px=straight_px,
            residual_px=root_mean(pair_residual(*held, rotation, direction, focal)),
            adjusted=needed,
            iterations=len(adjusted.history_px) - 1 if needed else 0,
            camera_height_m=self.mount.height_m,
            straight=Pose(np.eye(3), baseline * ahead),
            history_px=tuple(adjusted.history_px.tolist()),
            length_ratio=tuple(np.divide(carried, last.baseline_m or nan).tolist()),
            prior=prior,
        )

    def _unmeasured(self, last: Motion, expected: MotionPrior) -> Motion:
        """Motion of a step with too few ties: the prior, with the rotation of the step before."""
        prior, rotation, direction = expected.prior, expected.search, expected.straight[1]
        # That rotation is kept for one step without measurement, and is unknown after two.
        self.rotation = None if last.ties is None else self.rotation
        self.depths = np.zeros(0)
        if prior.halfway:
            direction = halfway_direction(rotation, prior.direction)
        baseline = prior.length_m
        sigma_rotation = min(prior.sigma_rotation, radians(UNMEASURED_SIGMA_DEG))
        sigma_aside = baseline * float(prior.sigma_direction.max())
        covariance = np.diag([sigma_rotation**2] * 3 + [sigma_aside**2] * 3)
        covariance[3:, 3:] += prior.sigma_m**2 * np.outer(direction, direction)
        pose = Pose(rotation, baseline * direction)
        return Motion(
            pose=last.pose.compose(pose),
            step=pose,
            covariance=covariance,
            source=expected.source,
            baseline_m=baseline,
            station_m=last.station_m + baseline,
            camera_height_m=self.mount.height_m,
            prior=prior._replace(rotation=rotation, sigma_rotation=sigma_rotation),
        )

    def _carried_length(self, step: RelativePose, adjusted: PairAdjustment) -> tuple[float, float]:
        """Length of this step and its scatter, metres, by points common with the step before; nan with too few."""
        if len(self.depths) == 0:
            return nan, nan
        rows = step.tied.rows[step.inlier, 0]
        known = np.where(rows >= 0, self.depths[rows], nan)
        lengths = known * adjusted.points[:, 2]
        lengths = lengths[adjusted.displacement_px > SMALLEST_PARALLAX_PX]
        common = lengths[np.isfinite(lengths)]
        if len(common) < FEWEST_COMMON:
            return nan, nan
        length = float(np.median(common))
        # A median's sigma is 1.25 times a mean's; a normal distribution's is 1.48 times its median absolute deviation.
        scatter = 1.86 * float(np.median(np.abs(common - length))) / sqrt(len(common))
        return length, scatter


def root_mean(squares: Array) -> float:
    """Eq. 7.5 of each tie (n,) as RMS per coordinate over the smallest of them (`TRIMMED`).

    Midpoints near the focus of expansion can lie to the side of the camera; a few such ties would dominate the mean.
    """
    best = np.sort(squares)[: max(1, int(TRIMMED * len(squares)))]
    return float(np.sqrt(best.mean() / 4)) if np.isfinite(best).all() and len(best) else inf
