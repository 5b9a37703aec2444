"""How a landmark is shown: colour, words, its box in an image, its position."""

from __future__ import annotations

import numpy as np
import rerun as rr

from wayside.schemas.detections import COLOR_RGB, COLORS
from wayside.schemas.frame import Camera, Pose
from wayside.schemas.landmarks import Landmark
from wayside.stages.geometry import distort_points

GREY = (150, 150, 150)
"""Of what is no sign, or has no colour."""


def color_of(code: int) -> tuple[int, int, int]:
    """Colour to draw a class in; grey for none."""
    return COLOR_RGB[COLORS[code]] if code >= 0 else GREY


def landmark_color(landmark: Landmark) -> tuple[int, int, int]:
    """Colour to draw a landmark in: its own where it is a sign."""
    return COLOR_RGB.get(landmark.color or "", GREY) if landmark.verdict == "sign" else GREY


def reprojected_box(
    landmark: Landmark, pose: Pose, camera: Camera
) -> tuple[float, float, float, float]:
    """Box of a landmark's panel projected into an image, recorded pixels; nan behind the camera."""
    x, y, z = pose.to_camera(landmark.best_pose.to_world(landmark.position))
    if z < 0.5:
        return (np.nan,) * 4
    half = np.array([landmark.width_m, landmark.height_m]) / 2
    corners = np.array([[x - half[0], y - half[1]], [x + half[0], y + half[1]]]) / z
    ideal = corners * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    (x0, y0), (x1, y1) = distort_points(camera, ideal)
    return float(x0), float(y0), float(x1), float(y1)


def landmark_words(landmark: Landmark) -> str:
    """A landmark in a few words."""
    kind = "back" if landmark.back else landmark.color or "?"
    return (
        f"{kind} {landmark.shape or '?'} {landmark.width_m:.2f} x {landmark.height_m:.2f} m, "
        f"{landmark.verdict}, track {landmark.track_id}"
    )


def rejection(landmark: Landmark) -> str:
    """Why a landmark is no sign, in words with the numbers that decided."""
    score = f"score {landmark.score:.1f}, " if np.isfinite(landmark.score) else ""
    return (
        f"{landmark.verdict}: {landmark_words(landmark)}; "
        f"{landmark.right_m:+.1f} m right, {landmark.above_m:+.1f} m above the camera, "
        f"station {landmark.station_m:.1f} m, {len(landmark.views)} views, {score}"
        f"residual {landmark.residual_px:.2f} px{evidence_words(landmark)}"
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
        radii=0.25,
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
