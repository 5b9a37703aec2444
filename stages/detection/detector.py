"""The sign face detector: which boxes of an image show the face of a sign.

Boosted trees, patch CNN and box regression, then non-maximum suppression. Landmarks are classified later from all their
observations together; so the threshold here is low, and the score is passed on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import (
    COLORS,
    SHAPES,
    SOURCES,
    Candidates,
    Detections,
    Segmentation,
    verdict_code,
)
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_odds, log_probabilities
from wayside.stages.detection.box_classifier import BoxClassifier
from wayside.stages.detection.box_regression import SIDES, regressed_regions
from wayside.stages.detection.feature_vectors import (
    box_feature_names,
    box_features,
    feature_columns,
    require_names,
)
from wayside.stages.geometry import non_maximum_suppression
from wayside.stages.imaging import pyramid


def detect(
    items: Iterator[Segmentation],
    *,
    settings: CandidateSettings,
    classifier: TreeModel,
    regressor: NetworkModel | None = None,
    color: NetworkModel | None = None,
    shape: NetworkModel | None = None,
    back: TreeModel | None = None,
) -> Iterator[Detections]:
    """Classify all regions of each image.

    Parameters
    ----------
    items
        Images with their regions; each becomes a candidate.
    settings
        Overlap of suppression, number of candidates kept, limits of faces and of box regression.
    classifier
        Box classifier. Segments in whose middle the detection network sees no face get the verdict `glance` and no
        score; candidates below the threshold get `score`. Of overlapping ones the best stays (`overlap`), of all of
        them the best `settings.keep` (`score`).
    regressor
        Box regression: a candidate not far below the threshold is scored at the predicted box as well, and moves there
        where it scores better.
    color, shape
        Networks for the log probabilities of the names of colour and shape, for all candidates above the threshold;
        their class is the most probable one. The others keep class -1.
    back
        Classifier of panels seen from behind: what it accepts, and scores higher than the box classifier does, gets a
        `back_score`.

    Yields
    ------
    One item an image, in order.

    Raises
    ------
    InputError
        If a model has features or outputs that are not known here.
    """
    boxes = BoxClassifier(classifier)
    require_name_networks(color, shape)
    if regressor is not None:
        require_names("box network", regressor.features, box_feature_names())
        require_names("box network", regressor.classes, SIDES, exact=True)
    for item in items:
        image, regions = item.image, item.regions
        candidates = Candidates.of(item.regions)
        if image.rgb is None or image.frame.camera is None or len(regions) == 0:
            yield Detections(item, candidates)
            continue
        levels, camera = pyramid(image.rgb), image.frame.camera
        passed = passes_network(item, settings)
        candidates = candidates.with_verdict(np.flatnonzero(~passed), "glance")
        rows, regions = np.flatnonzero(passed), regions.select(passed)
        values = box_features(levels, regions, camera)
        trees = boxes.tree_scores(values)
        scores = boxes.combined(levels, regions, values, trees)
        if regressor is not None:
            near = np.flatnonzero(trees >= regression_threshold(classifier, settings))
            moved = regressed_regions(
                regressor, values[near], regions.select(near), settings, camera
            )
            moved_values = box_features(levels, moved, camera)
            moved_scores = boxes.combined(
                levels, moved, moved_values, boxes.tree_scores(moved_values)
            )
            better = moved_scores > scores[near]
            scores[near[better]], values[near[better]] = moved_scores[better], moved_values[better]
            candidates = candidates.with_boxes(rows[near[better]], moved.box[better])
        if item.network_score is not None:
            scores = boxes.with_network(scores, item.network_score[rows])
        candidates = with_scores(candidates, rows, scores, boxes.threshold, settings)
        above = scores >= boxes.threshold
        candidates = with_names(candidates, color, shape, rows[above], values[above])
        if back is not None:
            back_scores = log_odds(back, values)
            behind = (back_scores >= back.threshold) & (back_scores > scores)
            column = np.full(len(candidates), np.nan, np.float32)
            column[rows[behind]] = back_scores[behind]
            candidates = replace(candidates, back_score=column)
        yield Detections(item, candidates)


def passes_network(item: Segmentation, settings: CandidateSettings) -> NDArray[np.bool_]:
    """Which regions (n,) are classified: boxes of the network, and segments where it sees a face; all without one."""
    if item.network_score is None:
        return np.ones(len(item.regions), np.bool_)
    own = item.regions.source == SOURCES.index("network")
    return np.asarray(own | (item.network_score >= settings.segment_score))


def require_name_networks(color: NetworkModel | None, shape: NetworkModel | None) -> None:
    """Refuse networks of colour and shape with features or names that are not known here (InputError)."""
    for what, network, names in (("colour", color, COLORS), ("shape", shape, SHAPES)):
        if network is not None:
            require_names(f"{what} network", network.features, box_feature_names())
            require_names(f"{what} network", network.classes, names)


def regression_threshold(classifier: TreeModel, settings: CandidateSettings) -> float:
    """Log odds of the trees from which a box may overlap a face: from there on it is regressed."""
    if classifier.patch_cnn is None:
        return classifier.threshold - settings.regression_margin
    return classifier.patch_cnn.tree_threshold


def name_log_probabilities(
    network: NetworkModel, names: tuple[str, ...], values: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Log probability (n, names) of each of `names` for rows of `box_features`; -inf where never learned."""
    columns = feature_columns(network.features)
    result = np.full((len(values), len(names)), -np.inf, np.float32)
    result[:, [names.index(name) for name in network.classes]] = log_probabilities(
        network, np.ascontiguousarray(values[:, columns])
    )
    return result


def with_scores(
    candidates: Candidates,
    rows: NDArray[np.int64],
    scores: NDArray[np.float32],
    threshold: float,
    settings: CandidateSettings,
) -> Candidates:
    """The candidates with the `scores` of `rows` and the verdicts that follow: threshold, suppression, number kept."""
    score = candidates.score.copy()
    score[rows] = scores
    alive = rows[scores >= threshold]
    # Best first; the earlier row wins a tie.
    alive = alive[np.argsort(-score[alive], kind="stable")]
    kept = alive[non_maximum_suppression(candidates.regions.box[alive], settings.same_face_iou)]
    verdict = candidates.verdict.copy()
    verdict[rows[scores < threshold]] = verdict_code("score")
    verdict[alive] = verdict_code("overlap")
    verdict[kept] = verdict_code("score")
    verdict[kept[: settings.keep]] = verdict_code("open")
    return replace(candidates, score=score, verdict=verdict)


def with_names(
    candidates: Candidates,
    color: NetworkModel | None,
    shape: NetworkModel | None,
    rows: NDArray[np.int64],
    values: NDArray[np.float32],
) -> Candidates:
    """The candidates with the log probabilities and the most probable classes of `rows`, by each network given."""
    if color is not None:
        kind, known = candidates.color.copy(), _unknown(candidates, COLORS)
        known[rows] = name_log_probabilities(color, COLORS, values)
        kind[rows] = known[rows].argmax(axis=1)
        candidates = replace(candidates, color=kind, color_log_probability=known)
    if shape is not None:
        kind, known = candidates.shape.copy(), _unknown(candidates, SHAPES)
        known[rows] = name_log_probabilities(shape, SHAPES, values)
        kind[rows] = known[rows].argmax(axis=1)
        candidates = replace(candidates, shape=kind, shape_log_probability=known)
    return candidates


def _unknown(candidates: Candidates, names: tuple[str, ...]) -> NDArray[np.float32]:
    return np.full((len(candidates), len(names)), np.nan, np.float32)
