"""Predicted views: boxes that a fitted landmark must have in other images, classified where no candidate was found.

Candidates miss a face now and then: against a pale sky, behind a branch, far away. Two views place a landmark to a
pixel or two in the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import NONE
from wayside.stages.detection import BoxClassifier, regions_of
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.mapping.association import EXPECTED_PX, NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import EDGE_PX, WindowFrame

SIGMA_SHARE = 0.15
"""Largest scatter of a predicted box by its height (set on the development drives)."""
SIGMA_PX = 1.0
"""Scatter that is always allowed."""


class _View(NamedTuple):
    """A predicted view: frame and row as in `LandmarkFit`, and its height in pixels."""

    frame: int
    row: int
    tall_px: float


def add_predicted_views(
    fits: Sequence[LandmarkFit],
    window: Sequence[WindowFrame],
    classifiers: Mapping[bool, BoxClassifier],
) -> list[LandmarkFit]:
    """Add to each landmark the predicted views that a classifier accepts.

    The views are added to the frames' candidates, source `predicted`. They count as seen, but do not move the point,
    which predicted them.

    Parameters
    ----------
    fits, window
        Landmarks and the frames that they refer to, which get the new candidates.
    classifiers
        Classifier of one view, of faces (False) and of backs (True); without one none is predicted.
    """
    views: list[list[_View]] = [[] for _ in fits]
    for k, held in enumerate(window):
        for back, classifier in sorted(classifiers.items()):
            found = [
                (number, *one)
                for number, fit in enumerate(fits)
                if fit.back == back
                and k not in fit.frames
                and (one := predicted_box(fit, held)) is not None
                and classifier.takes(one[0], held.camera)
            ]
            levels = held.image_pyramid() if found else None
            if levels is None:
                continue
            boxes = np.array([box for _, box, _ in found], np.float32)
            unknown = np.full(len(found), NONE)
            regions = regions_of(boxes, unknown, levels[0], "predicted")
            scores = classifier.scores(levels, regions.box).tolist()
            for i, ((number, _, tall_px), score) in enumerate(zip(found, scores, strict=True)):
                if score >= classifier.threshold:
                    row = held.add(regions.select(np.array([i])), score, back=back)
                    views[number].append(_View(k, row, tall_px))
    return [
        _extended(fit, new, window) if new else fit for fit, new in zip(fits, views, strict=True)
    ]


def predicted_box(fit: LandmarkFit, frame: WindowFrame) -> tuple[NDArray[np.float64], float] | None:
    """Box (4,) of a landmark in a frame, recorded pixels, and its height in ideal ones.

    None where it is cut or too near, or its scatter there is too large.
    """
    camera, pose = frame.camera, frame.motion.pose
    x, y, z = pose.to_camera(fit.point)
    if frame.rgb is None or z < NEAREST_M:
        return None
    wide, tall = fit.metric / 2
    tall_px = 2 * tall / z * frame.focal
    project = np.array([[1, 0, -x / z], [0, 1, -y / z]]) @ pose.rotation.T / z
    covariance = project @ fit.covariance @ project.T
    sigma_px = frame.focal * float(np.sqrt(np.linalg.norm(covariance, 2)))
    if sigma_px > max(SIGMA_SHARE * tall_px, SIGMA_PX):
        return None
    corners = np.array([x, y]) + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [wide, tall]
    pixels = distort_points(camera, ideal_of_rays(camera, corners / z))
    low, high = pixels.min(axis=0) + 0.5, pixels.max(axis=0) + 0.5
    if (low < EDGE_PX).any() or (high > np.array([camera.width, camera.height]) - EDGE_PX).any():
        return None
    return np.concatenate([low, high]), float(tall_px)


def _extended(fit: LandmarkFit, new: Sequence[_View], window: Sequence[WindowFrame]) -> LandmarkFit:
    """The landmark with new views."""
    added: dict[str, Any] = {
        "frames": [view.frame for view in new],
        "rows": [view.row for view in new],
        "used": [False] * len(new),
        "residual_px": [0.0] * len(new),
        "depth": [window[v.frame].motion.pose.to_camera(fit.point)[2] for v in new],
        "weight_sigma": [1.0] * len(new),
        "ray_sigma": [1.0] * len(new),
    }
    order = np.argsort([*fit.frames, *added["frames"]], kind="stable")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(fit, name), values])[order].astype(getattr(fit, name).dtype)
        for name, values in added.items()
    }
    missed = max(fit.missed - sum(view.tall_px >= EXPECTED_PX for view in new), 0)
    return replace(fit, missed=missed, **columns)
