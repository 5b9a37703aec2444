"""Learning of bounding-box regression from candidates on known faces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.networks import NetworkTraining, fit_network
from wayside.pipeline.learning.samples import CandidateSamples, TrainingDrive, labelled
from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.models import NetworkModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection import REGION_FEATURES, SIDES, box_feature_names

REGION_ONLY = REGION_FEATURES[REGION_FEATURES.index("fill") :]
"""Box features of the region rather than of the pixels of its box: not used."""

PARTLY = 0.2
"""Overlap (IoU) with a face from which a candidate is an example."""

JITTERED, SHIFT, STRETCH = 12, 0.4, 0.6
"""Boxes drawn round each face beside the candidates on it, how far they lie off it at most, in face sizes, and the
logarithm of how much larger or smaller they are at most."""

BOX = NetworkTraining(hidden=64, weight_decay=1.0, learning_rate=1e-3, rounds=12, batch=128)


@dataclass(frozen=True, slots=True)
class BoxRegressionSamples:
    """Boxes on faces of one drive: values (n, features), offset (n, 4) of the sides of the face, weight (n,)."""

    values: NDArray[np.float32]
    offset: NDArray[np.float64]
    weight: NDArray[np.float64]


def regression_samples(
    drive: TrainingDrive,
    candidates: CandidateSamples,
    values: NDArray[np.float32],
    features_of: Callable[[TrainingDrive, CandidateSamples], NDArray[np.float32]],
    seed: int,
    settings: CandidateSettings,
) -> BoxRegressionSamples:
    """Examples of a drive: its candidates on faces, each face of the same weight, and jittered boxes."""
    limit = settings.largest_offset
    near = np.flatnonzero(candidates.overlap >= PARTLY)
    near = near[drive.true_faces.is_example[candidates.face[near]]]
    face = candidates.face[near]
    times = np.bincount(face, minlength=len(drive.true_faces.frame))
    jittered = jittered_boxes(drive, seed, settings.shortest_px)
    return BoxRegressionSamples(
        np.concatenate([values[near], features_of(drive, jittered)]),
        np.concatenate(
            [
                side_offsets(candidates.regions.box[near], drive.true_faces.box[face], limit),
                side_offsets(jittered.regions.box, drive.true_faces.box[jittered.face], limit),
            ]
        ),
        np.concatenate([1 / times[face], np.full(len(jittered.face), 1 / JITTERED)]),
    )


def jittered_boxes(drive: TrainingDrive, seed: int, shortest_px: float) -> CandidateSamples:
    """Boxes around every example face, randomly shifted and stretched; none is lower than `shortest_px`."""
    rng = np.random.default_rng(seed)
    face = np.repeat(np.flatnonzero(drive.true_faces.is_example), JITTERED)
    true = drive.true_faces.box[face]
    size = true[:, 2:] - true[:, :2]
    middle = (true[:, 2:] + true[:, :2]) / 2 + size * rng.uniform(-SHIFT, SHIFT, size.shape)
    half = size * np.exp(rng.uniform(-STRETCH, STRETCH, size.shape)) / 2
    tall = 2 * half[:, 1] >= shortest_px
    box = np.concatenate([middle - half, middle + half], axis=1).astype(np.float32)[tall]
    n = len(box)
    regions = Regions(
        box,
        np.ones(n, np.int32),
        np.full((n, 3), 128, np.float32),
        np.full(n, SOURCES.index("moved"), np.uint8),
    )
    frame = drive.true_faces.frame[face[tall]]
    found = labelled(regions, frame, drive.true_faces)
    return replace(found, face=np.asarray(face[tall], np.int32))


def side_offsets(
    box: NDArray[np.floating[Any]], face: NDArray[np.floating[Any]], limit: float
) -> NDArray[np.float64]:
    """Where the sides of each face (n, 4) lie from those of its box (n, 4), in box sizes up to `limit`: (n, 4)."""
    size = (box[:, 2:] - box[:, :2])[:, [0, 1, 0, 1]]
    return np.clip((face - box) / size, -limit, limit).astype(np.float64)


def learn_box_regressor(
    examples: Sequence[BoxRegressionSamples], seed: int, provenance: str
) -> NetworkModel:
    """Fit the network to examples drawn by their weight.

    Raises
    ------
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    columns = [k for k, name in enumerate(box_feature_names()) if name not in REGION_ONLY]
    network = fit_network(
        np.concatenate([one.values[:, columns] for one in examples]),
        np.concatenate([one.offset for one in examples]),
        np.concatenate([one.weight for one in examples]),
        BOX,
        seed,
        tuple(box_feature_names()[k] for k in columns),
    )
    return replace(network, classes=SIDES, provenance=provenance)
