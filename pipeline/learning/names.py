"""The networks that name colour and shape of a face, learned from the candidates on known faces."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.judging import Passed, face_weights
from wayside.pipeline.learning.samples import ON
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.models import NetworkModel
from wayside.schemas.regions import COLORS, SHAPES
from wayside.stages.judge import face_chances, view_names
from wayside.stages.place import DOUBT

PLACE_FEATURES = ("log_height", "log_width", "up", "right", "beside", "source")
"""What the judge sees of a candidate that does not name its face: how far it is and where."""

NAMES = {"color": COLORS, "shape": SHAPES}

HIDDEN, SHRINKAGE, PACE, ROUNDS = 32, 0.3, 2e-3, 40
"""Hidden units, weight of the squares, step, and times that the samples are gone through."""

FEWEST_VIEWS = 3
"""Views that a sign needs to be counted where the share of signs named right is stated."""


def learn_names(passed: Sequence[Passed], what: str, seed: int, provenance: str) -> NetworkModel:
    """The network for the `what` ("color" or "shape") of a face, from all candidates on faces.

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
        network = fit_network(others, what, seed, "")
        for one in group:
            own_right, own_total = named_right(network, one, what)
            right, total = right + own_right, total + own_total
    words = f"{provenance}; held out by drive, named right: {right} of {total} signs"
    return fit_network(passed, what, seed, words)


def fit_network(passed: Sequence[Passed], what: str, seed: int, provenance: str) -> NetworkModel:
    """Fit the network to samples drawn by weight, so that rare names and small faces are seen as well."""
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPClassifier
    except ImportError as error:
        raise UsageError(
            "learning: wanted scikit-learn, found none; install it with pip install 'wayside[learn]'"
        ) from error
    features = tuple(name for name in view_names() if name not in PLACE_FEATURES)
    columns = [k for k, name in enumerate(view_names()) if name not in PLACE_FEATURES]
    on = [one.views.label == ON for one in passed]
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
        [one.weight * face_weights(one.views)[rows] for one, rows in zip(passed, on, strict=True)]
    )
    drawn = _drawn(names, np.where(known, weight, 0.0), 2 * len(names), seed)
    mean, scale = values[known].mean(axis=0), values[known].std(axis=0) + 1e-3
    classifier = MLPClassifier(
        (HIDDEN,),
        alpha=SHRINKAGE,
        learning_rate_init=PACE,
        batch_size=min(64, len(drawn)),
        max_iter=ROUNDS // 2,
        random_state=seed,
    )
    with warnings.catch_warnings():
        # it is stopped early on purpose
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier.fit((values[drawn] - mean) / scale, names[drawn])
    return _exported(classifier, features, mean, scale, provenance)


def named_right(network: NetworkModel, one: Passed, what: str) -> tuple[int, int]:
    """Signs of a drive that the views together name right, and how many there are; a view by its best box."""
    rows = np.flatnonzero(one.views.label == ON)
    rows = rows[np.argsort(-one.views.overlap[rows], kind="stable")]
    rows = rows[np.unique(one.views.face[rows], return_index=True)[1]]
    truth = true_names(one, what)[rows]
    signs = np.array([one.drive.signs[face].sign for face in one.views.face[rows]])
    odds = np.maximum(face_chances(network, NAMES[what], one.values[rows]), DOUBT)
    right = total = 0
    for sign in np.unique(signs):
        own = signs == sign
        if own.sum() >= FEWEST_VIEWS:
            total += 1
            right += NAMES[what][int(odds[own].sum(axis=0).argmax())] == truth[own][0]
    return right, total


def true_names(one: Passed, what: str) -> NDArray[np.str_]:
    """The name that the face under each candidate should get, (n,); empty where there is no face."""
    own = np.array([*(getattr(sign, what) for sign in one.drive.signs), ""])
    return np.asarray(own[one.views.face])


def _drawn(
    names: NDArray[np.str_], weight: NDArray[np.float64], count: int, seed: int
) -> NDArray[np.int64]:
    """Rows drawn by weight, a name by the square root of its share: rare names more often than they are met."""
    _, which = np.unique(names, return_inverse=True)
    share = np.bincount(which, weight)
    chance = weight / np.sqrt(np.maximum(share, 1e-9))[which]
    rng = np.random.default_rng(seed)
    return rng.choice(len(names), count, p=chance / chance.sum())


def _exported(
    classifier: Any,
    features: tuple[str, ...],
    mean: NDArray[np.float32],
    scale: NDArray[np.float32],
    provenance: str,
) -> NetworkModel:
    """The fitted network as a model of ours; scikit-learn keeps one output for two classes."""
    hidden, output = (np.asarray(w, np.float32) for w in classifier.coefs_)
    hidden_bias, output_bias = (np.asarray(b, np.float32) for b in classifier.intercepts_)
    if len(classifier.classes_) == 2:
        output = np.hstack([np.zeros_like(output), output])
        output_bias = np.array([0.0, output_bias[0]], np.float32)
    return NetworkModel(
        features,
        tuple(str(name) for name in classifier.classes_),
        np.asarray(mean, np.float32),
        np.asarray(scale, np.float32),
        hidden,
        hidden_bias,
        output,
        output_bias,
        provenance,
    )
