"""A simulated drive: poses of the camera, signs and points along the road, and their projections with noise.

World: x right, y down, z ahead at the start, metres. The camera follows an arc over hills. The drive yields the items
that the tracker takes, so that the stages of `wayside run` do the rest.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf, radians

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.schemas.detections import Candidates, Detections, Regions
from wayside.schemas.frame import USED, Camera, Frame, Image, Pose, PosePrior
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import ideal_of_rays, rays_of_ideal
from wayside.stages.kernels import Array, Flags, Numbers
from wayside.stages.odometry import (
    KeypointImage,
    MotionPrior,
    Mount,
    PairMotion,
    RegisteredTies,
    RelativePose,
    VisualOdometry,
    fit_coarse_motion,
    fit_relative_pose,
)
from wayside.stages.segmentation import unsegmented

HILL_M = 400.0
"""Length of a hill, foot to foot."""
LEAST_DEPTH_M, TIE_REACH_M, SIGN_REACH_M = 4.0, 120.0, 150.0
POINTS_A_METRE = 14
"""Points that can be ties, on the road and along it."""
SMALLEST_PX = 8.0
"""A panel of smaller height in the image is not seen."""
GROSS_TIE_PX, GROSS_SIGN_PX = 6.0, 5.0
"""Scatter of outliers."""
DRIFT_WAVES = 24
SURE = 3.0


@dataclass(frozen=True, slots=True)
class Survey:
    """A survey and its errors; lengths in metres, angles in degrees, noise in pixels a coordinate.

    `noise_px`, `noise_share`: of a panel's centre in each image, and an addition as a fraction of its height.
    `face_share`: offset common to all views of a panel, as a fraction of its size. `tie_px`: of a tie in each image.
    `tie_drift_px`, `tie_drift_share`, `tie_drift_reach_px`: error that a tie shares with the ties around it, an
    addition as a fraction of its displacement, and the reach of the correlation. `trigger_m`: scatter of the spacing.
    `jitter_deg`: of the pitch (half as much roll, a quarter yaw). `outliers`: fraction of gross errors among ties and
    panels. `pose_m`, `pose_deg`: scatter of given poses (None: only the spacing is given).
    """

    spacing_m: float = 8.0
    focal_px: float = 1400.0
    width: int = 1600
    height: int = 1200
    noise_px: float = 0.3
    noise_share: float = 0.005
    face_share: float = 0.02
    tie_px: float = 0.08
    tie_drift_px: float = 0.05
    tie_drift_share: float = 0.004
    tie_drift_reach_px: float = 60.0
    ties: int = 200
    trigger_m: float = 0.02
    range_min_m: float = 0.0
    lateral_m: float = 3.5
    up_m: float = 0.5
    panel_m: float = 0.75
    camera_height_m: float = 2.0
    curve_radius_m: float = inf
    hill_m: float = 0.0
    jitter_deg: float = 0.1
    drop_rate: float = 0.0
    outliers: float = 0.0
    mount_yaw_deg: float = 0.0
    mount_pitch_deg: float = 0.0
    pose_m: float | None = None
    pose_deg: float = 0.04
    signs: int = 100
    signs_every_m: float = 25.0
    seed: int = 1

    @property
    def camera(self) -> Camera:
        """The camera, without distortion: only undistorted points enter the geometry."""
        middle = (self.width - 1) / 2, (self.height - 1) / 2
        return Camera(self.width, self.height, self.focal_px, self.focal_px, *middle)

    def drift_of(self, camera: Camera, step: Pose, previous: Array, current: Array) -> Array:
        """Scatter (n,) of the shared error of ties at ideal pixels (n, 2) of both images."""
        far = rays_of_ideal(camera, previous) @ step.rotation[:2] + step.rotation[2]
        displacement = current - ideal_of_rays(camera, far[:, :2] / far[:, 2:])
        return np.asarray(
            self.tie_drift_px + self.tie_drift_share * np.linalg.norm(displacement, axis=1)
        )


@dataclass(frozen=True, slots=True)
class PanelObservations:
    """Panels in one image: which (k,), and the same number of boxes (k, 4) and centres (k, 2), px."""

    sign: Numbers
    box: Array
    centre: Array

    def candidates(self) -> Candidates:
        """As a detector would give them."""
        count = len(self.sign)
        regions = Regions(
            self.box.astype(np.float32),
            np.full(count, 100, np.int32),
            np.zeros((count, 3), np.float32),
            np.zeros(count, np.uint8),
        )
        score = np.full(count, SURE, np.float32)
        return replace(Candidates.of(regions), center=self.centre, ideal=self.centre, score=score)


class SimulatedDrive:
    """Truth and observations of one survey; the same survey gives the same drive."""

    def __init__(self, survey: Survey) -> None:
        self.survey, self.camera = survey, survey.camera
        self._middle = np.array([self.camera.cx, self.camera.cy])
        self._rng = np.random.default_rng(survey.seed)
        rng, first = self._rng, 40.0 + SIGN_REACH_M
        self.sign_station = first + survey.signs_every_m * (
            np.arange(survey.signs) + rng.uniform(-0.3, 0.3, survey.signs)
        )
        end = self.sign_station[-1] + 2 * survey.spacing_m
        steps = rng.normal(survey.spacing_m, survey.trigger_m, int(end / survey.spacing_m))
        station = np.concatenate([[0.0], np.cumsum(steps)])
        kept = rng.random(len(station)) >= survey.drop_rate
        kept[:4] = True
        self.station = station[kept]
        self.poses = [self._pose(s) for s in self.station]
        self.signs = self._beside(
            self.sign_station,
            np.full(survey.signs, survey.lateral_m),
            np.full(survey.signs, survey.camera_height_m + survey.up_m),
        )
        self.seen: list[PanelObservations] = []
        self._visible: dict[int, Numbers] = {}
        self._face = rng.normal(0, survey.face_share * survey.panel_m, (survey.signs, 2))
        self.points, self._point_station = self._scatter_points(station[-1] + TIE_REACH_M)

    def posed(self, settings: MotionSettings) -> Iterator[PosedDetections]:
        """Every frame with its candidates and the motion that the odometry of `wayside run` estimates."""
        odometry = VisualOdometry(settings, estimate=self._estimate)
        for index, pose in enumerate(self.poses):
            frame = self._frame(index)
            motion = odometry.advance(self._keypoint_image(index), frame)
            seen = self._observe(index, pose)
            self.seen.append(seen)
            image = Image(frame, None, None)
            yield PosedDetections(Detections(unsegmented(image), seen.candidates()), motion)

    def visible(self, index: int) -> Numbers:
        """Points that could be ties in an image, ascending."""
        if index not in self._visible:
            station = self.station[index]
            low, high = np.searchsorted(self._point_station, [station, station + TIE_REACH_M])
            shown = self._inside(self.poses[index].to_camera(self.points[low:high]))
            self._visible[index] = np.asarray(low + np.flatnonzero(shown), np.int64)
        return self._visible[index]

    def common(self, before: int, now: int) -> Numbers:
        """Points that tie two images: the first of those that both show, in a fixed order without meaning."""
        shared = np.intersect1d(self.visible(before), self.visible(now), assume_unique=True)
        order = np.argsort((shared * 2654435761) % 2**32, kind="stable")
        return np.sort(shared[order[: self.survey.ties]])

    def project(self, index: int, points: Array) -> Array:
        """Pixels (n, 2) of points of the world in an image."""
        local = self.poses[index].to_camera(points)
        return np.asarray(local[:, :2] / local[:, 2:] * self.camera.fx + self._middle)

    def depth(self, index: int, points: Array) -> Array:
        """Distance (n,) of points of the world (n, 3) ahead of the camera of an image."""
        return np.asarray(self.poses[index].to_camera(points)[:, 2])

    def _pose(self, station: float) -> Pose:
        s, rng = self.survey, self._rng
        right, down, ahead = self._axes(np.array([station]))
        body = np.column_stack([right[0], down[0], ahead[0]])
        jitter = rng.normal(0, radians(s.jitter_deg), 3) * [1.0, 0.25, 0.5]
        turn = Rotation.from_rotvec(np.array([radians(s.mount_pitch_deg), 0, 0]))
        turn = Rotation.from_rotvec(np.array([0, radians(s.mount_yaw_deg), 0])) * turn
        rotation = body @ (turn * Rotation.from_rotvec(jitter)).as_matrix()
        up = np.array([s.camera_height_m])
        return Pose(rotation, self._beside(np.array([station]), np.zeros(1), up)[0])

    def _axes(self, station: Array) -> tuple[Array, Array, Array]:
        """Right, down and ahead of the road (n, 3) each."""
        heading = station / self.survey.curve_radius_m
        wave = 2 * np.pi / HILL_M
        slope = self.survey.hill_m / 2 * wave * np.cos(wave * station)
        right = np.column_stack([np.cos(heading), np.zeros_like(station), -np.sin(heading)])
        ahead = np.column_stack([np.sin(heading), -slope, np.cos(heading)])
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        return right, np.cross(ahead, right), ahead

    def _beside(self, station: Array, lateral: Array, above: Array) -> Array:
        """World points (n, 3) along the road's line and above its surface."""
        radius, hill = self.survey.curve_radius_m, self.survey.hill_m / 2
        across, along = np.zeros_like(station), station
        if np.isfinite(radius):
            across = radius * (1 - np.cos(station / radius))
            along = radius * np.sin(station / radius)
        height = hill * np.sin(2 * np.pi / HILL_M * station)
        line = np.column_stack([across, -height - above, along])
        return np.asarray(line + lateral[:, None] * self._axes(station)[0])

    def _scatter_points(self, end: float) -> tuple[Array, Array]:
        """Half on the road, half on the verge and its plants."""
        rng, count = self._rng, int(end * POINTS_A_METRE)
        station = np.sort(rng.uniform(0, end, count))
        road = rng.random(count) < 0.5
        side = rng.choice([-1.0, 1.0], count)
        lateral = np.where(road, rng.uniform(-6, 6, count), side * rng.uniform(5, 30, count))
        above = np.where(road, 0.0, rng.gamma(1.0, 2.0, count))
        return self._beside(station, lateral, above), station

    def _inside(self, local: Array) -> Flags:
        """Whether points in the camera's frame (n, 3) are far enough ahead and in the image."""
        uv = local[:, :2] / np.maximum(local[:, 2], 1e-3)[:, None] * self.camera.fx + self._middle
        within = (uv >= 0) & (uv <= [self.survey.width - 1, self.survey.height - 1])
        return np.asarray((local[:, 2] > LEAST_DEPTH_M) & within.all(axis=1))

    def _frame(self, index: int) -> Frame:
        s, prior = self.survey, None
        if s.pose_m is not None:
            true, rng = self.poses[index], self._rng
            turn = Rotation.from_rotvec(rng.normal(0, radians(s.pose_deg), 3)).as_matrix()
            noisy = Pose(true.rotation @ turn, true.centre + rng.normal(0, s.pose_m, 3))
            prior = PosePrior(noisy, s.pose_m, radians(s.pose_deg), "poses")
        return Frame(
            index, index * 10**9, None, USED, "", b"", self.camera, s.width, s.height,
            pose=prior, spacing_m=s.spacing_m,
        )  # fmt: skip

    def _keypoint_image(self, index: int) -> KeypointImage:
        """An image whose corners are true projections and whose descriptors are the numbers of the points."""
        rows = self.visible(index)
        uv = self.project(index, self.points[rows])
        codes = np.append(rows, index).astype(np.int64)[:, None].view(np.uint8)
        pixels = np.zeros((0, 0), np.uint8)
        return KeypointImage(self.camera, pixels, uv.astype(np.float32), codes, uv)

    def _estimate(
        self,
        before: KeypointImage,
        now: KeypointImage,
        expected: MotionPrior,
        mount: Mount,
        fewest: int,
    ) -> RelativePose | None:
        """Relative pose of two images from simulated ties; parameters as of `estimate_relative_pose`."""
        (*old, first), (*new, second) = (v.descriptors.view(np.int64)[:, 0] for v in (before, now))
        shared = self.common(int(first), int(second))
        if len(shared) < max(fewest, 8):
            return None
        rows = np.column_stack([np.searchsorted(old, shared), np.searchsorted(new, shared)])
        rng, tie_px = self._rng, self.survey.tie_px
        previous = before.ideal[rows[:, 0]] + rng.normal(0, tie_px, (len(rows), 2))
        current = now.ideal[rows[:, 1]] + rng.normal(0, tie_px, (len(rows), 2))
        true = self.poses[int(second)].relative_to(self.poses[int(first)])
        size = self.survey.drift_of(self.camera, true, previous, current)
        current += size[:, None] * self._drift(current)
        gross = rng.random(len(rows)) < self.survey.outliers
        current[gross] += rng.normal(0, GROSS_TIE_PX, (int(gross.sum()), 2))
        rays = rays_of_ideal(before.camera, previous), rays_of_ideal(now.camera, current)
        coarse, _ = fit_coarse_motion(*rays, expected.prior, expected.search, now.focal_px)
        points = self.points[shared]
        growth = self.depth(int(first), points) / self.depth(int(second), points)
        warp = np.column_stack([growth, np.zeros(len(rows)), growth])
        sigma = np.zeros(len(rows))  # no patch slides along an edge
        tied = RegisteredTies(
            previous, current, rows, warp, sigma, (rows, np.column_stack([current, warp, sigma]))
        )
        pair = PairMotion(before, now, coarse.rotation, coarse.direction)
        pose = fit_relative_pose(pair, tied, expected.prior)
        return pose if pose.inliers >= fewest else None

    def _drift(self, uv: Array) -> Array:
        """A smooth random field at pixels (n, 2): Gaussian in its values, of unit scatter, and in its correlation."""
        s, rng = self.survey, self._rng
        wave = rng.normal(0, 1 / s.tie_drift_reach_px, (2, DRIFT_WAVES, 2))
        phase = rng.uniform(0, 2 * np.pi, (2, DRIFT_WAVES))
        waves = np.cos(np.einsum("nk,cwk->ncw", uv, wave) + phase).sum(axis=2)
        return np.asarray(np.sqrt(2 / DRIFT_WAVES) * waves)

    def _observe(self, index: int, pose: Pose) -> PanelObservations:
        """Panels as boxes, square and upright, with noise of centre and size."""
        s, rng = self.survey, self._rng
        local = pose.to_camera(self.signs)
        local[:, :2] += self._face
        z = np.maximum(local[:, 2], 1e-3)
        half = s.focal_px * s.panel_m / z[:, None] / 2
        uv = local[:, :2] / z[:, None] * s.focal_px + self._middle
        low, high = uv - half, uv + half
        whole = (low >= 0).all(axis=1) & (high <= [s.width - 1, s.height - 1]).all(axis=1)
        near = (z > max(LEAST_DEPTH_M, s.range_min_m)) & (z < SIGN_REACH_M)
        near &= np.abs(self.sign_station - self.station[index]) < 2 * SIGN_REACH_M
        sign = np.flatnonzero(whole & near & (2 * half[:, 0] >= SMALLEST_PX))
        sigma = s.noise_px + 2 * s.noise_share * half[sign]
        centre = uv[sign] + sigma * rng.normal(0, 1, (len(sign), 2))
        half = np.maximum(half[sign] + sigma * rng.normal(0, 1, (len(sign), 2)), 1.0)
        gross = rng.random(len(sign)) < s.outliers
        centre[gross] += rng.normal(0, GROSS_SIGN_PX, (int(gross.sum()), 2))
        box = np.column_stack([centre - half, centre + half]) + 0.5
        return PanelObservations(np.asarray(sign, np.int64), box, centre)
