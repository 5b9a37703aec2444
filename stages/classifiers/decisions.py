"""Learned decisions: evidence, Gaussian classes (report eq. 3.1), mixtures, and their thresholds (report chapter 9)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isnan
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.models import (
    EvidenceModel,
    GaussianClass,
    GaussianModel,
    MixtureModel,
    OperatingPoint,
)
from wayside.stages.kernels import Array

Values = NDArray[np.floating[Any]]


def class_distances(values: Values, classes: Sequence[GaussianClass]) -> Array:
    """Mahalanobis distance of each value (n, d) to each class: (n, classes), eq. 3.1."""
    white = np.linalg.inv(np.linalg.cholesky(np.stack([one.covariance for one in classes])))
    middle = np.einsum("kij,kj->ki", white, np.stack([one.mean for one in classes]))
    k, d = middle.shape
    off = white.reshape(-1, d) @ np.asarray(values, np.float64).T - middle.reshape(-1, 1)
    return np.asarray(np.sqrt((off**2).reshape(k, d, off.shape[1]).sum(axis=1)).T)


def log_normals(values: Values, classes: Sequence[GaussianClass]) -> Array:
    """Natural logarithm of the density of each class at each value (n, d): (n, classes)."""
    return _log_densities(class_distances(values, classes), classes)


def _log_densities(distances: Array, classes: Sequence[GaussianClass]) -> Array:
    volume = np.linalg.slogdet(2 * np.pi * np.stack([one.covariance for one in classes]))[1]
    return np.asarray(-(distances**2 + volume) / 2)


def log_ratios(values: Values, model: GaussianModel) -> Array:
    """Logarithm of the likelihood ratio (report eq. 9.3) of each class to the background at each value (n, d).

    (n, classes), a class as part of the density of signs; nan for values that are not finite.
    """
    return _ratios_at(class_distances(values, (*model.classes, *model.background)), model)


def _ratios_at(distances: Array, model: GaussianModel) -> Array:
    k, parts = len(model.classes), (*model.classes, *model.background)
    count = np.array([one.count for one in parts], np.float64)
    share = np.concatenate([own / own.sum() for own in np.split(count, [k])])
    weighted = np.asarray(_log_densities(distances, parts) + np.log(share))
    if not model.background:
        return weighted
    return np.asarray(weighted[:, :k] - np.logaddexp.reduce(weighted[:, k:], axis=1)[:, None])


def log_ratio(values: Values, model: MixtureModel) -> Array:
    """Natural logarithm of the density of signs by that of other things at each value (n, d): (n,)."""
    parts = [GaussianClass("", *one, 0) for one in zip(model.mean, model.covariance, strict=True)]
    densities = log_normals(values, parts) + np.log(model.weight)
    signs, others = densities[:, : model.signs], densities[:, model.signs :]
    return np.asarray(np.logaddexp.reduce(signs, axis=1) - np.logaddexp.reduce(others, axis=1))


def nearest_class(
    values: Values, model: GaussianModel, names: tuple[str, ...]
) -> tuple[NDArray[np.int8], NDArray[np.float32], Array]:
    """The nearest class of each value (n, d), and the largest logarithm of a likelihood ratio.

    The code (n,) int8 of a class is its position among `names`, -1 for none: rows that are not finite. The others:
    Mahalanobis distance (n,) float32, and the ratio (n,), nan there.
    """
    codes = np.array([names.index(one.name) for one in model.classes], np.int8)
    every = class_distances(values, (*model.classes, *model.background))
    distances = every[:, : len(codes)]
    code = np.where(np.isfinite(values).all(axis=1), codes[distances.argmin(axis=1)], np.int8(-1))
    return code, distances.min(axis=1).astype(np.float32), _ratios_at(every, model).max(axis=1)


def evidence_ratios(model: EvidenceModel, values: Mapping[str, float]) -> dict[str, float]:
    """Log-likelihood ratio of each term by values of the features; a value of nan adds nothing."""
    result = dict.fromkeys(model.terms, 0.0)
    columns = zip(model.features, model.terms, model.knots, model.curves, strict=True)
    for name, term, knots, curve in columns:
        if not isnan(values[name]):
            result[term] += float(np.interp(values[name], knots, curve))
    return result


Gate = TypeVar("Gate", bound=GaussianModel | MixtureModel | EvidenceModel)


def most_powerful(curve: Sequence[OperatingPoint], alpha: float) -> OperatingPoint:
    """The operating point of the most power among those of at most this false-alarm rate; ValueError without one."""
    allowed = [one for one in curve if one.false_alarm <= alpha]
    if not allowed:
        rates = ", ".join(f"{one.false_alarm:g}" for one in curve) or "none"
        raise ValueError(
            f"no operating point has a false-alarm rate of at most {alpha:g}; the rates are {rates}"
        )
    return max(allowed, key=lambda one: one.power)


def at_alpha(model: Gate, alpha: float) -> Gate:
    """The model with the threshold of its most powerful operating point of at most this false-alarm rate.

    A model of evidence decides there, and its range of uncertain log odds stays as wide. ValueError without such a
    point.
    """
    point = most_powerful(model.curve, alpha)
    rule = f"alpha {alpha:g}: most true positives of at most this false positive rate (report chapter 9)"
    new: dict[str, Any] = {"threshold": point.threshold, "threshold_interval": point.interval}
    if isinstance(model, EvidenceModel):
        moved = model.threshold + point.threshold - model.decision
        new |= {"decision": point.threshold, "threshold": moved}
    return replace(model, threshold_rule=rule, **new)
