"""Calibration of scores (Platt 1999)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def platt(
    scores: NDArray[np.floating[Any]], positive: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Slopes (k,) and shift that make one log odds of k scores (n, k)."""
    # Newton's method on the logistic loss with Platt's softened targets
    count, rest = positive.sum(), (~positive).sum()
    target = np.where(positive, (count + 1) / (count + 2), 1 / (rest + 2))
    columns = np.concatenate([np.asarray(scores, np.float64), np.ones((len(scores), 1))], axis=1)
    slope = np.zeros(columns.shape[1])
    slope[:-1] = 1 / scores.shape[1]
    for _ in range(50):
        probability = 1 / (1 + np.exp(-columns @ slope))
        weight = np.maximum(probability * (1 - probability), 1e-6)
        curvature = (columns * weight[:, None]).T @ columns + 1e-6 * np.eye(len(slope))
        slope = slope - np.linalg.solve(curvature, columns.T @ (probability - target))
    return slope[:-1], float(slope[-1])
