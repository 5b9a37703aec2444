"""Boosted trees: learned by scikit-learn, kept as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import UsageError
from wayside.schemas.models import TreeModel


@dataclass(frozen=True, slots=True)
class Boosting:
    """Size and pace of the trees; small and many, each tree sees a share of the features."""

    trees: int = 250
    leaves: int = 24
    learning_rate: float = 0.08
    weight_decay: float = 5.0
    smallest_leaf: int = 20
    feature_fraction: float = 0.3


def needs(package: str) -> UsageError:
    """What to say where a package is absent that only the learning needs."""
    return UsageError(
        f"learning: wanted {package}, found none; install it with pip install 'wayside[learn]'"
    )


def fit_trees(
    values: NDArray[np.float32],
    positive: NDArray[np.bool_],
    weight: NDArray[np.float64] | None,
    how: Boosting,
    seed: int,
) -> Any:
    """Fit gradient-boosted trees with the logistic loss: values (n, features), positive (n,), weight (n,) or None.

    Raises
    ------
    UsageError
        Without scikit-learn, which only the learning needs.
    """
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
    except ImportError as error:
        raise needs("scikit-learn") from error
    classifier = HistGradientBoostingClassifier(
        max_iter=how.trees,
        max_leaf_nodes=how.leaves,
        learning_rate=how.learning_rate,
        l2_regularization=how.weight_decay,
        min_samples_leaf=how.smallest_leaf,
        max_features=how.feature_fraction,
        early_stopping=False,
        random_state=seed,
    )
    return classifier.fit(values, positive, sample_weight=weight)


def exported_trees(
    classifier: Any, names: tuple[str, ...], threshold: float, provenance: str
) -> TreeModel:
    """The fitted trees as a model of ours: the same sum of leaves, without scikit-learn."""
    trees = [predictor.nodes for stage in classifier._predictors for predictor in stage]
    most = max(len(nodes) for nodes in trees)

    def column(field: str, kind: type, missing: float) -> NDArray[Any]:
        result: NDArray[Any] = np.full((len(trees), most), missing, kind)
        for t, nodes in enumerate(trees):
            leaf = nodes["is_leaf"].astype(bool)
            result[t, : len(nodes)] = np.where(leaf, missing, nodes[field])
        return result

    value = np.zeros((len(trees), most), np.float32)
    for t, nodes in enumerate(trees):
        value[t, : len(nodes)] = np.where(nodes["is_leaf"], nodes["value"], 0)
    return TreeModel(
        names,
        float(np.ravel(classifier._baseline_prediction)[0]),
        column("feature_idx", np.int32, 0),
        column("num_threshold", np.float32, 0),
        column("left", np.int32, -1),
        column("right", np.int32, -1),
        value,
        threshold,
        provenance,
    )
