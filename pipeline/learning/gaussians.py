"""Gaussian classes with thresholds: colours, shapes, locations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.faces import FaceSample
from wayside.pipeline.roc.curves import KNEE_RULE
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.report import fourier_descriptors

COLOR_FLOOR = (6.0, 6.0, 6.0)
"""Smallest spread of a colour class: less is an accident of few signs."""

SHAPE_FLOOR = 0.01
PLACE_FLOOR = (2.0, 0.8)
FEWEST = 4
"""A class of fewer samples is not learned."""


def color_model(
    faces: Sequence[FaceSample], background: NDArray[Any], provenance: str
) -> GaussianModel:
    """Colour classes in space "rgb"; thresholds at the knee against `background`, (n, 3) mean colours of regions."""
    values, others = np.array([f.rgb for f in faces]), np.asarray(background, np.float64)
    floor = np.array(COLOR_FLOOR)
    classes = []
    for name in COLORS:
        own = np.array([f.color == name for f in faces])
        if own.sum() < FEWEST:
            continue
        weight = balanced([f.sign for f in faces if f.color == name])
        classes.append(_fitted(name, values[own], weight, floor, others))
    return GaussianModel("rgb", tuple(classes), provenance)


def shape_model(faces: Sequence[FaceSample], provenance: str) -> GaussianModel:
    """Shape classes in space "fourier6"; thresholds at the knee against the other shapes."""
    values = fourier_descriptors(np.array([f.outline for f in faces]))
    known = np.asarray(np.isfinite(values).all(axis=1))
    faces, values = [f for f, k in zip(faces, known, strict=True) if k], values[known]
    shapes = np.array([f.shape for f in faces])
    floor = np.full(values.shape[1], SHAPE_FLOOR)
    classes = []
    for name in SHAPES:
        own = shapes == name
        if own.sum() < max(FEWEST, values.shape[1] + 2):
            continue
        weight = balanced([f.sign for f in faces if f.shape == name])
        classes.append(_fitted(name, values[own], weight, floor, values[~own]))
    return GaussianModel("fourier6", tuple(classes), provenance)


def location_model(places: NDArray[np.float64], provenance: str) -> GaussianModel:
    """Where signs stand, (right of the path, above the camera's path) in metres: the mixture of preset `default`.

    places (n, 2): of signs. Overhead panels hang 4 m above the camera or higher; the rest stands right or left. A
    component holds all of its own signs that stand within 4 sigma, for what stands beyond the last sign seen may be the
    next sign. Those of preset `report` are learned by `gates`.
    """
    overhead = places[:, 1] > 4.0
    groups = {
        "right": ~overhead & (places[:, 0] >= 0),
        "left": ~overhead & (places[:, 0] < 0),
        "overhead": overhead,
    }
    floor = np.array(PLACE_FLOOR)
    classes = []
    for name, own in groups.items():
        if own.sum() < FEWEST:
            continue
        mean, covariance = moments(places[own], np.full(own.sum(), 1 / own.sum()), floor)
        if name == "overhead":
            # Over any lane: three lanes either way are as likely as the middle.
            mean[0], covariance = 0.0, np.diag([5.0**2, covariance[1, 1]])
        rule = "four sigma, drawn only: no gate asks for it"
        classes.append(GaussianClass(name, mean, covariance, 4.0, rule, int(own.sum())))
    return GaussianModel("right_up_m", tuple(classes), provenance)


def balanced(signs: Sequence[str]) -> NDArray[np.float64]:
    """Weights (n,) that sum to 1 and give every sign the same, however many views it has."""
    candidates = Counter(signs)
    weight = np.array([1.0 / candidates[s] for s in signs])
    return np.asarray(weight / weight.sum())


def moments(
    values: NDArray[np.float64], weight: NDArray[np.float64], floor: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted mean (d,) and covariance (d, d) of values (n, d); no axis is narrower than its `floor` (d,)."""
    mean = weight @ values
    gap = values - mean
    covariance = (gap * weight[:, None]).T @ gap
    lacking = np.maximum(floor**2 - np.diag(covariance), 0.0)
    return mean, covariance + np.diag(lacking) + np.diag((0.1 * floor) ** 2)


def knee(own: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Distance at which most of `own` and fewest of `others` are accepted: largest difference of the two shares.

    Where several are equally good, the smallest; half-way to the next sample of either.
    """
    steps = np.unique(np.concatenate([own, others]))
    accepted = np.searchsorted(np.sort(own), steps, side="right") / max(len(own), 1)
    wrong = np.searchsorted(np.sort(others), steps, side="right") / max(len(others), 1)
    best = int(np.argmax(accepted - wrong))
    following = steps[min(best + 1, len(steps) - 1)]
    return float((steps[best] + following) / 2)


def _fitted(
    name: str,
    values: NDArray[np.float64],
    weight: NDArray[np.float64],
    floor: NDArray[np.float64],
    others: NDArray[np.float64],
) -> GaussianClass:
    mean, covariance = moments(values, weight, floor)
    unbounded = GaussianClass(name, mean, covariance, np.inf, KNEE_RULE, len(values))
    single = GaussianModel("", (unbounded,), "")
    threshold = knee(single.distances(values)[:, 0], single.distances(others)[:, 0])
    return GaussianClass(name, mean, covariance, threshold, KNEE_RULE, len(values))
