"""Learning of the ranking of regions and of the pre-filter of the detector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.cross_validation import out_of_fold_models
from wayside.pipeline.learning.samples import (
    NEAR_FACE,
    OFF,
    ON,
    ON_FACE,
    TrainingDrive,
    face_weights,
)
from wayside.pipeline.statistics import resampled_interval
from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds
from wayside.stages.detection import REGION_FEATURES, prefilter_feature_names

TREES = Boosting(trees=80, leaves=16, learning_rate=0.12, feature_fraction=0.5)

OFF_FRACTION = 0.2
"""Fraction of the candidates off any face that are learned from: there are a hundred to one."""

TALL_PX, TALL_LIMITS = 20.0, (0.5, 8.0)
"""Height of a face that counts once for the ranking, and the least and most that a face counts as tall as it."""

PASSED_IN_LEARNING, PASSED_IN_RUN = 500.0, 800.0
"""Candidates of an image that pass in the learning of the box classifier, and in a run, in the mean over the learning
drives and before the ranking: memory limits the former."""


def learn_ranking(
    drives: Sequence[TrainingDrive],
    scenes: Sequence[TrainingDrive],
    seed: int,
    provenance: str,
    most: int,
) -> TreeModel:
    """Learn the ranking; its provenance says how many faces it keeps, out of fold, among `most` regions an image."""
    training = [*drives, *scenes]
    names = [drive.name for drive in training]
    ranking, others = out_of_fold_models(names, training, lambda some: _fit_ranking(some, seed))
    kept = [_faces_kept(drive, others[drive.name], most) for drive in drives]
    found, known = (sum(column) for column in zip(*kept, strict=True))
    words = f"{provenance}; held out by drive, {found} of the {known} wanted faces with a region "
    words += f"have one among the first {most} of the image"
    return replace(ranking, provenance=words)


def learn_prefilter(
    drives: Sequence[TrainingDrive], seed: int, provenance: str
) -> tuple[TreeModel, TreeModel]:
    """The pre-filter with the threshold that `PASSED_IN_LEARNING` candidates an image pass, and `PASSED_IN_RUN`."""
    weight = np.concatenate([face_weights(d.candidates) for d in drives])
    prefilter = _fit(drives, prefilter_feature_names(), weight, seed)
    odds = [log_odds(prefilter, d.candidates.prefilter_values) for d in drives]
    score, drive = np.concatenate(odds), np.repeat(np.arange(len(odds)), [len(o) for o in odds])
    falling = np.argsort(-score, kind="stable")
    score, drive = score[falling], drive[falling]
    frames = np.array([d.frames for d in drives])

    def letting_pass(most: float) -> TreeModel:
        def threshold(count: NDArray[np.int64]) -> float:
            passed = np.cumsum(count[drive])
            row = int(np.searchsorted(passed, round(most * float(frames @ count))))
            return float(score[min(row, len(score) - 1)])

        return replace(
            prefilter,
            threshold=threshold(np.ones(len(frames), np.int64)),
            threshold_rule=f"{most:g} candidates an image pass, in the mean over the drives",
            threshold_interval=resampled_interval(len(frames), threshold),
            provenance=provenance,
        )

    return letting_pass(PASSED_IN_LEARNING), letting_pass(PASSED_IN_RUN)


def _fit_ranking(drives: Sequence[TrainingDrive], seed: int) -> TreeModel:
    weight = np.concatenate([face_weights(d.candidates) * _tall_weights(d) for d in drives])
    return _fit(drives, REGION_FEATURES, weight, seed)


def _tall_weights(drive: TrainingDrive) -> NDArray[np.float64]:
    """Weights (n,) of the candidates on faces: a tall one counts more, as near views determine the position."""
    box, on = drive.true_faces.box, drive.candidates.label == ON
    height = box[drive.candidates.face[on], 3] - box[drive.candidates.face[on], 1]
    weight = np.ones(len(on))
    weight[on] = np.sqrt(np.clip(height / TALL_PX, *TALL_LIMITS))
    return weight


def _fit(
    drives: Sequence[TrainingDrive],
    features: tuple[str, ...],
    weight: NDArray[np.float64],
    seed: int,
) -> TreeModel:
    """Trees on the first columns of the pre-filter's features, named `features`; weight: of all rows."""
    label = np.concatenate([d.candidates.label for d in drives])
    values = np.concatenate([d.candidates.prefilter_values[:, : len(features)] for d in drives])
    some = np.random.default_rng(seed).random(len(label)) < OFF_FRACTION
    far = np.concatenate([d.candidates.overlap for d in drives]) < NEAR_FACE
    training = (label == ON) | ((label == OFF) & some & far)
    fitted = fit_trees(values[training], label[training] == ON, weight[training], TREES, seed)
    return exported_trees(fitted, features, 0.0, "")


def _faces_kept(drive: TrainingDrive, ranking: TreeModel, most: int) -> tuple[int, int]:
    """How many wanted faces have a region on them among the first of their image, and how many have one at all."""
    candidates = drive.candidates
    odds = log_odds(
        ranking, np.ascontiguousarray(candidates.prefilter_values[:, : len(REGION_FEATURES)])
    )
    first = np.zeros(len(odds), bool)
    for frame in np.unique(candidates.frame):
        rows = np.flatnonzero(candidates.frame == frame)
        first[rows[np.argsort(-odds[rows], kind="stable")[:most]]] = True
    on = candidates.overlap >= ON_FACE
    kept, known = (np.unique(candidates.face[rows]) for rows in (on & first, on))
    return int(drive.wanted[kept].sum()), int(drive.wanted[known].sum())
