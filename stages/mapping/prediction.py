"""Predicted views: boxes that a fitted landmark must have in other images, classified where no candidate was found.

Candidates miss a face now and then: against a pale sky, behind a branch, far away. Two views place a landmark to a
pixel or two in the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import NONE, Regions
from wayside.stages.detection import BoxClassifier, fits_face, regions_of
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.kernels import Each
from wayside.stages.mapping.association import EXPECTED_PX, NEAREST_M
from wayside.stages.mapping.landmark_fit import LandmarkFit
from wayside.stages.mapping.window import EDGE_PX, WindowFrame

SIGMA_SHARE = 0.15
"""Largest scatter of a predicted box by its height (set on the development drives)."""
SIGMA_PX = 1.0
"""Scatter that is always allowed."""


def add_predicted_views(
    fits: Sequence[LandmarkFit],
    window: Sequence[WindowFrame],
    classifiers: Mapping[bool, BoxClassifier],
    each: Each = map,
) -> list[LandmarkFit]:
    """Add to each landmark the predicted views that a classifier accepts.

    The views are added to the frames' candidates, source `predicted`. They count as seen, but do not move the point,
    which predicted them.

    `classifiers`: of one view, of faces (False) and of backs (True); without one none is predicted. `each`: applies a
    function to items, as `map`.
    """
    views: list[list[tuple[int, int]]] = [[] for _ in fits]

    def accepted(k: int) -> list[tuple[bool, NDArray[np.int64], Regions, NDArray[np.float32]]]:
        held, found = window[k], []
        if held.rgb is None:
            return []
        number, boxes = predicted_boxes(fits, held)
        for back, classifier in sorted(classifiers.items()):
            new = [fits[i].back == back and k not in fits[i].frames for i in number]
            own = np.flatnonzero(fits_face(boxes, held.camera) & np.array(new, np.bool_))
            if len(own):
                box, unknown = boxes[own].astype(np.float32), np.full(len(own), NONE)
                regions = regions_of(box, unknown, held.rgb, "predicted")
                scores = classifier.scores(held.rgb, regions.box)
                rows = np.flatnonzero(scores >= classifier.model.threshold)
                found.append((back, number[own[rows]], regions.select(rows), scores[rows]))
        return found

    for k, found in enumerate(each(accepted, range(len(window)))):
        for back, numbers, regions, scores in found:
            for number, row in zip(numbers, window[k].add(regions, scores, back=back), strict=True):
                views[number].append((k, row))
    return [
        _extended(fit, new, window) if new else fit for fit, new in zip(fits, views, strict=True)
    ]


def predicted_boxes(
    fits: Sequence[LandmarkFit], frame: WindowFrame
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Boxes (m, 4) of landmarks in a frame, recorded pixels, each with the number (m,) of its landmark.

    But for those that are cut or too near, or whose scatter there is too large.
    """
    camera, pose = frame.camera, frame.motion.pose
    points = pose.to_camera(np.array([fit.point for fit in fits]).reshape(-1, 3))
    row = np.flatnonzero(points[:, 2] >= NEAREST_M)
    ray, depth = points[row, :2] / points[row, 2:], points[row, 2]
    size = np.array([fits[i].metric for i in row.tolist()]).reshape(-1, 2) / depth[:, None]
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
    sure = sigma_px <= np.maximum(SIGMA_SHARE * size[:, 1] * frame.focal, SIGMA_PX)
    return row[inside & sure], box[inside & sure]


def _extended(
    fit: LandmarkFit, new: Sequence[tuple[int, int]], window: Sequence[WindowFrame]
) -> LandmarkFit:
    """The landmark with new views: frame and row of each."""
    frames, rows = zip(*new, strict=True)
    depth = np.array([window[k].motion.pose.to_camera(fit.point)[2] for k in frames])
    none, one = np.zeros(len(new)), np.ones(len(new))
    added = {"frames": frames, "rows": rows, "used": none, "residual_px": none}
    added |= {"depth": depth, "weight_sigma": one, "ray_sigma": one}
    order = np.argsort([*fit.frames, *frames], kind="stable")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(fit, name), values])[order].astype(getattr(fit, name).dtype)
        for name, values in added.items()
    }
    tall_px = fit.metric[1] / depth * [window[k].focal for k in frames]
    missed = max(fit.missed - int((tall_px >= EXPECTED_PX).sum()), 0)
    return replace(fit, missed=missed, **columns)
