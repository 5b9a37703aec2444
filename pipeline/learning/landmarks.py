"""Learning of the landmark classifier from the landmarks that tracking finds on drives with truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.cross_validation import platt
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Landmark, Observation
from wayside.schemas.models import TreeModel
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import MappingSettings, TrackSettings
from wayside.stages.detection import BoxClassifier
from wayside.stages.geometry import iou_matrix
from wayside.stages.mapping import FEATURES, SideClassifiers, track
from wayside.stages.panel import PanelMethod

ON_FACE, NEAR_FACE = 0.4, 0.15
"""Median overlap (IoU) of the nearest boxes with a true face from which a landmark is that face; overlap with one
above which it is no example."""
NEAREST = 3
FEWEST = 2
"""Landmarks of fewer views than are reported are learned from, too: there are more, and the number is a feature."""
TREES = Boosting(
    trees=80, leaves=5, learning_rate=0.06, weight_decay=2.0, smallest_leaf=8, feature_fraction=0.5
)
ACCEPT, ACCEPT_BACK = -1.4, 0.0
"""Log odds below which a landmark is refused; between that and the confidence setting a face is uncertain. A back
is reported where that is likelier than not."""
SIGN, NOTHING, NEITHER = 1, 0, -1


@dataclass(frozen=True, slots=True)
class PosedDrive:
    """A drive with truth up to its motion: frames with candidates, and the box classifiers that scored them.

    panel: how panels are measured; None: they are not.
    """

    moved: Iterable[PosedDetections]
    face: TreeModel | None
    back: TreeModel | None
    truth: dict[str, Any]
    panel: PanelMethod | None = None


@dataclass(frozen=True, slots=True)
class LandmarkSamples:
    """Landmarks of drives with truth, n rows: values (n, features), label (n,) int8, drive (n,) number of the drive.

    back (n,) bool: whether it was followed as the back of a panel.
    """

    values: NDArray[np.float32]
    label: NDArray[np.int8]
    drive: NDArray[np.int64]
    back: NDArray[np.bool_]

    def side(self, *, back: bool) -> LandmarkSamples:
        """Those that were followed as backs, or as faces."""
        own = self.back == back
        return LandmarkSamples(self.values[own], self.label[own], self.drive[own], self.back[own])


def gather_landmarks(drives: Iterable[PosedDrive]) -> LandmarkSamples:
    """All landmarks that tracking finds on drives with truth, labelled by it.

    The scores of the candidates must be out of fold, or they are higher than those of a new drive. A drive may come
    more than once, with classifiers of different thresholds.
    """
    values: list[tuple[float, ...]] = []
    labels: list[int] = []
    names: list[str] = []
    backs: list[bool] = []
    for drive in drives:
        known = panels_by_frame(drive.truth)
        settings = MappingSettings(TrackSettings(fewest_views=FEWEST))
        front, back = (
            SideClassifiers(None if model is None else BoxClassifier(model))
            for model in (drive.face, drive.back)
        )
        behind = None if drive.back is None else back
        for frame in track(iter(drive.moved), settings, front, behind, drive.panel):
            for landmark in frame.landmarks:
                values.append(landmark.features)
                labels.append(label_of(landmark, known))
                names.append(drive.truth["name"])
                backs.append(landmark.back)
    return LandmarkSamples(
        np.array(values, np.float32).reshape(-1, len(FEATURES)),
        np.array(labels, np.int8),
        np.unique(names, return_inverse=True)[1].astype(np.int64),
        np.array(backs, np.bool_),
    )


def joined(parts: Sequence[LandmarkSamples]) -> LandmarkSamples:
    """The landmarks of several drives, a part each, in one; drives are numbered by the order of the parts."""
    return LandmarkSamples(
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.label for part in parts]),
        np.repeat(np.arange(len(parts)), [len(part.label) for part in parts]),
        np.concatenate([part.back for part in parts]),
    )


def learn_landmark_classifier(
    places: LandmarkSamples, provenance: str, accept: float = ACCEPT
) -> TreeModel:
    """Fit and calibrate the landmark classifier; raises InputError where there are too few of either kind."""
    known = places.label != NEITHER
    values, sign = places.values[known], places.label[known] == SIGN
    drive = places.drive[known]
    if min(sign.sum(), (~sign).sum()) < 2 * TREES.smallest_leaf or len(np.unique(drive)) < 2:
        raise InputError(
            f"landmark classifier: wanted two drives and {2 * TREES.smallest_leaf} landmarks of either kind, found "
            f"{len(np.unique(drive))} drives, {sign.sum()} signs and {(~sign).sum()} others; add drives"
        )
    slope, shift = calibration(values, sign, drive)
    model = exported_trees(fit_trees(values, sign, None, TREES, 1), FEATURES, accept, provenance)
    return replace(
        model,
        bias=slope * model.bias + shift,
        value=(slope * model.value).astype(np.float32),
    )


Panel = tuple[int, bool, tuple[float, float, float, float]]
"""Sign, whether it is seen from behind, box."""


def panels_by_frame(truth: dict[str, Any]) -> dict[int, list[Panel]]:
    """True boxes of each frame; fronts as far as they face the travel."""
    known: dict[int, list[Panel]] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            back = view["side"] == "back"
            if back or sign["faces_travel"]:
                known.setdefault(view["frame"], []).append((sign["id"], back, tuple(view["box"])))
    return known


def label_of(place: Landmark, known: dict[int, list[Panel]]) -> int:
    """Whether the nearest views of a landmark lie on one true panel, seen from its side, on none, or in between."""
    near = sorted(place.views, key=lambda view: -view.frame)[:NEAREST]
    overlaps: dict[int, list[float]] = {}
    for view in near:
        for sign, back, box in known.get(view.frame, ()):
            if back == place.back:
                overlap = iou_matrix(np.array([view.box]), np.array([box]))[0, 0]
                overlaps.setdefault(sign, []).append(float(overlap))
    if any(_on_face(own, near) for own in overlaps.values()):
        return SIGN
    between = any(max(own) > NEAR_FACE for own in overlaps.values())
    return NEITHER if between else NOTHING


def _on_face(overlaps: Sequence[float], near: Sequence[Observation]) -> bool:
    return float(np.median([*overlaps, *[0.0] * (len(near) - len(overlaps))])) >= ON_FACE


def calibration(
    values: NDArray[np.float32], sign: NDArray[np.bool_], drive: NDArray[np.int64]
) -> tuple[float, float]:
    """Slope and shift that turn the trees' sums into log odds that hold on drives they have not seen (Platt 1999)."""
    held_out = np.empty(len(values))
    for number in np.unique(drive):
        own = drive == number
        held_out[own] = fit_trees(values[~own], sign[~own], None, TREES, 1).decision_function(
            values[own]
        )
    slope, shift = platt(held_out[:, None], sign)
    return float(slope[0]), shift
