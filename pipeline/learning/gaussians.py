"""Gaussian classes of colours, shapes and places, from few samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.asked import Rows
from wayside.schemas.models import GaussianClass, GaussianModel

Values = NDArray[np.float64]
Floor = Callable[[Values], Values]
"""Smallest scatter (d,) of a class of mean (d,): less is an accident of few signs."""

COLOR_FLOOR = (6.0, 6.0, 6.0)
SHAPE_FLOOR = 0.01
PLACE_FLOOR = (2.0, 0.8)
FEWEST = 4
"""A class of fewer samples is not learned."""

SIDES = ("right", "left", "overhead")
"""Classes of a location model: right and left of the path, and above the road."""


@dataclass(frozen=True, slots=True)
class Samples(Rows):
    """What a classifier is asked about, n rows.

    `values` (n, d). `kind` (n,): class of the labelled sign, or "". `sign` (n,): number of the physical sign, or -1.
    `stretch` (n,): part of the road it is from. `fold` (n,): which of the parts held out together.
    """

    values: Values
    kind: NDArray[np.str_]
    sign: NDArray[np.int64]
    stretch: NDArray[np.int64]
    fold: NDArray[np.int64]

    def with_values(self, values: Values) -> Samples:
        """The same samples in another space."""
        return replace(self, values=values)

    def signs(self, name: str) -> int:
        """How many signs of a class there are."""
        return len(np.unique(self.sign[self.kind == name]))

    def weights(self) -> Values:
        """Weights (n,): the views of a sign have 1 together, whatever is no sign has 1."""
        weight = np.ones(len(self))
        own = self.kind != ""
        if own.any():
            _, which, count = np.unique(self.sign[own], return_inverse=True, return_counts=True)
            weight[own] = 1 / count[which]
        return weight


def fit_classes(
    samples: Samples, names: Sequence[str], floor: Floor, prior_signs: float
) -> tuple[GaussianClass, ...]:
    """Classes of those `names` that have samples, every sign of the same weight; thresholds are still to be chosen.

    The covariance is a weighted mean of the covariance of the class and of the pooled one of all classes about their
    means. The pooled one counts as `prior_signs` signs (the mean of an inverse Wishart prior; Friedman 1989 shrinks the
    same way). Its axes are no narrower than the floor.

    Parameters
    ----------
    samples
        Rows without a class take no part.
    names
        In the order of the result.
    floor
        Smallest scatter.
    prior_signs
        At least 0.
    """
    weight, parts = samples.weights(), []
    for name in names:
        own = np.flatnonzero(samples.kind == name)
        if len(own):
            mean, covariance = _moments(samples.values[own], weight[own] / weight[own].sum())
            parts.append((name, mean, covariance, len(own), samples.signs(name)))
    if not parts:
        return ()
    pooled = sum(signs * own for *_, own, _, signs in parts) / sum(part[4] for part in parts)
    return tuple(
        GaussianClass(
            name,
            mean,
            _widened((signs * own + prior_signs * pooled) / (signs + prior_signs), floor(mean)),
            0.0,
            "",
            views,
        )
        for name, mean, own, views, signs in parts
    )


def location_model(places: Values, provenance: str) -> GaussianModel:
    """Where signs stand, (right of the path, above the camera's path) in metres: the mixture of preset `default`.

    places (n, 2): of signs. Overhead panels hang 4 m above the camera or higher; the rest stands right or left. A
    component holds all of its own signs within 4 sigma, because the next sign may lie beyond the last one seen. Those
    of preset `report` are learned by `gates`.
    """
    side, classes = sides(places, 4.0), []
    for name in SIDES:
        own = side == name
        if own.sum() < FEWEST:
            continue
        mean, covariance = moments(
            places[own], np.full(own.sum(), 1 / own.sum()), np.array(PLACE_FLOOR)
        )
        if name == "overhead":
            # Over any lane: three lanes either way are as likely as the middle.
            mean[0], covariance = 0.0, np.diag([5.0**2, covariance[1, 1]])
        rule = "four sigma, drawn only: no gate asks for it"
        classes.append(GaussianClass(name, mean, covariance, 4.0, rule, int(own.sum())))
    return GaussianModel("right_up_m", tuple(classes), provenance)


def sides(places: Values, overhead_m: float) -> NDArray[np.str_]:
    """Which of `SIDES` each place (n, 2), right and up in metres, is on; (n,)."""
    right, up = places.T
    return np.where(up > overhead_m, "overhead", np.where(right >= 0, "right", "left"))


def moments(values: Values, weight: Values, floor: Values) -> tuple[Values, Values]:
    """Weighted mean (d,) and covariance (d, d) of values (n, d); no axis is narrower than its `floor` (d,)."""
    mean, covariance = _moments(values, weight)
    return mean, _widened(covariance, floor)


def _moments(values: Values, weight: Values) -> tuple[Values, Values]:
    mean = weight @ values
    gap = values - mean
    return mean, (gap * weight[:, None]).T @ gap


def _widened(covariance: Values, floor: Values) -> Values:
    lacking = np.maximum(floor**2 - np.diag(covariance), 0.0)
    return np.asarray(covariance + np.diag(lacking) + np.diag((0.1 * floor) ** 2))
