"""Gaussian classes from few samples: covariances shrunk to that of all classes together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import GaussianClass, GaussianModel

Floor = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Smallest scatter (d,) of a class of mean (d,): less is an accident of few signs."""


@dataclass(frozen=True, slots=True)
class Samples:
    """What a classifier is asked about, n rows.

    values (n, d); kind (n,): class of the labelled sign, "" of what is none; sign (n,): number of the physical sign, -1
    where there is none; stretch (n,): part of the road it is from; fold (n,): which of the parts held out together.
    """

    values: NDArray[np.float64]
    kind: NDArray[np.str_]
    sign: NDArray[np.int64]
    stretch: NDArray[np.int64]
    fold: NDArray[np.int64]

    def __len__(self) -> int:
        """Count rows."""
        return len(self.kind)

    def select(self, rows: NDArray[Any]) -> Samples:
        """Those rows, in that order."""
        return Samples(*(getattr(self, f.name)[rows] for f in fields(self)))

    def with_values(self, values: NDArray[np.float64]) -> Samples:
        """The same samples in another space."""
        return Samples(values, self.kind, self.sign, self.stretch, self.fold)

    def signs(self, name: str) -> int:
        """How many signs of a class there are."""
        return len(np.unique(self.sign[self.kind == name]))

    def weights(self) -> NDArray[np.float64]:
        """Weights (n,): the views of a sign have 1 together, whatever is no sign has 1."""
        weight = np.ones(len(self))
        own = self.kind != ""
        if own.any():
            _, which, count = np.unique(self.sign[own], return_inverse=True, return_counts=True)
            weight[own] = 1 / count[which]
        return weight


@dataclass(frozen=True, slots=True)
class FittedClass:
    """Mean (d,) and covariance (d, d) of a class, and the samples and signs behind them."""

    name: str
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    views: int
    signs: int


def fit_classes(
    samples: Samples, names: Sequence[str], floor: Floor, prior_signs: float
) -> tuple[FittedClass, ...]:
    """Classes of those `names` that have samples, every sign of a class of the same weight.

    The covariance is that of the class and the pooled one of all classes about their means, the latter as if it were of
    `prior_signs` signs more (the mean of an inverse Wishart prior; Friedman 1989 shrinks the same way); its axes are no
    narrower than the floor.

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
    weight = samples.weights()
    parts = []
    for name in names:
        own = np.flatnonzero(samples.kind == name)
        if len(own):
            share = weight[own] / weight[own].sum()
            mean = share @ samples.values[own]
            gap = samples.values[own] - mean
            parts.append(
                (name, mean, (gap * share[:, None]).T @ gap, len(own), samples.signs(name))
            )
    if not parts:
        return ()
    pooled = sum(signs * own for *_, own, _, signs in parts) / sum(part[4] for part in parts)
    classes = []
    for name, mean, own, views, signs in parts:
        covariance = (signs * own + prior_signs * pooled) / (signs + prior_signs)
        least = floor(mean)
        lacking = np.maximum(least**2 - np.diag(covariance), 0.0) + (0.1 * least) ** 2
        classes.append(FittedClass(name, mean, covariance + np.diag(lacking), views, signs))
    return tuple(classes)


def distances_to(
    classes: Sequence[FittedClass], names: Sequence[str], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mahalanobis distances (n, names) of values (n, d) (report eq. 3.1); inf to a class that there is not."""
    distance = np.full((len(values), len(names)), np.inf)
    if classes:
        plain = tuple(GaussianClass(c.name, c.mean, c.covariance, 0.0, "", 0) for c in classes)
        columns = [names.index(c.name) for c in classes]
        distance[:, columns] = GaussianModel("", plain, "").distances(values)
    return distance


def log_density(one: FittedClass, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithm (n,) of the density of a class at values (n, d)."""
    gap = values - one.mean
    squared = np.einsum("ni,ij,nj->n", gap, np.linalg.inv(one.covariance), gap)
    _, volume = np.linalg.slogdet(2 * np.pi * one.covariance)
    return np.asarray(-0.5 * (squared + volume), np.float64)
