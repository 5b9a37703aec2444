"""Learning of the landmark classifier from the landmarks that tracking finds on drives with truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import count, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from wayside.pipeline.evaluation.rendered import camera_pose, match_distance
from wayside.pipeline.learning.labelled import NEAREST
from wayside.pipeline.learning.thresholds import normal_tail, rates_of, score_points
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Landmark, Observation, TrackedFrame
from wayside.schemas.models import EvidenceModel
from wayside.stages.geometry import iou_matrix
from wayside.stages.mapping import FEATURES

ON_FACE, NEAR_FACE = 0.4, 0.15
"""Median overlap (IoU) of the nearest boxes with a true face from which a landmark is that face; overlap with one
above which it may be a part of it."""
FOR, AGAINST = 1, -1
EVIDENCE: tuple[tuple[str, str, int, tuple[float, ...]], ...] = (
    ("score_best", "appearance", FOR, (-2, 0, 2, 4, 6, 8, 12)),
    ("log_views", "views", FOR, (0.7, 1.4, 2.1, 2.9)),
    ("missed", "views", AGAINST, (0, 0.15, 0.4, 0.8)),
    ("log_side", "size", FOR, (-2, -1.2, -0.7, 0)),
    ("oversize", "size", AGAINST, (0, 0.4, 1, 2)),
    ("log_place", "place", FOR, (-12, -9, -7, -6, -5, -4, -3)),
    ("size_scatter", "rigidity", AGAINST, (0, 0.1, 0.2, 0.35)),
    ("depth_sigma", "rigidity", AGAINST, (0, 0.03, 0.1, 0.4)),
    ("surroundings", "surroundings", AGAINST, (-0.3, 0.2, 0.5, 1)),
)
"""Feature, term, the direction in which it may count, and the knots of its curve, over what landmarks show: what is
known from the nature of a sign is not left to a few examples."""
RIDGE, ROUGHNESS = 1.0, 1.0
"""Penalties on the squared slopes of a curve, a third of the range of its knots as unit, and on their differences from
one segment to the next: a curve bends where the examples ask for it, and is straight elsewhere."""
REAL_WEIGHT, RENDERED_SHARE = 200.0, 0.5
"""Weight of all real landmarks together, and that of the rendered ones as a share of it: they fill what real ones lack,
and never outweigh them. Without real ones they weigh as much as real ones would."""
UNCERTAIN = float(np.log(1 / 3))
"""Log odds down to which a face is uncertain, not refused, and a back is one: one in four is a sign."""
PRIOR = float(np.log(3 / 7))
"""Log odds of a landmark before any evidence: of 393 that nine real drives gave, 116 were signs."""
FOLDS = 8
FEWEST_EXAMPLES = 16
RULE = "log odds of 0: as likely a sign as anything else, where three landmarks in ten are signs"
SIGN, NOTHING, NEITHER = 1, 0, -1
Values = NDArray[np.float64]


class LandmarkRow(NamedTuple):
    """A landmark of a drive with truth.

    back: whether it was followed as the back of a panel; usual: whether its boxes were accepted by the threshold that
    runs have.
    """

    features: tuple[float, ...]
    label: int
    back: bool
    usual: bool


@dataclass(frozen=True, slots=True)
class LandmarkSamples:
    """Landmarks of drives with truth, n rows: values (n, features), label (n,) int8, drive (n,) number of the drive.

    back, usual (n,) bool: as in `LandmarkRow`; source (n,) text: what the drive is left out together with, "" where it
    was rendered.
    """

    values: NDArray[np.float32]
    label: NDArray[np.int8]
    drive: NDArray[np.int64]
    back: NDArray[np.bool_]
    source: NDArray[np.str_]
    usual: NDArray[np.bool_]

    def select(self, rows: NDArray[np.bool_]) -> LandmarkSamples:
        """Some of them."""
        return LandmarkSamples(*(getattr(self, column.name)[rows] for column in fields(self)))


def labelled_landmarks(
    frames: Iterable[TrackedFrame], known: KnownPanels, *, usual: bool
) -> list[LandmarkRow]:
    """All landmarks that tracking found on a drive with truth, labelled by it."""
    return [
        LandmarkRow(one.features, label_of(one, known), one.back, usual)
        for frame in frames
        for one in frame.landmarks
    ]


def samples_of(drives: Sequence[tuple[str, Sequence[LandmarkRow]]]) -> LandmarkSamples:
    """The landmarks of several drives, each with its source, in one table; drives are numbered in this order."""
    rows = [row for _, own in drives for row in own]
    counts = [len(own) for _, own in drives]
    values, label, back, usual = zip(*rows, strict=True) if rows else [()] * 4
    return LandmarkSamples(
        np.array(values, np.float32).reshape(-1, len(FEATURES)),
        np.array(label, np.int8),
        np.repeat(np.arange(len(drives)), counts),
        np.array(back, np.bool_),
        np.repeat(np.array([source for source, _ in drives], np.str_), counts),
        np.array(usual, np.bool_),
    )


def learn_landmark_classifier(samples: LandmarkSamples, provenance: str) -> EvidenceModel:
    """Fit the curves of all terms together. Operating points are computed on drives held out in turn.

    Logistic regression on the segments of the curves weighs terms that depend on each other (views of one board) by
    what they say together. Signs and others weigh the same in it, and `PRIOR` says how many are signs. Real drives are
    held out by source, rendered ones by drive; the points are of real ones, as runs see them, if there are enough.

    Raises
    ------
    InputError
        Where there are too few landmarks of either kind.
    """
    own = samples.select(samples.label != NEITHER)
    sign = own.label == SIGN
    if min(sign.sum(), (~sign).sum()) < FEWEST_EXAMPLES or len(np.unique(own.drive)) < 2:
        raise InputError(
            f"landmark classifier: two drives and {FEWEST_EXAMPLES} landmarks of either kind are needed. There are "
            f"{len(np.unique(own.drive))} drives, {sign.sum()} signs and {(~sign).sum()} others. Add drives."
        )
    columns, weight = _segments(own.values), _weights(own, sign)
    held_out = np.empty(len(sign))
    folds = np.where(own.source == "", (own.drive % FOLDS).astype(str), own.source)
    for fold in np.unique(folds):
        held = folds == fold
        slopes = _logistic_regression(columns[~held], sign[~held], weight[~held])
        held_out[held] = columns[held] @ slopes[:-1] + slopes[-1]
    judged = (own.source != "") & own.usual
    if min((judged & sign).sum(), (judged & ~sign).sum()) < FEWEST_EXAMPLES:
        judged = np.ones(len(sign), np.bool_)
    points = score_points(
        held_out[judged] + PRIOR,
        sign[judged],
        own.drive[judged],
        normal_tail,
        rates_of(int((judged & ~sign).sum())),
    )
    slopes = _logistic_regression(columns, sign, weight)
    curves, constant = [], float(slopes[-1]) + PRIOR
    steps = np.split(slopes[:-1], np.cumsum([len(k) - 1 for *_, k in EVIDENCE])[:-1])
    for (name, _, direction, knots), rise in zip(EVIDENCE, steps, strict=True):
        curve = np.concatenate([[0.0], np.cumsum(direction * rise * np.diff(knots))])
        # a term of 0 says nothing: half-way between what signs and others have
        seen = np.interp(own.values[:, FEATURES.index(name)], knots, curve)
        middle = float(np.nanmean(seen[sign]) + np.nanmean(seen[~sign])) / 2
        curves.append(_rounded(curve - middle))
        constant += middle
    names, terms, _, knots_of = zip(*EVIDENCE, strict=True)
    return EvidenceModel(
        names,
        terms,
        tuple(np.array(knots, np.float64) for knots in knots_of),
        tuple(curves),
        shift=round(constant, 5),
        threshold=UNCERTAIN,
        provenance=provenance,
        threshold_rule=RULE,
        curve=points,
    )


def _segments(values: NDArray[np.float32]) -> Values:
    """How far the features (n, f) reach into each segment of their curves (n, s), in its direction; nan: the mean."""
    columns = []
    for name, _, direction, knots in EVIDENCE:
        value = values[:, FEATURES.index(name)].astype(np.float64)
        value = np.where(np.isnan(value), np.nanmean(value) if (value == value).any() else 0, value)
        for low, high in pairwise(knots):
            columns.append(direction * (np.clip(value, low, high) - low))
    return np.column_stack(columns)


def _weights(samples: LandmarkSamples, sign: NDArray[np.bool_]) -> Values:
    """Weights (n,): signs and others alike; a real source by the root of its number, the rendered ones by theirs."""
    weight, real = np.zeros(len(sign)), samples.source != ""
    for source in np.unique(samples.source):
        for kind in (sign, ~sign):
            own = (samples.source == source) & kind
            weight[own] = 1 / np.sqrt(max(own.sum(), 1))
    for rows, share in ((real, 1.0), (~real, RENDERED_SHARE if real.any() else 1.0)):
        for kind in (sign, ~sign):
            own = rows & kind
            weight[own] *= share * REAL_WEIGHT / 2 / max(weight[own].sum(), 1e-9)
    return weight


def _rounded(values: Values) -> Values:
    """To the six digits that the file has."""
    return np.array([float(f"{value:.6g}") for value in values])


def _logistic_regression(columns: Values, sign: NDArray[np.bool_], weight: Values) -> Values:
    """Slopes (s,) of all segments, none of them negative, and a constant, by samples that weigh (n,)."""
    unit = np.concatenate([np.full(len(k) - 1, (k[-1] - k[0]) / 3) for *_, k in EVIDENCE])
    penalty = np.zeros((len(unit) + 1, len(unit) + 1))
    start = 0
    for *_, knots in EVIDENCE:
        own = slice(start, start + len(knots) - 1)
        bend = np.diff(np.eye(len(knots) - 1), axis=0)
        penalty[own, own] = RIDGE / (len(knots) - 1) * np.eye(len(knots) - 1)
        penalty[own, own] += ROUGHNESS * bend.T @ bend
        start = own.stop
    inputs = np.column_stack([columns / unit, np.ones(len(columns))])
    target = np.where(sign, 1.0, -1.0)

    def cost(slopes: Values) -> tuple[float, Values]:
        margin, pull = target * (inputs @ slopes), penalty @ slopes
        gradient = inputs.T @ (-target * weight * expit(-margin)) + pull
        return float(weight @ np.logaddexp(0.0, -margin) + 0.5 * slopes @ pull), gradient

    bounds = [(0.0, None)] * len(unit) + [(None, None)]
    found = minimize(cost, np.zeros(len(unit) + 1), jac=True, bounds=bounds, method="L-BFGS-B")
    return np.append(found.x[:-1] / unit, found.x[-1])


@dataclass(frozen=True, slots=True)
class KnownPanels:
    """Panels of a drive with truth: boxes by frame, and where each stands from the camera of a frame.

    `boxes`: sign, whether it is seen from behind, and box, by frame, of fronts as far as they face the travel.
    `centres`: (3,) by sign. `poses`: rotation (3, 3) to the world and camera centre (3,) by frame, none of a real
    drive. `groups`: numbers of boxes round several panels, which are no sign and no other thing.
    """

    boxes: dict[int, list[tuple[int, bool, tuple[float, float, float, float]]]]
    centres: dict[int, Values]
    poses: dict[int, tuple[Values, Values]]
    groups: frozenset[int] = frozenset()

    @classmethod
    def of(cls, truth: dict[str, Any]) -> KnownPanels:
        """From the content of a `truth.json`."""
        boxes: dict[int, list[tuple[int, bool, tuple[float, float, float, float]]]] = {}
        for sign in truth["signs"]:
            for view in sign["frames"]:
                back = view["side"] == "back"
                if back or sign["faces_travel"]:
                    entry = (sign["id"], back, tuple(view["box"]))
                    boxes.setdefault(view["frame"], []).append(entry)
        centres = {
            sign["id"]: np.array(sign["centre"], np.float64)
            for sign in truth["signs"]
            if "centre" in sign
        }
        poses = {frame["index"]: camera_pose(frame) for frame in truth["frames"]}
        return cls(boxes, centres, poses)

    @classmethod
    def of_labels(cls, labels: dict[str, Any], checked: dict[str, Any]) -> KnownPanels:
        """From the content of a `labels.json`, and from the checked boxes of the drive by number of the image."""
        boxes: dict[int, list[tuple[int, bool, tuple[float, float, float, float]]]] = {}
        numbers = count()
        groups = set()
        for sign in labels["signs"]:
            number, back = next(numbers), sign.get("facing") == "back"
            if sign.get("group"):
                groups.add(number)
            for view in sign["boxes"]:
                boxes.setdefault(view["i"], []).append((number, back, tuple(view["box"])))
        for frame, seen in checked.items():
            for box in seen.get("signs", ()):
                boxes.setdefault(int(frame), []).append((next(numbers), False, tuple(box[:4])))
        return cls(boxes, {}, {}, frozenset(groups))

    def stands_at(self, landmark: Landmark, sign: int) -> bool:
        """Whether a landmark was measured where that sign stands, as `wayside evaluate` matches them."""
        rotation, origin = self.poses[landmark.best_frame]
        actual = (self.centres[sign] - origin) @ rotation
        return bool(np.isfinite(match_distance(landmark.position - actual, actual)))


def label_of(landmark: Landmark, known: KnownPanels) -> int:
    """`SIGN` where the nearest views lie on one true panel, seen from its side, and it was measured there.

    Without the boxes it is `NEITHER`: perhaps a part of that panel. All else is `NOTHING`: half a face at a wrong
    depth, or rays that met by chance, are no signs either. On real drives all boxes there are decide.
    """
    if not known.poses:
        return _label_by_hand(landmark, known)
    there = {s: on for s, on in _faces(landmark, known).items() if known.stands_at(landmark, s)}
    return SIGN if any(there.values()) else NEITHER if there else NOTHING


def _label_by_hand(landmark: Landmark, known: KnownPanels) -> int:
    """By hand-made boxes, which leave out images of a sign: where both have one they must overlap, by the median."""
    overlaps = _overlaps(landmark.views, landmark.back, known)
    on_face = [
        np.median(own) >= ON_FACE for sign, own in overlaps.items() if sign not in known.groups
    ]
    touched = any(max(own) > NEAR_FACE for own in overlaps.values())
    return SIGN if any(on_face) else NEITHER if touched else NOTHING


def label_in_images(landmark: Landmark, known: KnownPanels) -> int:
    """The same by the boxes alone, wherever the landmark was measured."""
    touched = _faces(landmark, known)
    return SIGN if any(touched.values()) else NEITHER if touched else NOTHING


def _faces(landmark: Landmark, known: KnownPanels) -> dict[int, bool]:
    """The signs that a landmark touches in its nearest views, and whether it lies on their face."""
    views = sorted(landmark.views, key=lambda view: -view.frame)[:NEAREST]
    overlaps = _overlaps(views, landmark.back, known)
    return {
        sign: float(np.median([*own, *[0.0] * (len(views) - len(own))])) >= ON_FACE
        for sign, own in overlaps.items()
        if max(own) > NEAR_FACE
    }


def _overlaps(
    views: Iterable[Observation], back: bool, known: KnownPanels
) -> dict[int, list[float]]:
    """Overlaps (IoU) of views with the boxes of each sign seen from that side, one for each image that has both."""
    overlaps: dict[int, list[float]] = {}
    for view in views:
        for sign, side, box in known.boxes.get(view.frame, ()):
            if side == back:
                overlap = iou_matrix(np.array([view.box]), np.array([box]))[0, 0]
                overlaps.setdefault(sign, []).append(float(overlap))
    return overlaps
