"""Whether recorded poses belong to the camera. They are compared with the motion in the images.

Two images give the rotation between them and the direction of travel, without its length (report chapter 7; Nistér
2004). Poses in other axes, of the vehicle instead of the camera, or inverted, contradict them by a right angle or more.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from wayside.schemas.frame import EARTH_RADIUS_M
from wayside.schemas.settings import MotionSettings
from wayside.stages.geometry import rays_of_ideal
from wayside.stages.kernels import Array
from wayside.stages.odometry.tie_points import COARSE_RATIO, KeypointImage, match_around
from wayside.stages.odometry.visual_odometry import shows_no_motion

_REACH_SHARE = 0.12
"""Corners are matched up to this share of the image's width away: further ones are few and near the border."""
_INLIER_PX, _FEWEST_INLIERS, _INLIER_SHARE = 1.0, 40, 0.3
_FEWEST_AHEAD = 15
"""Points near enough that they are seen to lie before both cameras, and so tell forward from backward."""
_PARALLAX_PX = 2.0
"""Corners that have moved by so much, apart from rotation, tell the direction."""
_DIRECTION_DEG, _ROTATION_DEG = 20.0, 4.0
"""Errors of a sound step: of a camera not quite mounted as stated, and of two images a few metres apart."""
_ROTATION_WEIGHT = 4.0
_STANDS_M = 0.05
"""A step of poses that is shorter tells no direction, and contradicts images that show motion."""
_AGREE_SHARE, _FEWEST_STEPS = 0.7, 3
_UPRIGHT_COSINE = np.cos(np.radians(35.0))
"""A camera of a vehicle is upright within this angle, hills and its pitch included."""
_EARTH_CENTRED_M = 0.9 * EARTH_RADIUS_M, 1.1 * EARTH_RADIUS_M
"""Distances from the origin of a world whose origin is the centre of the earth."""


class ImageStep(NamedTuple):
    """What two images show of the motion between them: rows of both, and the second camera in the first one's axes."""

    first: int
    second: int
    rotation: Array
    """(3, 3)."""
    direction: Array
    """(3,) of travel, unit."""


def image_step(
    rows: tuple[int, int], before: KeypointImage, now: KeypointImage, motion: MotionSettings
) -> ImageStep | None:
    """The motion between two images by their corners alone; None where they show none, or too little to tell."""
    if shows_no_motion(before, now, motion) or not (len(before.corners) and len(now.corners)):
        return None
    reach_px = _REACH_SHARE * before.grey.shape[1]
    pairs = match_around(before, now, reach_px, COARSE_RATIO)
    if len(pairs) < _FEWEST_INLIERS:
        return None
    first = rays_of_ideal(before.camera, before.ideal[pairs[:, 0]])
    second = rays_of_ideal(now.camera, now.ideal[pairs[:, 1]])
    tolerance = _INLIER_PX / now.focal_px
    essential, inlier = cv2.findEssentialMat(
        first, second, np.eye(3), method=cv2.USAC_MAGSAC, prob=0.99, threshold=tolerance
    )
    if essential is None or essential.shape != (3, 3):
        return None
    count, rotation, shift, _ = cv2.recoverPose(
        essential, first, second, np.eye(3), mask=inlier.copy()
    )
    held = inlier.ravel() > 0
    if held.sum() < max(_FEWEST_INLIERS, _INLIER_SHARE * len(pairs)) or count < _FEWEST_AHEAD:
        return None
    back = np.column_stack([second[held], np.ones(held.sum())]) @ rotation
    moved = np.linalg.norm(back[:, :2] / back[:, 2:] - first[held], axis=1) * now.focal_px
    if (moved > _PARALLAX_PX).sum() < _FEWEST_INLIERS:
        return None
    back_turn = np.asarray(rotation.T, np.float64)
    return ImageStep(*rows, back_turn, np.asarray(-back_turn @ shift.ravel(), np.float64))


