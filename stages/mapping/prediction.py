"""Predicted views: boxes that a fitted landmark must have in other images, classified where no candidate was found.

Candidates miss a face now and then: against a pale sky, behind a branch, far away. Two views place a landmark to a
pixel or two in the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.stages.detection import BoxClassifier, fits_face
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.mapping.association import EXPECTED_PX, NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import WindowFrame, WindowPoses, is_whole, joined

SIGMA_SHARE = 0.15
"""Largest scatter of a predicted box by its height (set on the development drives)."""
SIGMA_PX = 1.0
"""Scatter that is always allowed."""


def add_predicted_views(
    fits: Sequence[LandmarkFit],
    window: Sequence[WindowFrame],
    classifiers: Mapping[bool, BoxClassifier],
) -> list[LandmarkFit]:
    """Add to each landmark the predicted views that a classifier accepts.

    The views are added to the frames' candidates, source `predicted`. They count as seen, but do not move the point,
    which predicted them.

    `classifiers`: of one view, of faces (False) and of backs (True); without one none is predicted.
    """
    landmark, frame, box = predicted_boxes(fits, window)
    back = np.array([fit.back for fit in fits], np.bool_)[landmark]
    score, good = np.zeros(len(box), np.float32), np.zeros(len(box), np.bool_)
    for side, one in classifiers.items():
        own = [np.flatnonzero((frame == k) & (back == side)) for k in range(len(window))]
        images = [(h.rgb, r) for h, r in zip(window, own, strict=True) if len(r)]
        shown = [(rgb, box[rows]) for rgb, rows in images if rgb is not None]
        if shown:
            rows = np.concatenate([rows for rgb, rows in images if rgb is not None])
            score[rows] = one.scores(shown)
            good[rows] = score[rows] >= one.model.threshold
    views: list[list[tuple[int, int]]] = [[] for _ in fits]
    for k, side in sorted(set(zip(frame[good].tolist(), back[good].tolist(), strict=True))):
        rows = np.flatnonzero(good & (frame == k) & (back == side))
        added = window[k].add(box[rows], score[rows], back=side)
        for number, row in zip(landmark[rows].tolist(), added, strict=True):
            views[number].append((k, row))
    return [
        _extended(fit, new, window) if new else fit for fit, new in zip(fits, views, strict=True)
    ]


def predicted_boxes(
    fits: Sequence[LandmarkFit], window: Sequence[WindowFrame]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Landmark (m,), frame (m,), ascending, and box (m, 4), px, where a frame has no candidate of a landmark.

    But for those that are cut, too near, or no face by their size, or whose scatter there is too large.
    """
    _, rotation, centre = WindowPoses.of(window)
    point, metric = (np.array([getattr(f, name) for f in fits]) for name in ("point", "metric"))
    new = np.ones((len(window), len(fits)), np.bool_)
    for number, fit in enumerate(fits):
        new[fit.frames, number] = False
    local = (point.reshape(1, -1, 3) - centre[:, None]) @ rotation
    frame, landmark = np.nonzero(new & (local[..., 2] >= NEAREST_M))
    ray, depth = local[frame, landmark, :2], local[frame, landmark, 2:]
    ray, size = ray / depth, metric.reshape(-1, 2)[landmark] / depth
    project = np.zeros((len(ray), 2, 3))
    project[:, [0, 1], [0, 1]], project[:, :, 2] = 1.0, -ray
    project = project @ rotation[frame].transpose(0, 2, 1) / depth[:, None]
    known = np.array([fit.covariance for fit in fits]).reshape(-1, 3, 3)[landmark]
    covariance = project @ known @ project.transpose(0, 2, 1)
    focal = np.array([held.focal for held in window])[frame]
    sigma_px = focal * np.sqrt(np.linalg.eigvalsh(covariance)[:, 1])
    good = sigma_px <= np.maximum(SIGMA_SHARE * size[:, 1] * focal, SIGMA_PX)
    corners = ray[:, None] + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size[:, None] / 2
    box = np.zeros((len(ray), 4))
    for camera in {held.camera for held in window}:
        own = np.flatnonzero(good & np.array([held.camera == camera for held in window])[frame])
        ideal = ideal_of_rays(camera, corners[own].reshape(-1, 2))
        pixels = distort_points(camera, ideal).reshape(-1, 4, 2)
        box[own] = np.hstack([pixels.min(axis=1), pixels.max(axis=1)]) + 0.5
        good[own] = is_whole(box[own], camera) & fits_face(box[own], camera)
    return landmark[good], frame[good], box[good].astype(np.float32)


def _extended(
    fit: LandmarkFit, new: Sequence[tuple[int, int]], window: Sequence[WindowFrame]
) -> LandmarkFit:
    """The landmark with new views: frame and row of each."""
    frames, rows = zip(*new, strict=True)
    depth = np.array([window[k].motion.pose.to_camera(fit.point)[2] for k in frames])
    none, one = np.zeros(len(new)), np.ones(len(new))
    seen = joined(window[k].followed[row : row + 1] for k, row in new)
    added = {"frames": frames, "rows": rows, "used": none, "residual_px": none}
    added |= {"depth": depth, "weight_sigma": one, "ray_sigma": one}
    order = np.argsort([*fit.frames, *frames], kind="stable")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(fit, name), values])[order].astype(getattr(fit, name).dtype)
        for name, values in added.items()
    }
    tall_px = fit.metric[1] / depth * [window[k].focal for k in frames]
    missed = max(fit.missed - int((tall_px >= EXPECTED_PX).sum()), 0)
    return replace(fit, seen=joined([fit.seen, seen])[order], missed=missed, **columns)
