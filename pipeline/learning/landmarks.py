"""Learning of the landmark classifier from the landmarks that tracking finds on drives with truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from wayside.pipeline.evaluate_rendered import camera_pose, match_distance
from wayside.pipeline.learning.score_calibration import platt
from wayside.pipeline.roc.score_points import (
    DECISION_RULE,
    normal_tail,
    rates_of,
    score_points,
)
from wayside.schemas.errors import InputError
from wayside.schemas.landmarks import Landmark
from wayside.schemas.models import EvidenceModel, GaussianModel
from wayside.schemas.motion import PosedDetections
from wayside.schemas.settings import MappingSettings, TrackSettings
from wayside.stages.detection import BoxClassifier
from wayside.stages.geometry import iou_matrix
from wayside.stages.mapping import FEATURES, LandmarkClassifier, SideClassifiers, track
from wayside.stages.panel import PanelMethod

ON_FACE, NEAR_FACE = 0.4, 0.15
"""Median overlap (IoU) of the nearest boxes with a true face from which a landmark is that face; overlap with one
above which it may be a part of it."""
NEAREST = 3
FEWEST = 2
"""Landmarks of fewer views than are reported are learned from, too: there are more, and the number is a feature."""
FOR, AGAINST = 1, -1
EVIDENCE = (
    ("score_best", "appearance", FOR, 6.0),
    ("score_mean", "appearance", FOR, 6.0),
    ("color_certainty", "appearance", FOR, 0.0),
    ("shape_certainty", "appearance", FOR, 0.0),
    ("log_views", "views", FOR, 2.5),
    ("missed", "views", AGAINST, 0.0),
    ("log_width", "size", AGAINST, 0.0),
    ("log_height", "size", FOR, -0.7),
    ("log_height", "size", AGAINST, 0.0),
    ("place_sigmas", "place", AGAINST, 0.0),
    ("size_scatter", "rigidity", AGAINST, 0.0),
    ("depth_sigma", "rigidity", AGAINST, 0.0),
    ("agreement", "registration", FOR, 8.0),
    ("surroundings", "surroundings", AGAINST, 0.0),
)
"""Feature, term, the direction in which it may count, and the value beyond which it is as good as can be: what is known
from the nature of a sign is not left to a few examples. Sizes count where they are unusual: below half a metre, above
one."""
EDGE = 0.01
"""Share of the signs that lie beyond the bound of a feature, where it speaks against them. Other roads have other
signs: what is more unusual than nearly all signs of the drives at hand counts as those do."""
REGULARISATION = 0.3
"""Inverse of the penalty on squared weights in standard deviations."""
MEASURED_IN_IMAGES = (
    ("score_best", "score_mean"),
    ("color_certainty",),
    ("shape_certainty",),
    ("size_scatter",),
    ("depth_sigma",),
    ("agreement",),
)
"""Features by which images of other roads and cameras differ from those at hand; metres and counts do not. Those of a
group are jittered alike: what makes the highest score another makes the mean score another."""
JITTER, REPEATED = 1.5, 8
"""Standard deviation that is added to them, as a fraction of that among landmarks of one kind, and how often each
landmark is learned from. On real images that the networks have not learned from, their log odds are worth half of what
they are on rendered ones. Numbers that scatter this much more weigh a third, and the others more."""
FALSE_ALARM, FALSE_ALARM_BACK = 0.01, 0.1
"""Stated share of the landmarks that are no signs to be reported as signs, on drives held out in turn; and of backs."""
FOLDS, SEED = 8, 1
FEWEST_EXAMPLES = 16
UNCERTAIN_TIMES = 3.0
"""A face is uncertain, not refused, up to so many times the false-alarm rate of the decision. A back is refused."""
SIGN, NOTHING, NEITHER = 1, 0, -1
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PosedDrive:
    """A drive with known panels up to its motion: frames with candidates, and the box classifiers that scored them.

    panel: how panels are measured; None: they are not. location: where signs stand.
    """

    name: str
    moved: Iterable[PosedDetections]
    face: BoxClassifier | None
    back: BoxClassifier | None
    known: KnownPanels
    panel: PanelMethod | None = None
    location: GaussianModel | None = None


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

    The detector must not have learned from the drives, or its scores are higher than those of a new one. A drive may
    come more than once, with classifiers of different thresholds.
    """
    values: list[tuple[float, ...]] = []
    labels: list[int] = []
    names: list[str] = []
    backs: list[bool] = []
    for drive in drives:
        settings = MappingSettings(TrackSettings(fewest_views=FEWEST))
        front, back = (
            SideClassifiers(classifier, LandmarkClassifier(None, drive.location))
            for classifier in (drive.face, drive.back)
        )
        behind = None if drive.back is None else back
        for frame in track(iter(drive.moved), settings, front, behind, drive.panel):
            for landmark in frame.landmarks:
                values.append(landmark.features)
                labels.append(label_of(landmark, drive.known))
                names.append(drive.name)
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
    samples: LandmarkSamples,
    provenance: str,
    false_alarm: float = FALSE_ALARM,
    uncertain_times: float = UNCERTAIN_TIMES,
) -> EvidenceModel:
    """Fit the log-likelihood ratios of all terms together and calibrate their sum on drives held out in turn.

    Logistic regression on the bounded features weighs terms that depend on each other (many views of a shop front)
    by what they say together. Signs and others weigh the same in it. Accepted, if only as uncertain, is what this
    many times the false-alarm rate lets through.

    Raises
    ------
    InputError
        Where there are too few landmarks of either kind.
    """
    # neither duplicates nor what the vehicle drove over
    measured = ~np.isnan(samples.values).any(axis=1)
    known = measured & (samples.label != NEITHER)
    sign, drive = samples.label[known] == SIGN, samples.drive[known]
    if min(sign.sum(), (~sign).sum()) < FEWEST_EXAMPLES or len(np.unique(drive)) < 2:
        raise InputError(
            f"landmark classifier: wanted two drives and {FEWEST_EXAMPLES} landmarks of either kind, found "
            f"{len(np.unique(drive))} drives, {sign.sum()} signs and {(~sign).sum()} others; add drives"
        )
    names, terms, directions, limits = zip(*EVIDENCE, strict=True)
    direction = np.array(directions, np.float64)
    values = _jittered(samples.values[known].astype(np.float64), sign)
    rates = rates_of(int((~sign).sum()))
    sign, drive = np.tile(sign, REPEATED), np.tile(drive, REPEATED)
    columns = values[:, [FEATURES.index(name) for name in names]]
    low, high = _bounds(columns[sign], direction, np.array(limits))
    bounded = np.clip(columns, low, high)
    middle = (bounded[sign].mean(axis=0) + bounded[~sign].mean(axis=0)) / 2
    held_out = _held_out_sums(bounded - middle, sign, drive, direction)
    slope, shift = _calibration(held_out, sign, false_alarm)
    uncertain = false_alarm * uncertain_times
    points = score_points(
        slope * held_out + shift, sign, drive, normal_tail, {*rates, false_alarm, uncertain}
    )
    by_rate = {one.false_alarm: one for one in points}
    decision, accepted = by_rate[false_alarm], by_rate[uncertain]
    rule = f"alpha {false_alarm:g}: log odds of 0 {DECISION_RULE}"
    if uncertain > false_alarm:
        rule += f"; uncertain down to the log odds of alpha {uncertain:g}"
    weight, constant = _logistic_regression(bounded - middle, sign, direction)
    return EvidenceModel(
        names,
        terms,
        _rounded(low),
        _rounded(high),
        _rounded(middle),
        _rounded(slope * weight),
        shift=round(slope * constant + shift, 5),
        threshold=round(accepted.thresholds[0], 4) + 0.0,  # no -0.0
        provenance=provenance,
        threshold_rule=rule,
        threshold_interval=decision.intervals[0] if decision.intervals else None,
        curve=points,
    )


