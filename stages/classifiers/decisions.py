"""Learned decisions: evidence, Gaussian classes (report eq. 3.1), mixtures, and their thresholds (report chapter 9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isnan
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.models import EvidenceModel, GaussianModel, MixtureModel, OperatingPoint


def require_gaussian_model(
    model: GaussianModel, names: tuple[str, ...], spaces: dict[str, int]
) -> None:
    """Raise InputError for a model with no class, an unknown name or space, or other dimensions than its space has."""
    if model.space not in spaces:
        raise InputError(
            f"model: there is no space {model.space!r} among {', '.join(spaces)}. Learn it again."
        )
    if not model.classes:
        raise InputError("model: it has no class. Choose another.")
    dimensions = spaces[model.space]
    for one in model.classes:
        if one.name not in names:
            raise InputError(
                f"model: there is no class {one.name!r} among {', '.join(names)}. Correct its name."
            )
        if one.mean.shape != (dimensions,) or one.covariance.shape != (dimensions, dimensions):
            raise InputError(
                f"model: a class has {dimensions} numbers in space {model.space!r}, but {one.name!r} has a mean "
                f"{one.mean.shape} and covariance {one.covariance.shape}. Learn it again."
            )


def class_distances(values: NDArray[np.floating[Any]], model: GaussianModel) -> NDArray[np.float64]:
    """Mahalanobis distance of each value (n, d) to each class: (n, classes), eq. 3.1."""
    result = np.empty((len(values), len(model.classes)))
    for j, one in enumerate(model.classes):
        difference = np.asarray(values, np.float64) - one.mean
        result[:, j] = np.sqrt(
            np.einsum("ni,ij,nj->n", difference, np.linalg.inv(one.covariance), difference)
        )
    return result


def log_ratio(values: NDArray[np.floating[Any]], model: MixtureModel) -> NDArray[np.float64]:
    """Natural logarithm of the density of signs by that of other things at each value (n, d): (n,)."""
    d = model.mean.shape[1]
    gap = np.asarray(values, np.float64)[:, None] - model.mean
    square = np.einsum("nki,kij,nkj->nk", gap, np.linalg.inv(model.covariance), gap)
    _, log_volume = np.linalg.slogdet(model.covariance)
    parts = np.log(model.weight) - (log_volume + d * np.log(2 * np.pi) + square) / 2
    signs, others = parts[:, : model.signs], parts[:, model.signs :]
    return np.asarray(np.logaddexp.reduce(signs, axis=1) - np.logaddexp.reduce(others, axis=1))


def nearest_class(
    values: NDArray[np.floating[Any]], model: GaussianModel, names: tuple[str, ...]
) -> tuple[NDArray[np.int8], NDArray[np.float32], NDArray[np.bool_]]:
    """Class of each value (n, d): the nearest among those whose threshold holds, else the nearest of all.

    The code (n,) int8 of a class is its position among `names`, -1 for none: rows that are not finite. The others:
    Mahalanobis distance (n,) float32, nan there; whether a threshold holds (n,) bool.
    """
    codes = np.array([names.index(one.name) for one in model.classes], np.int8)
    code = np.full(len(values), -1, np.int8)
    distance = np.full(len(values), np.nan, np.float32)
    accepted = np.zeros(len(values), bool)
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if len(known) == 0:
        return code, distance, accepted
    distances = class_distances(values[known], model)
    holds = distances <= np.array([one.threshold for one in model.classes])
    any_holds = np.asarray(holds.any(axis=1))
    best = np.where(holds | ~any_holds[:, None], distances, np.inf).argmin(axis=1)
    code[known] = codes[best]
    distance[known] = distances[np.arange(len(known)), best]
    accepted[known] = any_holds
    return code, distance, accepted


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
    """The model with the thresholds of its most powerful operating point of at most this false-alarm rate.

    A model of evidence decides there, and its range of uncertain log odds stays as wide. ValueError without such a
    point.
    """
    point = most_powerful(model.curve, alpha)
    rule = f"alpha {alpha:g}: most true positives of at most this false positive rate (report chapter 9)"
    chosen: list[dict[str, Any]] = [
        {"threshold": threshold, "threshold_rule": rule, "threshold_interval": interval}
        for threshold, interval in zip(
            point.thresholds, point.intervals or (None,) * len(point.thresholds), strict=True
        )
    ]
    if isinstance(model, GaussianModel):
        pairs = zip(model.classes, chosen, strict=True)
        return replace(model, classes=tuple(replace(one, **new) for one, new in pairs))
    (new,) = chosen
    if isinstance(model, EvidenceModel):
        decision = new["threshold"]
        new |= {"decision": decision, "threshold": model.threshold + decision - model.decision}
    return replace(model, **new)
