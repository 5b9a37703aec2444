"""What a place looks like: colour, words, where it must appear in a picture, where it stands."""

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


def place_color(place: Landmark) -> tuple[int, int, int]:
    """Colour to draw a place in: its own where it is a sign."""
    return COLOR_RGB.get(place.color or "", GREY) if place.verdict == "sign" else GREY


def reprojected_box(
    place: Landmark, pose: Pose, camera: Camera
) -> tuple[float, float, float, float]:
    """Where a place's panel must appear in a picture, recorded pixels; nan behind the camera."""
    x, y, z = pose.to_camera(place.best_pose.to_world(place.position))
    if z < 0.5:
        return (np.nan,) * 4
    half = np.array([place.width_m, place.height_m]) / 2
    corners = np.array([[x - half[0], y - half[1]], [x + half[0], y + half[1]]]) / z
    ideal = corners * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    (x0, y0), (x1, y1) = distort_points(camera, ideal)
    return float(x0), float(y0), float(x1), float(y1)


def place_words(place: Landmark) -> str:
    """A place in a few words."""
    look = "back" if place.back else place.color or "?"
    return (
        f"{look} {place.shape or '?'} {place.width_m:.2f} x {place.height_m:.2f} m, "
        f"{place.verdict}, track {place.track_id}"
    )


def rejection(place: Landmark) -> str:
    """Why a place is no sign, in words with the numbers that decided."""
    return (
        f"{place.verdict}: {place_words(place)}; "
        f"{place.right_m:+.1f} m right, {place.above_m:+.1f} m above the camera, "
        f"station {place.station_m:.1f} m, {len(place.views)} views, score {place.score:.1f}, "
        f"residual {place.residual_px:.2f} px"
    )


def place_points(places: list[Landmark]) -> rr.Points3D:
    """Places as points of the drive's frame, with words."""
    return rr.Points3D(
        np.array([p.best_pose.to_world(p.position) for p in places]).reshape(-1, 3),
        colors=[place_color(p) for p in places] or None,
        labels=[place_words(p) for p in places] or None,
        show_labels=False,
        radii=0.25,
    )


def cross_section(places: list[Landmark], names: list[str] | None = None) -> rr.Points2D:
    """Places in the plane across the road, with words or names."""
    # The plane across the road as a picture: right is right, up is up (pictures count downwards).
    return rr.Points2D(
        np.array([(p.right_m, -p.above_m) for p in places]).reshape(-1, 2),
        colors=[place_color(p) for p in places] or None,
        labels=names or [place_words(p) for p in places] or None,
        show_labels=False,
        radii=rr.Radius.ui_points(4),
    )
