"""The box classifier: log odds that a box shows the face of a sign, by boosted trees and a patch CNN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import TreeModel
from wayside.stages.classifiers import log_odds
from wayside.stages.detection.feature_vectors import (
    box_features,
    require_names,
)
from wayside.stages.detection.patch_cnn import (
    PATCH_CNN_FEATURES,
    patch_log_odds,
    placement_features,
)
from wayside.stages.detection.patch_features import SIDE, drawn_patches
from wayside.stages.imaging import Pyramid


@dataclass(frozen=True, slots=True)
class BoxClassifier:
    """A tree model with its patch CNN, where it has one; raises InputError where these do not fit."""

    model: TreeModel

    def __post_init__(self) -> None:
        """Refuse a patch CNN for other features or patches."""
        cnn = self.model.patch_cnn
        if cnn is not None:
            require_names("patch CNN", cnn.features, PATCH_CNN_FEATURES, exact=True)
            if cnn.side != SIDE:
                raise InputError(
                    f"patch CNN: wanted patches of {SIDE} samples, found {cnn.side}; learn it again"
                )

    @property
    def threshold(self) -> float:
        """Log odds from which a box is accepted."""
        return self.model.threshold

    def scores(self, levels: Pyramid, regions: Regions, camera: Camera) -> NDArray[np.float32]:
        """Log odds (n,) that the regions show faces; levels: the image at full, half and quarter size."""
        values = box_features(levels, regions, camera)
        return self.combined(levels, regions, values, self.tree_scores(values))

    def tree_scores(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log odds (n,) by the trees alone from `box_features` (n, features)."""
        return log_odds(self.model, values)

    def combined(
        self,
        levels: Pyramid,
        regions: Regions,
        values: NDArray[np.float32],
        trees: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Log odds (n,): the trees' (n,), with the patch CNN's added where those reach its `tree_threshold`."""
        cnn = self.model.patch_cnn
        if cnn is None:
            return trees
        near = np.flatnonzero(trees >= cnn.tree_threshold)
        patches = drawn_patches(levels, regions.box[near])
        seen = patch_log_odds(cnn, patches, placement_features(values[near]))
        scores = trees.copy()
        scores[near] = np.float32(cnn.tree_weight) * trees[near] + seen
        return scores

    def with_network(
        self, scores: NDArray[np.float32], network: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The `scores` (n,) joined with those of a detection network (n,), where it was learned how."""
        how = self.model.with_network
        if how is None:
            return scores
        joined = np.float32(how.own) * scores + np.float32(how.network) * network
        return np.asarray(joined + np.float32(how.shift), np.float32)
