"""Predicted views: boxes that a fitted landmark must have in other images, classified where no candidate was found.

Candidates miss a face now and then: against a pale sky, behind a branch, far away. Two views place a landmark to a
pixel or two in the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Regions
from wayside.stages.detection import BoxClassifier
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.mapping.association import EXPECTED_PX, NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame

SIGMA_SHARE = 0.15
"""Largest scatter of a predicted box by its height (set on the development drives)."""
SIGMA_PX = 1.0
"""Scatter that is always allowed."""


class _PredictedBox(NamedTuple):
    """A box of one landmark in one frame: number of the landmark, box (4,) in recorded pixels, height in ideal ones."""

    landmark: int
    box: NDArray[np.float64]
    tall_px: float


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
    wanted: dict[tuple[int, bool], list[_PredictedBox]] = {}
    for number, fit in enumerate(fits):
        if fit.back not in classifiers:
            continue
        for frame in sorted(set(range(len(window))) - set(fit.frames.tolist())):
            seen = window[frame]
            found = predicted_box(fit, seen)
            if found is not None and classifiers[fit.back].takes(found[0], seen.camera):
                wanted.setdefault((frame, fit.back), []).append(_PredictedBox(number, *found))
    views: list[list[_View]] = [[] for _ in fits]
    for (frame, back), boxes in sorted(wanted.items()):
        classifier, regions = classifiers[back], _regions(boxes, fits, window)
        scores = _scores(window[frame], regions, classifier)
        for k, (one, score) in enumerate(zip(boxes, scores.tolist(), strict=True)):
            if score >= classifier.threshold:
                row = window[frame].add(regions.select(np.array([k])), score, back=back)
                views[one.landmark].append(_View(frame, row, one.tall_px))
    return [
        _extended(fit, new, window) if new else fit for fit, new in zip(fits, views, strict=True)
    ]


def predicted_box(fit: LandmarkFit, frame: WindowFrame) -> tuple[NDArray[np.float64], float] | None:
    """Box (4,) of a landmark in a frame, recorded pixels, and its height in ideal ones.

    None where it is cut or too near, or its scatter there is too large.
    """
    camera, pose = frame.camera, frame.motion.pose
    x, y, z = pose.to_camera(fit.point)
    wide, tall = fit.metric / 2
    if frame.rgb is None or z < NEAREST_M:
        return None
    tall_px = 2 * tall / z * frame.focal
    project = np.array([[1, 0, -x / z], [0, 1, -y / z]]) @ pose.rotation.T / z
    covariance = project @ fit.covariance @ project.T
    sigma_px = frame.focal * float(np.sqrt(np.linalg.norm(covariance, 2)))
    if sigma_px > max(SIGMA_SHARE * tall_px, SIGMA_PX):
        return None
    corners = np.array(
        [[x - wide, y - tall], [x + wide, y - tall], [x + wide, y + tall], [x - wide, y + tall]]
    )
    pixels = distort_points(camera, ideal_of_rays(camera, corners / z))
    low, high = pixels.min(axis=0) + 0.5, pixels.max(axis=0) + 0.5
    if (low < 1).any() or high[0] > camera.width - 1 or high[1] > camera.height - 1:
        return None
    return np.concatenate([low, high]), float(tall_px)


def _regions(
    boxes: Sequence[_PredictedBox], fits: Sequence[LandmarkFit], window: Sequence[WindowFrame]
) -> Regions:
    """The boxes as regions, filled and coloured like the landmark's nearest view."""
    area, rgb = [], []
    for one in boxes:
        fit = fits[one.landmark]
        nearest = int(fit.depth.argmin())
        frame = window[fit.frames[nearest]]
        row = frame.followed[fit.rows[nearest]]
        region = frame.candidates.regions
        x0, y0, x1, y1 = region.box[row]
        fill = float(region.area_px[row]) / max(float((x1 - x0) * (y1 - y0)), 1.0)
        u0, v0, u1, v1 = one.box
        area.append(fill * (u1 - u0) * (v1 - v0))
        rgb.append(region.rgb[row])
    return Regions(
        np.array([one.box for one in boxes], np.float32),
        np.array(area).astype(np.int32),
        np.array(rgb, np.float32),
        np.full(len(boxes), SOURCES.index("predicted"), np.uint8),
    )


def _scores(frame: WindowFrame, regions: Regions, classifier: BoxClassifier) -> NDArray[np.float32]:
    levels = frame.image_pyramid()
    if levels is None:
        return np.full(len(regions), -np.inf, np.float32)
    return classifier.scores(levels, regions.box)


def _extended(fit: LandmarkFit, new: Sequence[_View], window: Sequence[WindowFrame]) -> LandmarkFit:
    """The landmark with new views."""
    added = np.array([view.frame for view in new], np.int64)
    depth = np.array([window[f].motion.pose.to_camera(fit.point)[2] for f in added])
    order = np.argsort(np.concatenate([fit.frames, added]), kind="stable")
    none = np.zeros(len(added))

    def ordered(known: NDArray[np.float64], more: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([known, more])[order]

    return replace(
        fit,
        frames=np.concatenate([fit.frames, added])[order],
        rows=np.concatenate([fit.rows, [view.row for view in new]])[order],
        used=np.concatenate([fit.used, np.zeros(len(added), np.bool_)])[order],
        residual_px=ordered(fit.residual_px, none),
        depth=ordered(fit.depth, depth),
        weight_sigma=ordered(fit.weight_sigma, none + 1.0),
        ray_sigma=ordered(fit.ray_sigma, none + 1.0),
        missed=max(fit.missed - sum(view.tall_px >= EXPECTED_PX for view in new), 0),
    )
