"""Near first, then back: where a found thing must stand in the other pictures held, and whether its face is there.

Candidates miss a face now and then: against a pale sky, behind a branch, far away. Where two views place a thing, the
others are known to a pixel or two; there the judge of one view looks at the box itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Regions
from wayside.stages.geometry import distort_points, ideal_of_rays
from wayside.stages.mapping.association import Gates, Sightings
from wayside.stages.mapping.classifiers import ViewClassifier
from wayside.stages.mapping.hypotheses import Fit
from wayside.stages.mapping.window import Held, first_rows, local_rows, sightings_of

SMALLEST_PX, NEAREST_M = 9.0, 4.0
"""Height below which a predicted box shows too little to judge, and depth below which it shows too much."""
SURE_SHARE, SURE_PX = 0.15, 1.0
"""A place is predicted where its centre is known to this share of its height there, or so many pixels."""


class _Predicted(NamedTuple):
    """A box of one place in one frame: which place, box (4,) in recorded pixels, and its height in ideal ones."""

    place: int
    box: NDArray[np.float64]
    tall_px: float


def follow_back(
    fits: Sequence[Fit],
    held: Sequence[Held],
    faces: ViewClassifier | None,
    gates: Gates,
    backs: ViewClassifier | None = None,
) -> tuple[Sightings, list[Fit]]:
    """Add to each place the predicted views that the judge of one view accepts: of faces, or of backs.

    The views are added to the frames' candidates, source `predicted`; they count as seen, but do not move the place:
    they say nothing on where it is that was not known before.

    Returns
    -------
    Sightings, list of Fit
        The window with the views added, and the places whose rows refer to it.
    """
    wanted: dict[tuple[int, bool], list[_Predicted]] = {}
    for place, fit in enumerate(fits):
        for frame in sorted(set(range(len(held))) - set(fit.frames.tolist())):
            found = predicted_box(fit, held[frame])
            if found is not None:
                wanted.setdefault((frame, fit.back), []).append(_Predicted(place, *found))
    accepted: list[list[tuple[int, _Predicted, Regions, float]]] = [[] for _ in fits]
    for (frame, back), here in sorted(wanted.items()):
        classifier = backs if back else faces
        if classifier is None:
            continue
        regions = _regions(here, fits, held)
        scores = _scores(held[frame], regions, classifier)
        for k, (one, score) in enumerate(zip(here, scores.tolist(), strict=True)):
            if score >= classifier.threshold:
                row = regions.select(np.array([k]))
                accepted[one.place].append((frame, one, row, score))
    before = first_rows(held)
    views = [
        [(f, held[f].add(row, score, back=fit.back), one) for f, one, row, score in own]
        for fit, own in zip(fits, accepted, strict=True)
    ]
    after = first_rows(held)
    followed = [
        _extended(fit, new, before, after, held, gates)
        for fit, new in zip(fits, views, strict=True)
    ]
    return sightings_of(held), followed


def predicted_box(fit: Fit, home: Held) -> tuple[NDArray[np.float64], float] | None:
    """Box (4,) of a place in a frame, recorded pixels, and its height in ideal ones.

    None where it is cut, too small, or not known well enough to be looked at.
    """
    camera, pose = home.frame.camera, home.motion.pose
    x, y, z = pose.to_camera(fit.point)
    wide, tall = fit.metric / 2
    if camera is None or home.rgb is None or z < NEAREST_M:
        return None
    tall_px = 2 * tall / z * home.focal
    project = np.array([[1, 0, -x / z], [0, 1, -y / z]]) @ pose.rotation.T / z
    sigma_px = home.focal * float(np.sqrt(np.linalg.norm(project @ fit.covariance @ project.T, 2)))
    if tall_px < SMALLEST_PX or sigma_px > max(SURE_SHARE * tall_px, SURE_PX):
        return None
    corners = np.array(
        [[x - wide, y - tall], [x + wide, y - tall], [x + wide, y + tall], [x - wide, y + tall]]
    )
    pixels = distort_points(camera, ideal_of_rays(camera, corners / z))
    low, high = pixels.min(axis=0) + 0.5, pixels.max(axis=0) + 0.5
    if (low < 1).any() or high[0] > camera.width - 1 or high[1] > camera.height - 1:
        return None
    return np.concatenate([low, high]), float(tall_px)


def _regions(here: Sequence[_Predicted], fits: Sequence[Fit], held: Sequence[Held]) -> Regions:
    """The boxes as regions as full and as coloured as the place's nearest view."""
    area, rgb = [], []
    for one in here:
        fit = fits[one.place]
        nearest = int(fit.depth.argmin())
        home = held[fit.frames[nearest]]
        row = home.open[local_rows(fit.rows, fit.frames, held)[nearest]]
        region = home.candidates.regions
        x0, y0, x1, y1 = region.box[row]
        share = float(region.area_px[row]) / max(float((x1 - x0) * (y1 - y0)), 1.0)
        u0, v0, u1, v1 = one.box
        area.append(share * (u1 - u0) * (v1 - v0))
        rgb.append(region.rgb[row])
    return Regions(
        np.array([one.box for one in here], np.float32),
        np.array(area).astype(np.int32),
        np.array(rgb, np.float32),
        np.full(len(here), SOURCES.index("predicted"), np.uint8),
    )


def _scores(home: Held, regions: Regions, classifier: ViewClassifier) -> NDArray[np.float32]:
    camera, levels = home.frame.camera, home.picture_levels()
    if camera is None or levels is None:
        return np.full(len(regions), -np.inf, np.float32)
    # The classifier was taught with regions of levels: what it knows of their source holds for these.
    shown = replace(regions, source=np.full(len(regions), SOURCES.index("level"), np.uint8))
    return classifier.scores(levels, shown, camera)


def _extended(
    fit: Fit,
    new: Sequence[tuple[int, int, _Predicted]],
    before: NDArray[np.int64],
    after: NDArray[np.int64],
    held: Sequence[Held],
    gates: Gates,
) -> Fit:
    """The place with its new views, all rows counted as the window counts them `after` views were added."""
    added = np.array([frame for frame, _, _ in new], np.int64)
    rows = np.concatenate(
        [
            fit.rows - before[fit.frames] + after[fit.frames],
            after[added] + np.array([local for _, local, _ in new], np.int64),
        ]
    )
    depth = [float(held[f].motion.pose.to_camera(fit.point)[2]) for f in added]
    frames = np.concatenate([fit.frames, added])
    order = np.argsort(frames, kind="stable")
    none = np.zeros(len(added))

    def ordered(known: NDArray[np.float64], more: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([known, more])[order]

    expected = sum(one.tall_px >= gates.expected_px for _, _, one in new)
    covered = np.searchsorted(before, fit.covered, side="right") - 1
    return replace(
        fit,
        rows=rows[order],
        frames=frames[order],
        used=np.concatenate([fit.used, np.zeros(len(added), np.bool_)])[order],
        residual_px=ordered(fit.residual_px, none),
        depth=ordered(fit.depth, np.array(depth)),
        weight_sigma=ordered(fit.weight_sigma, none + 1.0),
        ray_sigma=ordered(fit.ray_sigma, none + 1.0),
        empty=max(fit.empty - expected, 0),
        covered=fit.covered - before[covered] + after[covered],
    )
