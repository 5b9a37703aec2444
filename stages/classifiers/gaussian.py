"""Gaussian classes, each with a threshold (report eq. 3.1), and mixtures of Gaussian components."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel, MixtureModel


def require_gaussian_model(
    model: GaussianModel, names: tuple[str, ...], spaces: dict[str, int]
) -> None:
    """Refuse a model with no class, an unknown name or space, or another number of dimensions than its space.

    Parameters
    ----------
    model
        The model.
    names
        Names that a class may have.
    spaces
        Spaces that the model may be in, with their dimensions.

    Raises
    ------
    InputError
        The model has another space, class or number of dimensions.
    """
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


def log_density(values: NDArray[np.floating[Any]], model: MixtureModel) -> NDArray[np.float64]:
    """Natural logarithm of the density of a mixture at each value (n, d): (n,)."""
    d = model.mean.shape[1]
    gap = np.asarray(values, np.float64)[:, None] - model.mean
    square = np.einsum("nki,kij,nkj->nk", gap, np.linalg.inv(model.covariance), gap)
    _, log_volume = np.linalg.slogdet(model.covariance)
    parts = np.log(model.weight) - (log_volume + d * np.log(2 * np.pi) + square) / 2
    return np.asarray(np.logaddexp.reduce(parts, axis=1))


def nearest_class(
    values: NDArray[np.floating[Any]], model: GaussianModel, names: tuple[str, ...]
) -> tuple[NDArray[np.int8], NDArray[np.float32], NDArray[np.bool_]]:
    """Class of each value (n, d): the nearest among those whose threshold holds, else the nearest of all.

    Parameters
    ----------
    values
        Coordinates in the model's space; rows that are not finite belong to no class.
    model
        Classes with thresholds, as `require_gaussian_model` demands.
    names
        The names that a class may have; the code of a class is its position here.

    Returns
    -------
    Code (n,) int8, -1 for no class; Mahalanobis distance (n,) float32, nan there; whether a threshold holds (n,) bool.
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
