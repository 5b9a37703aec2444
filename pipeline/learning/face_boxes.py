"""The network that moves a candidate's box onto the face that it lies on, learned from faces that are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.networks import Descent, fit_network
from wayside.pipeline.learning.samples import Drive, Views, labelled
from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.models import NetworkModel
from wayside.stages.detection import FARTHEST, REGION_FEATURES, SHORTEST_PX, SIDES, view_names

REGION_ONLY = REGION_FEATURES[REGION_FEATURES.index("fill") :]
"""What the judge knows of the region rather than of what its box shows: not looked at."""

PARTLY = 0.2
"""Overlap (IoU) with a face from which a candidate is an example."""

SHAKEN, SHIFT, STRETCH = 12, 0.4, 0.6
"""Boxes drawn round each face beside the candidates on it, how far they lie off it at most, in face sizes, and the
logarithm of how much larger or smaller they are at most."""

BOX = Descent(hidden=64, shrinkage=1.0, pace=1e-3, rounds=12, batch=128)


@dataclass(frozen=True, slots=True)
class OnFaces:
    """Boxes on faces of one drive: values (n, features), by (n, 4) where the face's sides are, weight (n,)."""

    values: NDArray[np.float32]
    by: NDArray[np.float64]
    weight: NDArray[np.float64]


def on_faces(
    drive: Drive,
    views: Views,
    values: NDArray[np.float32],
    see: Callable[[Drive, Views], NDArray[np.float32]],
    seed: int,
) -> OnFaces:
    """Examples of a drive: its candidates on faces, each face of the same weight, and as much of shaken boxes."""
    near = np.flatnonzero(views.overlap >= PARTLY)
    near = near[drive.shown.teaches[views.face[near]]]
    face = views.face[near]
    times = np.bincount(face, minlength=len(drive.shown.frame))
    shaken = shaken_boxes(drive, seed)
    return OnFaces(
        np.concatenate([values[near], see(drive, shaken)]),
        np.concatenate(
            [
                sides(views.regions.box[near], drive.shown.box[face]),
                sides(shaken.regions.box, drive.shown.box[shaken.face]),
            ]
        ),
        np.concatenate([1 / times[face], np.full(len(shaken.face), 1 / SHAKEN)]),
    )


def shaken_boxes(drive: Drive, seed: int) -> Views:
    """Boxes round every face that teaches, off it by chance."""
    rng = np.random.default_rng(seed)
    face = np.repeat(np.flatnonzero(drive.shown.teaches), SHAKEN)
    true = drive.shown.box[face]
    size = true[:, 2:] - true[:, :2]
    middle = (true[:, 2:] + true[:, :2]) / 2 + size * rng.uniform(-SHIFT, SHIFT, size.shape)
    half = size * np.exp(rng.uniform(-STRETCH, STRETCH, size.shape)) / 2
    tall = 2 * half[:, 1] >= SHORTEST_PX
    box = np.concatenate([middle - half, middle + half], axis=1).astype(np.float32)[tall]
    n = len(box)
    regions = Regions(
        box,
        np.ones(n, np.int32),
        np.full((n, 3), 128, np.float32),
        np.full(n, SOURCES.index("moved"), np.uint8),
    )
    frame, none = drive.shown.frame[face[tall]], np.zeros((n, 0), np.float32)
    found = labelled(regions, none, frame, drive.shown)
    return replace(found, face=np.asarray(face[tall], np.int32))


def sides(box: NDArray[np.floating[Any]], face: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Where the sides of each face (n, 4) lie from those of its box (n, 4), in box sizes: (n, 4)."""
    size = (box[:, 2:] - box[:, :2])[:, [0, 1, 0, 1]]
    return np.clip((face - box) / size, -FARTHEST, FARTHEST).astype(np.float64)


def learn_face_box(examples: Sequence[OnFaces], seed: int, provenance: str) -> NetworkModel:
    """Fit the network to examples drawn by their weight.

    Raises
    ------
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    columns = [k for k, name in enumerate(view_names()) if name not in REGION_ONLY]
    network = fit_network(
        np.concatenate([one.values[:, columns] for one in examples]),
        np.concatenate([one.by for one in examples]),
        np.concatenate([one.weight for one in examples]),
        BOX,
        seed,
        tuple(view_names()[k] for k in columns),
    )
    return replace(network, classes=SIDES, provenance=provenance)