@dataclass(frozen=True, slots=True)
class CameraPath:
    """Poses at images: known (k,), rotation (k, 3, 3) from camera to world axes, centre (k, 3) in metres."""

    known: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    rotation: Array
    centre: Array

    def mounted(self, mount: Array) -> "CameraPath":
        """The same of a camera whose axes are the columns of `mount` (3, 3) in the axes of these poses."""
        return CameraPath(self.known, self.rotation @ mount, self.centre)

    def inverted(self) -> "CameraPath":
        """The poses of a source that states the world in the camera."""
        back = self.rotation.transpose(0, 2, 1)
        return CameraPath(self.known, back, -np.einsum("kij,kj->ki", back, self.centre))


class Agreement(NamedTuple):
    """How poses fit the steps of images; medians in degrees, nan without steps."""

    steps: int
    agree: int
    direction_deg: float
    rotation_deg: float

    @property
    def tells(self) -> bool:
        """Whether there are enough steps to say anything."""
        return self.steps >= _FEWEST_STEPS

    @property
    def error_deg(self) -> float:
        """Both errors in one: rotations of a step are measured several times as well as its direction."""
        return self.direction_deg + _ROTATION_WEIGHT * self.rotation_deg

    @property
    def agrees(self) -> bool:
        """Whether the poses can be those of the camera."""
        return self.agree >= _AGREE_SHARE * self.steps


def agreement(steps: list[ImageStep], path: CameraPath) -> Agreement:
    """Compare poses with what images show, in the axes of the first camera of each step."""
    errors = []
    for step in steps:
        i, k = step.first, step.second
        if not (path.known[i] and path.known[k]):
            continue
        shift = (path.centre[k] - path.centre[i]) @ path.rotation[i]
        length = float(np.linalg.norm(shift))
        turn = path.rotation[i].T @ path.rotation[k] @ step.rotation.T
        aside = 180.0 if length < _STANDS_M else _angle_deg(shift @ step.direction / length)
        errors.append((aside, _angle_deg((np.trace(turn) - 1) / 2)))
    if not errors:
        return Agreement(0, 0, float("nan"), float("nan"))
    error = np.array(errors)
    sound = (error[:, 0] < _DIRECTION_DEG) & (error[:, 1] < _ROTATION_DEG)
    return Agreement(len(error), int(sound.sum()), *np.median(error, axis=0).tolist())


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


AXES = {
    "x forward, y left, z up": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    "x forward, y right, z down": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "x right, y forward, z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "x right, y up, z backward": np.diag([1.0, -1.0, -1.0]),
}
"""Axes that poses come in instead of the camera's: its own axes (columns) in them, where it looks straight ahead."""


def upright(path: CameraPath) -> tuple[CameraPath, str]:
    """The poses in a world whose z axis points up, and which way up was; "z" where it was that, "" where none is.

    The camera is upright on its vehicle: its own up is the up of the world. About the centre of the earth ("earth"), up
    is outward; such poses come as east, north, up at the first.
    """
    rows = np.flatnonzero(path.known)
    if not len(rows):
        return path, "z"
    radius = np.linalg.norm(path.centre[rows], axis=1)
    if _EARTH_CENTRED_M[0] < radius.min() and radius.max() < _EARTH_CENTRED_M[1]:
        return _turned(path, _east_north_up(path.centre[rows[0]]), path.centre[rows[0]]), "earth"
    up = -path.rotation[rows, :, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) < _UPRIGHT_COSINE:
        return path, ""
    name = ("" if up[axis] > 0 else "-") + "xyz"[axis]
    return (path if name == "z" else _turned(path, _UP[name], np.zeros(3))), name


_UP = {
    "-z": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "-y": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]) @ np.diag([1.0, -1.0, 1.0]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
"""Rotations that bring each other up to z; north, east, down becomes east, north, up."""


def _turned(path: CameraPath, rotation: Array, origin: Array) -> CameraPath:
    return CameraPath(path.known, rotation @ path.rotation, (path.centre - origin) @ rotation.T)


def _east_north_up(place: Array) -> Array:
    """Axes (rows) at an earth-centred position, level on the ellipsoid of WGS 84 to a thousandth of a degree."""
    squash = (6_378_137.0 / 6_356_752.314245) ** 2
    up = place * [1.0, 1.0, squash]
    up /= np.linalg.norm(up)
    east = np.array([-up[1], up[0], 0.0]) / np.hypot(up[0], up[1])
    return np.stack([east, np.cross(up, east), up])
