"""What is not worth a look: a ranking of regions by what is known of them, and a gate that glances at the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.samples import (
    NEAR_FACE,
    OFF,
    ON,
    ON_FACE,
    Drive,
    face_weights,
)
from wayside.pipeline.learning.strangers import for_strangers
from wayside.schemas.models import TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_odds
from wayside.stages.detection import REGION_FEATURES, gate_names

GATE = Boosting(trees=80, leaves=16, pace=0.12, share_of_features=0.5)

OFF_SHARE = 0.2
"""Share of the candidates off any face that is taught with: there are a hundred to one."""

TALL_PX, TALL_SHARE = 20.0, (0.5, 8.0)
"""Height of a face that counts once for the ranking, and the least and most that a face counts as tall as it."""

TAUGHT, PASSED = 500.0, 800.0
"""Candidates of a picture that the gate lets pass to teach the judge, and in a run, in the mean over what is learned
from and before the ranking: the judge knows what to make of more than can be held in memory to teach it."""


def learn_ranking(
    drives: Sequence[Drive], scenes: Sequence[Drive], seed: int, provenance: str
) -> TreeModel:
    """Learn the ranking; its provenance says how many faces it keeps in a picture where it has not seen the drive."""
    taught = [*drives, *scenes]
    names = [drive.name for drive in taught]
    ranking, others = for_strangers(names, taught, lambda some: _fit_ranking(some, seed))
    most = CandidateSettings().most
    kept = [_faces_kept(drive, others[drive.name], most) for drive in drives]
    found, known = (sum(column) for column in zip(*kept, strict=True))
    words = f"{provenance}; held out by drive, {found} of the {known} wanted faces with a region "
    words += f"have one among the first {most} of the picture"
    return replace(ranking, provenance=words)


def learn_gate(drives: Sequence[Drive], seed: int, provenance: str) -> tuple[TreeModel, TreeModel]:
    """Learn the gate; with the bar by which it lets pass `TAUGHT` candidates a picture, and that for `PASSED`."""
    weight = np.concatenate([face_weights(d.views) for d in drives])
    gate = _fit(drives, gate_names(), weight, seed)
    score = np.sort(np.concatenate([log_odds(gate, d.views.glance) for d in drives]))[::-1]
    frames = sum(d.frames for d in drives)

    def letting_pass(most: float) -> TreeModel:
        count = min(round(most * frames), len(score))
        words = f"{provenance}; accept at {most:g} candidates a picture"
        return replace(gate, accept=float(score[count - 1]), provenance=words)

    return letting_pass(TAUGHT), letting_pass(PASSED)


def _fit_ranking(drives: Sequence[Drive], seed: int) -> TreeModel:
    weight = np.concatenate([face_weights(d.views) * _tall_weights(d) for d in drives])
    return _fit(drives, REGION_FEATURES, weight, seed)


def _tall_weights(drive: Drive) -> NDArray[np.float64]:
    """Weights (n,) of the candidates on faces: a tall one counts more, as near views are few, and place the sign."""
    box, on = drive.shown.box, drive.views.label == ON
    height = box[drive.views.face[on], 3] - box[drive.views.face[on], 1]
    weight = np.ones(len(on))
    weight[on] = np.sqrt(np.clip(height / TALL_PX, *TALL_SHARE))
    return weight


def _fit(
    drives: Sequence[Drive], features: tuple[str, ...], weight: NDArray[np.float64], seed: int
) -> TreeModel:
    """Trees on the first columns of what the gate sees, which have the names of the features; weight: of all rows."""
    label = np.concatenate([d.views.label for d in drives])
    values = np.concatenate([d.views.glance[:, : len(features)] for d in drives])
    some = np.random.default_rng(seed).random(len(label)) < OFF_SHARE
    far = np.concatenate([d.views.overlap for d in drives]) < NEAR_FACE
    taught = (label == ON) | ((label == OFF) & some & far)
    fitted = fit_trees(values[taught], label[taught] == ON, weight[taught], GATE, seed)
    return exported_trees(fitted, features, 0.0, "")


def _faces_kept(drive: Drive, ranking: TreeModel, most: int) -> tuple[int, int]:
    """How many wanted faces have a region on them among the first of their picture, and how many have one at all."""
    views = drive.views
    odds = log_odds(ranking, np.ascontiguousarray(views.glance[:, : len(REGION_FEATURES)]))
    first = np.zeros(len(odds), bool)
    for frame in np.unique(views.frame):
        rows = np.flatnonzero(views.frame == frame)
        first[rows[np.argsort(-odds[rows], kind="stable")[:most]]] = True
    on = views.overlap >= ON_FACE
    kept, known = (np.unique(views.face[rows]) for rows in (on & first, on))
    return int(drive.wanted[kept].sum()), int(drive.wanted[known].sum())
