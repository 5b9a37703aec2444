"""The judge of one view: which boxes show the face of a sign.

Boosted trees on what the box shows and where it stands; a closer look at what may be a face by them, there and where
the box is moved onto the face; then the best of overlapping boxes. The judge of a place, later, sees all views
together; so the bar here is low, and the score travels on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import (
    COLORS,
    SHAPES,
    SOURCES,
    Candidates,
    Detections,
    Regions,
    verdict_code,
)
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_chances, log_odds
from wayside.stages.detection.box_regression import check_box_network, moved_boxes
from wayside.stages.detection.boxes import suppressed_boxes
from wayside.stages.detection.patch_cnn import check_closer, closer_odds, told_of
from wayside.stages.detection.patch_features import patch_feature_names, patch_features
from wayside.stages.detection.prefilter_features import glance_names, glances
from wayside.stages.detection.region_features import REGION_FEATURES, region_features
from wayside.stages.imaging import pyramid

OVERLAP = 0.4
"""Boxes that overlap a better one by more (IoU) show the same face."""

REACH = 4.0
"""How far below the bar of the trees (log odds) a box may still be of a face, or lie on part of one."""


def judge(
    items: Iterator[Detections],
    *,
    trees: TreeModel,
    settings: CandidateSettings,
    color: NetworkModel | None = None,
    shape: NetworkModel | None = None,
    box: NetworkModel | None = None,
    back: TreeModel | None = None,
) -> Iterator[Detections]:
    """Look at all open candidates: `glance` is the verdict of those the model's gate refuses, unscored.

    The others are scored; those below the model's bar get the verdict `score`. Of overlapping survivors the best
    stays (`overlap`), of all of them the best `settings.keep` (`score`). Where networks are given that name the `color`
    and `shape` of a face, they do so for all that pass the bar. Where one is given that moves the `box` onto the face,
    a candidate not far below the bar is looked at there, too, and stays where it scores better. Where there is a judge
    of the `back` of a panel, what it accepts, and holds for likelier than a face, gets a `back_score`.
    """
    check_closer(trees.closer)
    check_network(color, COLORS)
    check_network(shape, SHAPES)
    if box is not None:
        check_box_network(box, view_names())
    for item in items:
        image = item.image
        rows = item.candidates.open_rows()
        if image.rgb is None or image.frame.camera is None or len(rows) == 0:
            yield item
            continue
        levels = pyramid(image.rgb)
        regions, camera = item.candidates.regions.select(rows), image.frame.camera
        candidates = item.candidates
        if trees.gate is not None:
            passed = (
                log_odds(trees.gate, gate_features(levels, regions, camera)) >= trees.gate.accept
            )
            verdict = candidates.verdict.copy()
            verdict[rows[~passed]] = verdict_code("glance")
            candidates = replace(candidates, verdict=verdict)
            rows, regions = rows[passed], regions.select(passed)
        values = view_features(levels, regions, camera)
        first = log_odds(trees, values)
        near = np.flatnonzero(first >= near_bar(trees))
        found = view_odds(trees, levels, regions, values, first)
        if box is not None:
            moved = moved_regions(box, values[near], regions.select(near), camera)
            there = view_features(levels, moved, camera)
            anew = view_odds(trees, levels, moved, there, log_odds(trees, there))
            better = anew > found[near]
            found[near[better]], values[near[better]] = anew[better], there[better]
            candidates = candidates.moved(rows[near[better]], moved.box[better])
        candidates = decided(candidates, rows, found, trees.accept, settings.keep)
        passed = found >= trees.accept
        odds: list[NDArray[np.float32] | None] = [None, None]
        for k, (network, names) in enumerate(((color, COLORS), (shape, SHAPES))):
            if network is not None:
                table = np.full((len(candidates), len(names)), np.nan, np.float32)
                table[rows[passed]] = face_chances(network, names, values[passed])
                odds[k] = table
        candidates = replace(candidates, color_odds=odds[0], shape_odds=odds[1])
        if back is not None:
            seen = log_odds(back, values)
            behind = (seen >= back.accept) & (seen > found)
            score = np.full(len(candidates), np.nan, np.float32)
            score[rows[behind]] = seen[behind]
            candidates = replace(candidates, back_score=score)
        yield replace(item, candidates=candidates)


@dataclass(frozen=True, slots=True)
class BoxClassifier:
    """The classifier of single boxes by itself: a second look at boxes that tracking predicts."""

    model: TreeModel

    @property
    def threshold(self) -> float:
        """Log odds from which a box is accepted."""
        return self.model.accept

    def scores(
        self, levels: tuple[NDArray[np.uint8], ...], regions: Regions, camera: Camera
    ) -> NDArray[np.float32]:
        """Log odds (n,) that the regions show faces; levels: the image at full, half and quarter size."""
        values = view_features(levels, regions, camera)
        return view_odds(self.model, levels, regions, values, log_odds(self.model, values))


def near_bar(trees: TreeModel) -> float:
    """Log odds of the trees from which a box may be of a face, or lie on part of one."""
    return trees.accept - REACH if trees.closer is None else trees.closer.near


def view_odds(
    trees: TreeModel,
    levels: tuple[NDArray[np.uint8], ...],
    regions: Regions,
    values: NDArray[np.float32],
    first: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Log odds (n,) that the regions show faces: `first`, the trees' on these `values`, or with a closer look.

    values (n, features): `view_features` of the regions; the closer look, where the model has one, is at those near.
    """
    if trees.closer is None:
        return first
    near = np.flatnonzero(first >= trees.closer.near)
    told = told_of(view_names(), values[near])
    odds = first.copy()
    odds[near] = closer_odds(trees.closer, levels, regions.box[near], told, first[near])
    return odds