def _jittered(values: Values, sign: NDArray[np.bool_]) -> Values:
    """The features (n, features) `REPEATED` times, (n * `REPEATED`, features), those measured in images jittered."""
    rng = np.random.default_rng(SEED)
    scatter = np.sqrt((values[sign].var(axis=0) + values[~sign].var(axis=0)) / 2)
    repeated = np.tile(values, (REPEATED, 1))
    for names in MEASURED_IN_IMAGES:
        deviation = rng.normal(0, JITTER, len(repeated))
        for column in map(FEATURES.index, names):
            repeated[:, column] += scatter[column] * deviation
    return repeated


def _bounds(signs: Values, direction: Values, limit: Values) -> tuple[Values, Values]:
    """Bounds (f,) of the features, by the values (n, f) of the signs and the limits (f,) of what is good."""
    low, high = np.quantile(signs, [EDGE, 1 - EDGE], axis=0)
    least, most = np.minimum(low, limit), np.maximum(high, limit)
    return np.where(direction == FOR, least, limit), np.where(direction == FOR, limit, most)


def _rounded(values: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """To the six digits that the file has."""
    return np.array([float(f"{value:.6g}") for value in values])


def _logistic_regression(
    values: Values, sign: NDArray[np.bool_], direction: Values
) -> tuple[Values, float]:
    """Weights (f,) in given directions, and a constant; both kinds weigh the same, large weights cost."""
    scale = direction * np.maximum(values.std(axis=0), 1e-6)
    columns = np.column_stack([values / scale, np.ones(len(values))])
    target = np.where(sign, 1.0, -1.0)
    balance = np.where(sign, 0.5 / sign.mean(), 0.5 / (~sign).mean())

    def cost(weights: Values) -> tuple[float, Values]:
        margin = target * (columns @ weights)
        penalty = weights * np.append(np.full(len(scale), 1 / REGULARISATION), 0.0)
        slope = columns.T @ (-target * balance * expit(-margin)) + penalty
        return float(balance @ np.logaddexp(0.0, -margin) + 0.5 * weights @ penalty), slope

    bounds = [(0.0, None)] * len(scale) + [(None, None)]
    found = minimize(cost, np.zeros(columns.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B")
    return found.x[:-1] / scale, float(found.x[-1])


def _held_out_sums(
    values: Values, sign: NDArray[np.bool_], drive: NDArray[np.int64], direction: Values
) -> Values:
    """The sum (n,) of each landmark by weights that were learned without its drive."""
    held_out = np.empty(len(values))
    folds = drive % FOLDS if len(np.unique(drive)) > FOLDS else drive
    for fold in np.unique(folds):
        own = folds == fold
        weight, constant = _logistic_regression(values[~own], sign[~own], direction)
        held_out[own] = values[own] @ weight + constant
    return held_out


def _calibration(
    held_out: Values, sign: NDArray[np.bool_], false_alarm: float
) -> tuple[float, float]:
    """Slope and shift that turn the sums into log odds that hold on drives they have not seen (Platt 1999).

    Log odds of 0, where landmarks are reported as signs, are put where that share of what is no sign lies above, as
    Neyman and Pearson do (report chapter 9): how much looks like a sign differs from road to road, what it looks like
    much less. As in the report a normal density is fitted to what is no sign: its largest values are too few to count.
    """
    (slope,), _ = platt(held_out[:, None], sign)
    others = held_out[~sign]
    (limit,) = normal_tail(others, np.ones(len(others)), np.array([false_alarm]))
    return float(slope), -float(slope * limit)


@dataclass(frozen=True, slots=True)
class KnownPanels:
    """Panels of a drive with truth: boxes by frame, and where each stands from the camera of a frame.

    boxes: sign, whether it is seen from behind, and box, by frame, of fronts as far as they face the travel; centres:
    (3,) by sign; poses: rotation (3, 3) to the world and camera centre (3,) by frame.
    """

    boxes: dict[int, list[tuple[int, bool, tuple[float, float, float, float]]]]
    centres: dict[int, Values]
    poses: dict[int, tuple[Values, Values]]

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

    def stands_at(self, landmark: Landmark, sign: int) -> bool:
        """Whether a landmark was measured where that sign stands, as `wayside evaluate` matches them."""
        rotation, origin = self.poses[landmark.best_frame]
        actual = (self.centres[sign] - origin) @ rotation
        return bool(np.isfinite(match_distance(landmark.position - actual, actual)))


def label_of(landmark: Landmark, known: KnownPanels) -> int:
    """`SIGN` where the nearest views lie on one true panel, seen from its side, and it was measured there.

    Without the boxes it is `NEITHER`: perhaps a part of that panel. All else is `NOTHING`: half a face at a wrong
    depth, or rays that met by chance, are no signs either.
    """
    there = {s: on for s, on in _faces(landmark, known).items() if known.stands_at(landmark, s)}
    return SIGN if any(there.values()) else NEITHER if there else NOTHING


def label_in_images(landmark: Landmark, known: KnownPanels) -> int:
    """The same by the boxes alone, wherever the landmark was measured."""
    touched = _faces(landmark, known)
    return SIGN if any(touched.values()) else NEITHER if touched else NOTHING


def _faces(landmark: Landmark, known: KnownPanels) -> dict[int, bool]:
    """The signs that a landmark touches in its nearest views, and whether it lies on their face."""
    views = sorted(landmark.views, key=lambda view: -view.frame)[:NEAREST]
    overlaps: dict[int, list[float]] = {}
    for view in views:
        for sign, back, box in known.boxes.get(view.frame, ()):
            if back == landmark.back:
                overlap = iou_matrix(np.array([view.box]), np.array([box]))[0, 0]
                overlaps.setdefault(sign, []).append(float(overlap))
    return {
        sign: float(np.median([*own, *[0.0] * (len(views) - len(own))])) >= ON_FACE
        for sign, own in overlaps.items()
        if max(own) > NEAR_FACE
    }
