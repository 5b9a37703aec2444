"""Learning of the networks for the names of colour and shape, from the candidates on known faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.detector import FeaturedDrive
from wayside.pipeline.learning.networks import NetworkTraining, fit_network
from wayside.pipeline.learning.samples import ON, face_weights
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.models import NetworkModel
from wayside.stages.detection import box_feature_names, name_log_probabilities

PLACE_FEATURES = ("log_height", "log_width", "up", "right", "beside", "source")
"""Box features that do not depend on the names of a face: distance and position."""

NAMES = {"color": COLORS, "shape": SHAPES}

NAMING = NetworkTraining(hidden=32, weight_decay=0.3, learning_rate=2e-3, rounds=24, batch=64)

FEWEST_VIEWS = 3
"""Views that a sign needs to be counted where the fraction of signs named right is stated."""


def learn_name_network(
    passed: Sequence[FeaturedDrive], what: str, seed: int, provenance: str, floor: float
) -> NetworkModel:
    """The network for the `what` ("color" or "shape") of a face, from all candidates on faces.

    `floor` is the least log probability of a name in one view, as the votes of a run count it.

    Raises
    ------
    InputError
        If the faces bear fewer than two names.
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    groups = [g for g in (passed[0::2], passed[1::2]) if g]
    right = total = 0
    for k, group in enumerate(groups):
        others = groups[1 - k] if len(groups) == 2 else group
        network = fit_names(others, what, seed, "")
        for one in group:
            own_right, own_total = named_right(network, one, what, floor)
            right, total = right + own_right, total + own_total
    words = f"{provenance}; held out by drive, named right: {right} of {total} signs"
    return fit_names(passed, what, seed, words)


def fit_names(
    passed: Sequence[FeaturedDrive], what: str, seed: int, provenance: str
) -> NetworkModel:
    """Fit the network to samples drawn by weight, so that rare names and small faces are seen as well."""
    features = tuple(name for name in box_feature_names() if name not in PLACE_FEATURES)
    columns = [k for k, name in enumerate(box_feature_names()) if name not in PLACE_FEATURES]
    on = [one.candidates.label == ON for one in passed]
    values = np.concatenate(
        [one.values[rows][:, columns] for one, rows in zip(passed, on, strict=True)]
    )
    names = np.concatenate(
        [true_names(one, what)[rows] for one, rows in zip(passed, on, strict=True)]
    )
    known = np.isin(names, NAMES[what])
    if len(np.unique(names[known])) < 2:
        raise InputError(
            f"names: wanted faces of two kinds of {what} at least, found one; add drives"
        )
    weight = np.concatenate(
        [
            one.weight * face_weights(one.candidates)[rows]
            for one, rows in zip(passed, on, strict=True)
        ]
    )
    balanced_weights = _balanced_names(names, np.where(known, weight, 0.0))
    network = fit_network(values, names, balanced_weights, NAMING, seed, features)
    return replace(network, provenance=provenance)


def named_right(
    network: NetworkModel, one: FeaturedDrive, what: str, floor: float
) -> tuple[int, int]:
    """Signs of a drive that the views together name right, and how many there are; a view by its best box."""
    rows = np.flatnonzero(one.candidates.label == ON)
    rows = rows[np.argsort(-one.candidates.overlap[rows], kind="stable")]
    rows = rows[np.unique(one.candidates.face[rows], return_index=True)[1]]
    truth = true_names(one, what)[rows]
    signs = np.array([one.drive.signs[face].sign for face in one.candidates.face[rows]])
    odds = np.maximum(
        name_log_probabilities(network, NAMES[what], one.values[rows]),
        floor,
    )
    right = total = 0
    for sign in np.unique(signs):
        own = signs == sign
        if own.sum() >= FEWEST_VIEWS:
            total += 1
            right += NAMES[what][int(odds[own].sum(axis=0).argmax())] == truth[own][0]
    return right, total


def true_names(one: FeaturedDrive, what: str) -> NDArray[np.str_]:
    """The name that the face under each candidate should get, (n,); empty where there is no face."""
    own = np.array([*(getattr(sign, what) for sign in one.drive.signs), ""])
    return np.asarray(own[one.candidates.face])


def _balanced_names(names: NDArray[np.str_], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights that count a name by the square root of its fraction: rare names count more."""
    _, which = np.unique(names, return_inverse=True)
    of_name = np.bincount(which, weight)
    return weight / np.sqrt(np.maximum(of_name, 1e-9))[which]
