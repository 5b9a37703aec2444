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

from wayside.schemas.detections import NONE, Regions
from wayside.stages.detection import BoxClassifier, regions_of
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.mapping.association import EXPECTED_PX, NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import EDGE_PX, Each, WindowFrame

SIGMA_SHARE = 0.15
"""Largest scatter of a predicted box by its height (set on the development drives)."""
SIGMA_PX = 1.0
"""Scatter that is always allowed."""


class _View(NamedTuple):
    """A predicted view: frame and row as in `LandmarkFit`, and its height in pixels."""

    frame: int
    row: int
    tall_px: float


class _Accepted(NamedTuple):
    """Views of one side that one image shows: numbers of their landmarks, heights, regions and scores."""

    back: bool
    numbers: list[int]
    tall_px: NDArray[np.float64]
    regions: Regions
    scores: NDArray[np.float32]


def add_predicted_views(
    fits: Sequence[LandmarkFit],
    window: Sequence[WindowFrame],
    classifiers: Mapping[bool, BoxClassifier],
    each: Each = map,
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
    each
        Applies a function to items, as `map`.
    """
    views: list[list[_View]] = [[] for _ in fits]

    def accepted(k: int) -> list[_Accepted]:
        held, found = window[k], []
        wanted = [
            i for i, fit in enumerate(fits) if fit.back in classifiers and k not in fit.frames
        ]
        boxes = predicted_boxes([fits[i] for i in wanted], held)
        backs = np.array([fits[i].back for i in wanted], np.bool_)[boxes.row]
        for back, classifier in sorted(classifiers.items()):
            own = boxes.select((backs == back) & classifier.takes(boxes.box, held.camera))
            if held.rgb is not None and len(own.box):
                unknown = np.full(len(own.box), NONE)
                regions = regions_of(own.box.astype(np.float32), unknown, held.rgb, "predicted")
                scores = classifier.scores(held.rgb, regions.box)
                rows = np.flatnonzero(scores >= classifier.threshold)
                numbers = [wanted[i] for i in own.row[rows]]
                found.append(
                    _Accepted(back, numbers, own.tall_px[rows], regions.select(rows), scores[rows])
                )
        return found

    for k, found in enumerate(each(accepted, range(len(window)))):
        for one in found:
            rows = window[k].add(one.regions, one.scores, back=one.back)
            for number, row, tall_px in zip(one.numbers, rows, one.tall_px, strict=True):
                views[number].append(_View(k, row, tall_px))
    return [
        _extended(fit, new, window) if new else fit for fit, new in zip(fits, views, strict=True)
    ]


class PredictedBoxes(NamedTuple):
    """Landmarks (m,), by number, with their boxes (m, 4), recorded pixels, and heights (m,) in ideal ones."""

    row: NDArray[np.int64]
    box: NDArray[np.float64]
    tall_px: NDArray[np.float64]

    def select(self, which: NDArray[np.bool_]) -> PredictedBoxes:
        """Some of them."""
        return PredictedBoxes._make(column[which] for column in self)


def predicted_boxes(fits: Sequence[LandmarkFit], frame: WindowFrame) -> PredictedBoxes:
    """Boxes of landmarks in a frame, but for those that are cut or too near, or whose scatter there is too large."""
    camera, pose = frame.camera, frame.motion.pose
    points = pose.to_camera(np.array([fit.point for fit in fits]).reshape(-1, 3))
    row = np.flatnonzero(points[:, 2] >= NEAREST_M) if frame.rgb is not None else np.zeros(0, int)
    ray, depth = points[row, :2] / points[row, 2:], points[row, 2]
    size = np.array([fits[i].metric for i in row.tolist()]).reshape(-1, 2) / depth[:, None]
    tall_px = size[:, 1] * frame.focal
    project = np.zeros((len(row), 2, 3))
    project[:, [0, 1], [0, 1]], project[:, :, 2] = 1.0, -ray
    project = project @ pose.rotation.T / depth[:, None, None]
    known = np.array([fits[i].covariance for i in row.tolist()]).reshape(-1, 3, 3)
    covariance = project @ known @ project.transpose(0, 2, 1)
    sigma_px = frame.focal * np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    corners = ray[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size[:, None] / 2
    pixels = distort_points(camera, ideal_of_rays(camera, corners.reshape(-1, 2))).reshape(-1, 4, 2)
    box = np.hstack([pixels.min(axis=1), pixels.max(axis=1)]) + 0.5
    far = np.array([camera.width, camera.height]) - EDGE_PX
    inside = (box[:, :2] >= EDGE_PX).all(axis=1) & (box[:, 2:] <= far).all(axis=1)
    sure = sigma_px <= np.maximum(SIGMA_SHARE * tall_px, SIGMA_PX)
    return PredictedBoxes(row, box, tall_px).select(inside & sure)


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
