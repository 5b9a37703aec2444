"""Boosted trees: learned by scikit-learn, kept as plain arrays.

scikit-learn gets the number of the bin that a value lies in: its own binning of weighted samples sorts each feature
once for every bin, which took most of the time of the learning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import UsageError
from wayside.schemas.models import TreeModel


@dataclass(frozen=True, slots=True)
class Boosting:
    """Number, size and learning rate of the trees; each tree gets a fraction of the features."""

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


BINS = 255
"""Bins of a feature, of about as many samples each; a feature of fewer values gets one for each of them."""

BINNED = 200_000
"""Most samples that the bins are found from."""


@dataclass(frozen=True, slots=True)
class FittedTrees:
    """A classifier of scikit-learn on bins, and for each feature the largest value of each bin but the last."""

    classifier: Any
    edges: tuple[NDArray[np.float32], ...]

    def log_odds(self, values: NDArray[np.float32]) -> NDArray[np.float64]:
        """Log odds (n,) of values (n, features), by scikit-learn."""
        return np.asarray(self.classifier.decision_function(in_bins(values, self.edges)))


def fit_trees(
    values: NDArray[np.float32],
    positive: NDArray[np.bool_],
    weight: NDArray[np.float64] | None,
    how: Boosting,
    seed: int,
) -> FittedTrees:
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
    some = values[:: -(-len(values) // BINNED)]
    edges = tuple(bin_edges(column) for column in some.T)
    return FittedTrees(
        classifier.fit(in_bins(values, edges), positive, sample_weight=weight), edges
    )


def bin_edges(column: NDArray[np.float32]) -> NDArray[np.float32]:
    """The largest value of each bin of a feature (n,) but the last, rising."""
    found = np.unique(column)
    if len(found) > BINS:
        cuts = np.linspace(0, 1, BINS + 1)[1:-1]
        found = np.append(np.unique(np.quantile(column, cuts, method="lower")), np.inf)
    return found[:-1].astype(np.float32)


def in_bins(
    values: NDArray[np.float32], edges: Sequence[NDArray[np.float32]]
) -> NDArray[np.float32]:
    """The number of the bin of each value (n, features)."""
    result = np.empty(values.shape, np.float32)
    for k, own in enumerate(edges):
        result[:, k] = np.searchsorted(own, values[:, k])
    return result


def exported_trees(
    fitted: FittedTrees, names: tuple[str, ...], threshold: float, provenance: str
) -> TreeModel:
    """The fitted trees as a model of ours: the same sum of leaves of the values themselves, without scikit-learn."""
    trees = [predictor.nodes for stage in fitted.classifier._predictors for predictor in stage]
    most = max(len(nodes) for nodes in trees)

    def column(field: str, kind: type, missing: float) -> NDArray[Any]:
        result: NDArray[Any] = np.full((len(trees), most), missing, kind)
        for t, nodes in enumerate(trees):
            leaf = nodes["is_leaf"].astype(bool)
            result[t, : len(nodes)] = np.where(leaf, missing, nodes[field])
        return result

    value, split = np.zeros((2, len(trees), most), np.float32)
    for t, nodes in enumerate(trees):
        for k in np.flatnonzero(nodes["is_leaf"] == 0):
            split[t, k] = fitted.edges[nodes["feature_idx"][k]][int(nodes["num_threshold"][k])]
        value[t, : len(nodes)] = np.where(nodes["is_leaf"], nodes["value"], 0)
    return TreeModel(
        names,
        float(np.ravel(fitted.classifier._baseline_prediction)[0]),
        column("feature_idx", np.int32, 0),
        split,
        column("left", np.int32, -1),
        column("right", np.int32, -1),
        value,
        threshold,
        provenance,
    )
