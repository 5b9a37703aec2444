"""How a landmark is shown: colour, words, its box in an image, its position."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayside.schemas.detections import COLOR_RGB, COLORS
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.landmarks import Landmark
from wayside.stages.geometry import distort_points
from wayside.stages.panel import face_corners

GREY = (150, 150, 150)
"""Of what is no sign, or has no colour."""
MARK = rr.Radius.ui_points(6)
"""Of a landmark in space: on the screen the same from any distance, where a panel of 0.7 m is a few pixels."""
THIN, HAIR = rr.Radius.ui_points(1.5), rr.Radius.ui_points(0.75)
PIXEL_CENTRE = 0.5
"""Where the viewer has the centre of the first pixel, which is 0 elsewhere."""
_NEAREST_M = 0.5


def color_of(code: int) -> tuple[int, int, int]:
    """Colour to draw a class in; grey for none."""
    return COLOR_RGB[COLORS[code]] if code >= 0 else GREY


def landmark_color(landmark: Landmark) -> tuple[int, int, int]:
    """Colour to draw a landmark in: its own where it is a sign."""
    return COLOR_RGB.get(landmark.color or "", GREY) if landmark.verdict == "sign" else GREY


def panel_rotation(landmark: Landmark) -> NDArray[np.float64]:
    """Axes (3, 3) of a landmark's panel in the drive's frame: right, down, away; facing the camera where not known."""
    angle = np.radians(np.nan_to_num(landmark.facing_deg))
    about_down = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    return np.asarray(landmark.best_pose.rotation @ about_down)


def face_in_image(landmark: Landmark, pose: Pose, camera: Camera) -> NDArray[np.float64]:
    """The outline of a landmark's face projected into an image, closed.

    Returns
    -------
    Points (n, 2) in the viewer's pixels, which count from the upper left corner of the image; (0, 2) where a corner
    is behind the camera.
    """
    half = np.array([landmark.width_m, landmark.height_m]) / 2
    flat = face_corners(landmark.shape) * half
    offsets = np.column_stack([flat, np.zeros(len(flat))]) @ panel_rotation(landmark).T
    centre = landmark.best_pose.to_world(landmark.position)
    local = pose.to_camera(centre + offsets)
    if (local[:, 2] < _NEAREST_M).any():
        return np.zeros((0, 2))
    ideal = local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    pixels = distort_points(camera, ideal) + PIXEL_CENTRE
    return np.concatenate([pixels, pixels[:1]])


def landmark_words(landmark: Landmark) -> str:
    """A landmark in a few words."""
    return f"{_appearance(landmark)}, {landmark.verdict}, track {landmark.track_id}"


def _appearance(landmark: Landmark) -> str:
    kind = "back" if landmark.back else (landmark.color or "?").replace("_", " ")
    return f"{kind} {landmark.shape or '?'} {landmark.width_m:.2f} x {landmark.height_m:.2f} m"


def rejection(landmark: Landmark) -> str:
    """Why a landmark is no sign, in words; the numbers that decided come first, as a narrow list cuts the rest."""
    score = f"; score {landmark.score:.1f}" if np.isfinite(landmark.score) else ""
    return (
        f"{landmark.verdict}: {_appearance(landmark)}{score}{evidence_words(landmark)}; "
        f"{landmark.right_m:+.1f} m right, {landmark.above_m:+.1f} m above the camera, "
        f"station {landmark.station_m:.1f} m, {len(landmark.views)} views, "
        f"residual {landmark.residual_px:.2f} px, track {landmark.track_id}"
    )


def evidence_words(landmark: Landmark) -> str:
    """Log-likelihood ratio of each term, the weakest first; empty where none was weighed."""
    weakest_first = sorted(landmark.evidence, key=lambda term: term[1])
    return "".join(f", {term} {ratio:+.1f}" for term, ratio in weakest_first)


def landmark_points(landmarks: list[Landmark]) -> rr.Points3D:
    """Landmarks as points of the drive's frame, with words."""
    return rr.Points3D(
        np.array([p.best_pose.to_world(p.position) for p in landmarks]).reshape(-1, 3),
        colors=[landmark_color(p) for p in landmarks] or None,
        labels=[landmark_words(p) for p in landmarks] or None,
        show_labels=False,
        radii=rr.Radius.ui_points(3),
    )


def cross_section(landmarks: list[Landmark], names: list[str] | None = None) -> rr.Points2D:
    """Landmarks in the plane across the road, with words or names."""
    # The plane across the road as an image: right is right, up is up (images count downwards).
    return rr.Points2D(
        np.array([(p.right_m, -p.above_m) for p in landmarks]).reshape(-1, 2),
        colors=[landmark_color(p) for p in landmarks] or None,
        labels=names or [landmark_words(p) for p in landmarks] or None,
        show_labels=False,
        radii=rr.Radius.ui_points(4),
    )
