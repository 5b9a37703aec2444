"""The judge of a place is learned from the places that tracking finds on drives with truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.calibration import platt
from wayside.schemas.errors import InputError
from wayside.schemas.models import TreeModel
from wayside.schemas.motion import Moved, Place, View
from wayside.schemas.settings import TrackSettings
from wayside.stages.place import FEATURES
from wayside.stages.track import track

ON_FACE, NEAR_FACE = 0.4, 0.15
"""Median overlap (IoU) of the nearest boxes with a true face from which a place is that face; overlap with one
above which it is nobody's example."""
NEAREST = 3
FEWEST = 2
"""Places of fewer views than are reported teach, too: there are more of them, and the judge knows the number."""
SMALL = Boosting(
    trees=80, leaves=5, pace=0.06, shrinkage=2.0, smallest_leaf=8, share_of_features=0.5
)
ACCEPT = -1.4
"""Log odds below which a place is refused outright; between that and the confidence setting it is uncertain."""
SIGN, NOTHING, NEITHER = 1, 0, -1


Tracked = tuple[Iterable[Moved], TreeModel | None, dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Places:
    """Places of drives with truth: values (n, features), label (n,) int8, drive (n,) number of the drive."""

    values: NDArray[np.float32]
    label: NDArray[np.int8]
    drive: NDArray[np.int64]


def learn_place_judge(drives: Iterable[Tracked], provenance: str) -> TreeModel:
    """Learn the judge of places from tracked drives with truth.

    The scores of the candidates must come from a judge of views that has not seen the drive, or the places look surer
    than places of a new drive ever will.

    Parameters
    ----------
    drives
        Frames with candidates and motion, the judge of one view that has not seen them, the truth of the drive. A drive
        may come more than once, looked at by judges of different bars.
    provenance
        Where the drives are from, kept in the model.

    Raises
    ------
    InputError
        Where there are too few places of either kind.
    """
    return fit_place_judge(gather_places(drives), provenance)


def fit_place_judge(places: Places, provenance: str) -> TreeModel:
    """Fit and calibrate the judge; raises InputError where there are too few places of either kind."""
    known = places.label != NEITHER
    values, sign = places.values[known], places.label[known] == SIGN
    drive = places.drive[known]
    if min(sign.sum(), (~sign).sum()) < 2 * SMALL.smallest_leaf or len(np.unique(drive)) < 2:
        raise InputError(
            f"place judge: wanted two drives and {2 * SMALL.smallest_leaf} places of either kind, found "
            f"{len(np.unique(drive))} drives, {sign.sum()} signs and {(~sign).sum()} others; add drives"
        )
    slope, shift = calibration(values, sign, drive)
    model = exported_trees(fit_trees(values, sign, None, SMALL, 1), FEATURES, ACCEPT, provenance)
    return replace(
        model,
        bias=slope * model.bias + shift,
        value=(slope * model.value).astype(np.float32),
    )


def gather_places(drives: Iterable[Tracked]) -> Places:
    """All places that tracking finds, labelled by the truth."""
    values: list[tuple[float, ...]] = []
    labels: list[int] = []
    names: list[str] = []
    for moved, judge, truth in drives:
        known = faces_by_frame(truth)
        settings = TrackSettings(fewest_views=FEWEST)
        for settled in track(iter(moved), settings, view_judge=judge):
            for place in settled.places:
                values.append(place.evidence)
                labels.append(label_of(place, known))
                names.append(truth["name"])
    return Places(
        np.array(values, np.float32).reshape(-1, len(FEATURES)),
        np.array(labels, np.int8),
        np.unique(names, return_inverse=True)[1].astype(np.int64),
    )


Face = tuple[int, bool, tuple[float, float, float, float]]
"""Sign, whether its front faces the travel, box."""


def faces_by_frame(truth: dict[str, Any]) -> dict[int, list[Face]]:
    """True boxes of each frame."""
    known: dict[int, list[Face]] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            front = sign["faces_travel"] and view["side"] == "front"
            known.setdefault(view["frame"], []).append((sign["id"], front, tuple(view["box"])))
    return known


def label_of(place: Place, known: dict[int, list[Face]]) -> int:
    """Whether the nearest views of a place lie on one true face, on nothing (or the back of one), or in between."""
    near = sorted(place.views, key=lambda view: -view.frame)[:NEAREST]
    overlaps: dict[int, list[float]] = {}
    for view in near:
        for sign, front, box in known.get(view.frame, ()):
            if front:
                overlaps.setdefault(sign, []).append(overlap(view, box))
    if any(_on_face(own, near) for own in overlaps.values()):
        return SIGN
    between = any(max(own) > NEAR_FACE for own in overlaps.values())
    return NEITHER if between else NOTHING


def _on_face(overlaps: Sequence[float], near: Sequence[View]) -> bool:
    return float(np.median([*overlaps, *[0.0] * (len(near) - len(overlaps))])) >= ON_FACE


def overlap(view: View, box: Sequence[float]) -> float:
    """Intersection over union of a view's box and a true box."""
    wide = min(view.box[2], box[2]) - max(view.box[0], box[0])
    tall = min(view.box[3], box[3]) - max(view.box[1], box[1])
    if wide <= 0 or tall <= 0:
        return 0.0
    own = (view.box[2] - view.box[0]) * (view.box[3] - view.box[1])
    return wide * tall / (own + (box[2] - box[0]) * (box[3] - box[1]) - wide * tall)


def calibration(
    values: NDArray[np.float32], sign: NDArray[np.bool_], drive: NDArray[np.int64]
) -> tuple[float, float]:
    """Slope and shift that turn the trees' sums into log odds that hold on drives they have not seen (Platt 1999)."""
    held_out = np.empty(len(values))
    for number in np.unique(drive):
        own = drive == number
        held_out[own] = fit_trees(values[~own], sign[~own], None, SMALL, 1).decision_function(
            values[own]
        )
    slope, shift = platt(held_out[:, None], sign)
    return float(slope[0]), shift