def moved_regions(
    network: NetworkModel,
    values: NDArray[np.float32],
    regions: Regions,
    camera: Camera | None = None,
) -> Regions:
    """The regions with boxes on the face, as the network sees it from their `view_features`.

    They end at the border of the camera's picture, where one is given.
    """
    columns = np.ascontiguousarray(values[:, _columns(network.features)])
    source = np.full(len(regions), SOURCES.index("moved"), np.uint8)
    return replace(regions, box=moved_boxes(network, columns, regions.box, camera), source=source)


def check_network(network: NetworkModel | None, names: tuple[str, ...]) -> None:
    """Refuse a network that looks at what there is not or names what there is not; raises InputError."""
    if network is None:
        return
    for given, known in ((network.features, view_names()), (network.classes, names)):
        strange = set(given) - set(known)
        if strange:
            raise InputError(
                f"network: wanted known features and classes, found {sorted(strange)[0]!r}; learn it again"
            )


def face_chances(
    network: NetworkModel, names: tuple[str, ...], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Logarithm of the chance of each of `names` for rows of `view_features`: (n, names); -inf where never learned."""
    columns = _columns(network.features)
    chances = np.full((len(values), len(names)), -np.inf, np.float32)
    chances[:, [names.index(name) for name in network.classes]] = log_chances(
        network, np.ascontiguousarray(values[:, columns])
    )
    return chances


@cache
def _columns(features: tuple[str, ...]) -> NDArray[np.int64]:
    """Where a network's features stand among those of a view."""
    place = {name: k for k, name in enumerate(view_names())}
    return np.array([place[feature] for feature in features], np.int64)


def gate_names() -> tuple[str, ...]:
    """Names of the columns of `gate_features`, in order."""
    return (*REGION_FEATURES, *glance_names())


def view_names() -> tuple[str, ...]:
    """Names of the columns of `view_features`, in order."""
    return (*REGION_FEATURES, *patch_feature_names())


def gate_features(
    levels: tuple[NDArray[np.uint8], ...], regions: Regions, camera: Camera
) -> NDArray[np.float32]:
    """What the gate knows of each region: shape (n, features), in the order of `gate_names`."""
    return np.concatenate([region_features(regions, camera), glances(levels, regions.box)], axis=1)


def view_features(
    levels: tuple[NDArray[np.uint8], ...], regions: Regions, camera: Camera
) -> NDArray[np.float32]:
    """What the judge knows of each region: shape (n, features), in the order of `view_names`."""
    return np.concatenate(
        [region_features(regions, camera), patch_features(levels, regions.box)], axis=1
    )


def decided(
    candidates: Candidates,
    rows: NDArray[np.int64],
    found: NDArray[np.float32],
    accept: float,
    keep: int,
) -> Candidates:
    """The candidates with the scores `found` of `rows` and the verdicts that follow from them."""
    score, verdict = candidates.score.copy(), candidates.verdict.copy()
    score[rows] = found
    verdict[rows[found < accept]] = verdict_code("score")
    alive = rows[found >= accept]
    # Best first; the earlier row wins a tie.
    alive = alive[np.argsort(-score[alive], kind="stable")]
    hidden = suppressed_boxes(candidates.regions.box[alive], OVERLAP)
    verdict[alive[hidden]] = verdict_code("overlap")
    verdict[alive[~hidden][keep:]] = verdict_code("score")
    return replace(candidates, score=score, verdict=verdict)
