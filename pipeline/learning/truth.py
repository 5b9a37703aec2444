"""What the truth of a rendered drive says of its images: faces, places of signs, labels of boxes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.fits import PLACE_FLOOR, SIDES, moments, sides
from wayside.pipeline.learning.labelled import (
    ANY_SPACING_M,
    FACE_FRACTION,
    FACE_PX,
    NEAR_FACE,
    NEITHER,
    OFF,
    ON,
    ON_FACE,
)
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.schemas.settings import ReadSettings
from wayside.stages.geometry import intersection_areas, iou_matrix

TIGHT, INSIDE, UNION = 0.6, 0.85, 0.8
"""Overlap (IoU) from which a box is tight on a face; fraction of a box from which it lies inside one; overlap from
which a box that shows a second face as well is no example rather than a bad one."""

SHOWN, APART = 0.5, 0.3
"""Fraction of a second face in a box from which the box shows it; fraction of the smaller of two faces that both may
share: more, and one lies on the other."""

LEARN_READ = ReadSettings(thin_m=0.0, spacing_m=ANY_SPACING_M)
"""Every image."""

FEWEST_SIGNS = 4
"""A side of the road of fewer signs is not learned."""

SignViews = list[tuple[dict[str, Any], dict[str, Any]]]
"""Signs of which an image shows the front (or the back), each with its view there (box, visible fraction)."""


def visible_fraction(view: dict[str, Any]) -> float:
    """Fraction of a face that is visible in a view."""
    return float(view["visible_fraction"] or 0.0)


def height_px(view: dict[str, Any]) -> float:
    """Height of a face in a view, pixels."""
    return float(view["box"][3] - view["box"][1])


def read_truth(path: Path) -> dict[str, Any]:
    """Truth of a rendered drive; raises InputError for other files."""
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
        if not {"name", "camera", "frames", "signs"} <= truth.keys():
            raise KeyError("name, camera, frames or signs")
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise InputError(
            f"{path}: this is not the truth of a rendered drive: {type(error).__name__}: {error}. Render the drive "
            "again with masks."
        ) from error
    return dict(truth)


def views_by_frame(truth: dict[str, Any]) -> tuple[dict[int, SignViews], dict[int, SignViews]]:
    """What each frame of a rendered drive shows: signs that face the travel, and panels from behind."""
    seen: dict[int, SignViews] = {}
    behind: dict[int, SignViews] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            if sign["faces_travel"]:
                seen.setdefault(view["frame"], []).append((sign, view))
            if view["side"] == "back":
                behind.setdefault(view["frame"], []).append((sign, view))
    return seen, behind


def sign_positions(truth: dict[str, Any]) -> NDArray[np.float64]:
    """Right of the path and above the camera's path of the signs that face the travel, (n, 2) metres."""
    height = truth["camera"]["mount"]["height_m"]
    rows = [
        (sign["lateral_m"], sign["up_m"] - height)
        for sign in truth["signs"]
        if sign["faces_travel"] and sign["eligible_frames"] > 0
    ]
    return np.array(rows, np.float64).reshape(-1, 2)


def box_labels(
    box: NDArray[np.float32], views: SignViews
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Labels (n,) of the boxes (n, 4) of an image by the panels that it shows, and their overlap (n,) with the nearest.

    The visible fraction of a back is unknown.
    """
    if not views:
        return np.full(len(box), OFF, np.int8), np.zeros(len(box))
    panels = np.array([view["box"] for _, view in views], np.float64)
    is_example = [
        height_px(view) >= FACE_PX
        and (view.get("side") == "back" or visible_fraction(view) >= FACE_FRACTION)
        for _, view in views
    ]
    overlap = iou_matrix(box, panels).max(axis=1, initial=0)
    return face_labels(box, panels, np.array(is_example)), overlap


def face_labels(
    box: NDArray[np.floating[Any]], faces: NDArray[np.floating[Any]], is_example: NDArray[np.bool_]
) -> NDArray[np.int8]:
    """Label (n,) of each box (n, 4): `ON` a face (m, 4), `OFF` all, or `NEITHER`.

    A face is its whole panel. Where a tight box is on it, a looser one is not an example. A box that shows only a part
    of it, or a second face as well, is not either: a classifier that accepts both loses the plaque below a sign. Faces
    that are no example (m,) bool make none of the boxes near them.
    """
    overlap = iou_matrix(box, faces)
    shared = intersection_areas(box, faces)
    best = overlap.argmax(axis=1)
    rows = np.arange(len(box))
    nearest = overlap[rows, best]
    tight = overlap.max(axis=0)[best] >= TIGHT
    label = np.where(nearest >= NEAR_FACE, NEITHER, OFF).astype(np.int8)
    label[(nearest >= np.where(tight, TIGHT, ON_FACE)) & is_example[best]] = ON
    own = np.prod(box[:, 2:] - box[:, :2], axis=1)
    part = (shared[rows, best] > INSIDE * own) & (nearest < ON_FACE)
    label[part & tight & is_example[best]] = OFF
    second = (second_faces(box, faces, best) & is_example).any(axis=1)
    label[second & (nearest < UNION) & tight] = OFF
    label[second & (nearest >= UNION)] = NEITHER
    return label


def second_faces(
    box: NDArray[np.floating[Any]], faces: NDArray[np.floating[Any]], nearest: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """Which faces (m, 4) each box (n, 4) shows besides its `nearest` (n,), and that do not lie on that: (n, m)."""
    area = np.prod(faces[:, 2:] - faces[:, :2], axis=1)
    apart = intersection_areas(faces, faces) < APART * np.minimum(area[:, None], area[None])
    shown = intersection_areas(box, faces) > SHOWN * area
    return np.asarray(shown & apart[nearest])


def location_model(places: NDArray[np.float64], provenance: str) -> GaussianModel:
    """Where signs stand, (right of the path, above the camera's path) in metres: the mixture of preset `default`.

    places (n, 2): of signs. Overhead panels hang 4 m above the camera or higher; the rest stands right or left. A
    component holds all of its own signs within 4 sigma, because the next sign may lie beyond the last one seen. Those
    of preset `report` are learned by `gates`.
    """
    side, classes = sides(places, 4.0), []
    for name in SIDES:
        own = side == name
        if own.sum() < FEWEST_SIGNS:
            continue
        mean, covariance = moments(
            places[own], np.full(own.sum(), 1 / own.sum()), np.array(PLACE_FLOOR)
        )
        if name == "overhead":
            # Over any lane: three lanes either way are as likely as the middle.
            mean[0], covariance = 0.0, np.diag([5.0**2, covariance[1, 1]])
        rule = "four sigma, drawn only: no gate asks for it"
        classes.append(GaussianClass(name, mean, covariance, 4.0, rule, int(own.sum())))
    return GaussianModel("right_up_m", tuple(classes), provenance)
