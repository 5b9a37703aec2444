"""Learning of the detector: box regression, box classifier and patch CNN.

All figures are out of fold: drives are in two folds, and each is evaluated with models learned from the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.box_regression import learn_box_regressor, regression_samples
from wayside.pipeline.learning.cross_validation import out_of_fold_models, platt
from wayside.pipeline.learning.networks import NetworkTraining, fit_network
from wayside.pipeline.learning.patch_cnn import (
    PatchSamples,
    calibrated,
    cnn_log_odds,
    fit_patch_cnn,
)
from wayside.pipeline.learning.samples import (
    NEAR_FACE,
    NEITHER,
    OFF,
    ON,
    ON_FACE,
    CandidateSamples,
    TrainingDrive,
    face_weights,
    for_each,
    labelled,
)
from wayside.pipeline.statistics import resampled_interval
from wayside.schemas.models import ConvolutionModel, NetworkModel, TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import log_odds
from wayside.stages.detection import (
    box_feature_names,
    placement_features,
    regressed_regions,
)
from wayside.stages.geometry import non_maximum_suppression

TREES = Boosting()
NETWORK = NetworkTraining(hidden=128, weight_decay=0.01, learning_rate=1e-3, rounds=12, batch=256)
"""The network whose output is added to the trees': their errors differ."""
FACE_FRACTION, NETWORK_WEIGHT = 0.2, 0.5
"""Weight of faces to that of other boxes for the network; weight of its log odds in the sum with the trees'."""

BOX_OFF_FRACTION = 0.1
"""Fraction of the candidates off any face that are learned from: one background stands in many images."""

REAL_WEIGHT = 2.0
"""Weight of a candidate of a real image in each of its copies: there are few."""

FALSE_PER_IMAGE = 5.0
"""Boxes off any face, after suppression, that pass in a held-out image: the landmark classifier decides on them."""

FALSE_OF_TREES = 3.0
"""The same for the trees alone: the patch CNN gets boxes down to `regression_margin` below that threshold."""

AT = (0.1, 0.3, 1.0, 3.0)
"""False boxes an image at which the fraction of faces found is stated."""

FeaturesOf = Callable[[TrainingDrive, CandidateSamples], NDArray[np.float32]]
"""Box features of some candidates of a drive, from its images read once more."""

PatchesOf = Callable[[TrainingDrive, CandidateSamples], NDArray[np.uint8]]
"""Patches of some candidates of a drive, from its images read once more."""


@dataclass(frozen=True, slots=True)
class FeaturedDrive:
    """Candidates of one drive that are classified, with their box features (n, features)."""

    drive: TrainingDrive
    candidates: CandidateSamples
    values: NDArray[np.float32]
    real: bool = False

    @property
    def weight(self) -> float:
        """How many times each candidate counts."""
        return REAL_WEIGHT if self.real else 1.0


@dataclass(frozen=True, slots=True)
class DetectionRates:
    """Out-of-fold figures of a classifier: false boxes an image, fraction of faces found, score there.

    threshold: score at the rate that was asked for; rule: that rate in words; interval: 95 % interval of the threshold,
    by resampling the drives; None: of a single one.
    """

    at: tuple[tuple[float, float, float], ...]
    threshold: float
    rule: str
    interval: tuple[float, float] | None

    def words(self) -> str:
        """The figures as a sentence."""
        found = ", ".join(f"{fraction:.3f} at {false:g}" for false, fraction, _ in self.at)
        return f"held out by drive, fraction of faces found at false boxes an image: {found}"


@dataclass(frozen=True, slots=True)
class TrainedDetector:
    """Box classifier and box regression.

    passed: the candidates of each drive that are classified, at their own and at their regressed boxes.
    """

    classifier: TreeModel
    regressor: NetworkModel
    passed: tuple[FeaturedDrive, ...]


def learn_detector(
    drives: Sequence[TrainingDrive],
    features_of: FeaturesOf,
    patches_of: PatchesOf,
    seed: int,
    provenance: str,
    settings: CandidateSettings,
    scenes: Sequence[TrainingDrive] = (),
) -> TrainedDetector:
    """Learn the detector from all drives; its threshold is that of out-of-fold scores.

    `settings` are those of the runs that will use it. `scenes` are real images, a source each: they are learned from,
    too, but the threshold is that of the drives.
    """
    passed = for_each(lambda drive: with_features(drive, features_of), drives)
    real = for_each(lambda source: with_features(source, features_of, real=True), scenes)
    names = [one.drive.name for one in (*passed, *real)]
    examples = for_each(
        lambda one: regression_samples(
            one.drive, one.candidates, one.values, features_of, seed, settings
        ),
        (*passed, *real),
    )
    regressor, other_regressors = out_of_fold_models(
        names, examples, lambda training: learn_box_regressor(training, seed, provenance)
    )
    passed, real = (
        for_each(
            lambda one: _with_regressed(
                one, other_regressors[one.drive.name], features_of, settings
            ),
            part,
        )
        for part in (passed, real)
    )
    classifier, other_classifiers = out_of_fold_models(
        names, [*passed, *real], lambda p: fit_box_classifier(p, seed)
    )
    odds = {
        one.drive.name: log_odds(other_classifiers[one.drive.name], one.values)
        for one in passed + real
    }
    max_iou = settings.same_face_iou
    rates = detection_rates(
        passed, [odds[one.drive.name] for one in passed], FALSE_OF_TREES, max_iou
    )
    words = [provenance, f"{sum(len(p.values) for p in passed)} candidates"]
    words += [
        f"{sum(int((p.candidates.label == ON).sum()) for p in passed)} on faces",
        rates.words(),
    ]
    near = rates.threshold - settings.regression_margin
    samples = for_each(
        lambda one: patch_samples(one, odds[one.drive.name], near, patches_of), passed + real
    )
    patch_cnn, other_cnns = _patch_cnns(samples, near, seed)
    for sample in samples:
        other = other_cnns[sample.name]
        odds[sample.name][sample.rows] = other.tree_weight * sample.trees + cnn_log_odds(
            other, sample
        )
    rates = detection_rates(
        passed, [odds[one.drive.name] for one in passed], FALSE_PER_IMAGE, max_iou
    )
    words += [f"with the patch CNN, {rates.words()}"]
    for one in real:
        found, wanted = faces_found(one, odds[one.drive.name], rates.threshold)
        words.append(f"{one.drive.name}, held out: {found} of {wanted} faces accepted")

    completed = replace(
        classifier,
        threshold=rates.threshold,
        threshold_rule=rates.rule,
        threshold_interval=rates.interval,
        provenance="; ".join(words),
        patch_cnn=patch_cnn,
    )
    return TrainedDetector(completed, regressor, (*passed, *real))


def patch_samples(
    one: FeaturedDrive, odds: NDArray[np.float32], near: float, patches_of: PatchesOf
) -> PatchSamples:
    """The patches of candidates whose log odds (n,) by the trees are at least `near`."""
    rows = np.flatnonzero(odds >= near)
    candidates = one.candidates.select(rows)
    return PatchSamples(
        one.drive.name,
        rows,
        patches_of(one.drive, candidates),
        placement_features(one.values[rows]),
        odds[rows],
        candidates.label,
        candidates.overlap,
        candidates.face,
        one.real,
    )


def _patch_cnns(
    samples: Sequence[PatchSamples], near: float, seed: int
) -> tuple[ConvolutionModel, dict[str, ConvolutionModel]]:
    """The patch CNN, and for each drive, by name, that of the other fold.

    The weights of the trees and of the network, so that their sum is a log odds, are those of out-of-fold scores.
    """
    names = [sample.name for sample in samples]
    patch_cnn, others = out_of_fold_models(
        names, samples, lambda some: fit_patch_cnn(some, near, seed)
    )
    known = [sample for sample in samples if not sample.real]
    label = np.concatenate([sample.label for sample in known])
    scores = [
        np.stack([sample.trees, cnn_log_odds(others[sample.name], sample)], axis=1)
        for sample in known
    ]
    (tree_weight, slope), shift = platt(
        np.concatenate(scores)[label != NEITHER], label[label != NEITHER] == ON
    )
    by = float(tree_weight), float(slope), shift
    return calibrated(patch_cnn, *by), {name: calibrated(others[name], *by) for name in names}


def detection_rates(
    passed: Sequence[FeaturedDrive],
    scores: Sequence[NDArray[np.float32]],
    accepted: float,
    max_iou: float,
) -> DetectionRates:
    """Fraction of the wanted faces found at several rates of false boxes, after suppression in each image.

    accepted: the rate that sets the threshold; max_iou: overlap above which the lower of two boxes is suppressed.
    """
    drives: list[int] = []
    decided: list[tuple[float, bool]] = []
    for k, (one, score) in enumerate(zip(passed, scores, strict=True)):
        for frame in np.unique(one.candidates.frame):
            own = _decisions(one, score, np.flatnonzero(one.candidates.frame == frame), max_iou)
            decided += own
            drives += [k] * len(own)
    rule = false_boxes_rule(accepted)
    if not decided:
        return DetectionRates((), 0.0, rule, None)
    score, right = (np.array(column) for column in zip(*decided, strict=True))
    falling = np.argsort(-score, kind="stable")
    score, right, drive = score[falling], right[falling], np.array(drives)[falling]
    images = np.array([p.drive.frames for p in passed])
    wanted = max(sum(int(p.drive.wanted.sum()) for p in passed), 1)

    def last(rate: float, count: NDArray[np.int64]) -> int:
        """Row of the last box that is let through, each drive counted so many times."""
        false = np.cumsum(~right * count[drive])
        return max(int(np.searchsorted(false, rate * (images @ count), side="right")) - 1, 0)

    once = np.ones(len(passed), np.int64)
    rows = [last(rate, once) for rate in AT]
    found = np.cumsum(right)[rows] / wanted
    return DetectionRates(
        tuple(zip(AT, found.tolist(), score[rows].tolist(), strict=True)),
        float(score[last(accepted, once)]),
        rule,
        resampled_interval(len(passed), lambda count: float(score[last(accepted, count)])),
    )


def false_boxes_rule(accepted: float) -> str:
    """The rule of a threshold that lets so many boxes an image pass, in words."""
    return (
        f"alpha: {accepted:g} boxes off any face in an image of drives held out, after suppression"
    )


def _decisions(
    one: FeaturedDrive, score: NDArray[np.float32], rows: NDArray[np.int64], max_iou: float
) -> list[tuple[float, bool]]:
    """Score of each surviving box of an image and whether it is on a wanted face; what is neither is left out."""
    rows = rows[np.argsort(-score[rows], kind="stable")]
    rows = rows[non_maximum_suppression(one.candidates.regions.box[rows], max_iou)]
    found: list[tuple[float, bool]] = []
    taken: set[int] = set()
    for row in rows:
        overlap, face = one.candidates.overlap[row], int(one.candidates.face[row])
        if overlap >= ON_FACE:
            if face not in taken and one.drive.wanted[face]:
                found.append((float(score[row]), True))
            taken.add(face)
        elif overlap < NEAR_FACE:
            found.append((float(score[row]), False))
    return found


def faces_found(
    one: FeaturedDrive, score: NDArray[np.float32], threshold: float
) -> tuple[int, int]:
    """How many wanted faces have a box on them that is accepted, and how many are wanted."""
    on = (one.candidates.overlap >= ON_FACE) & (score >= threshold)
    found = np.unique(one.candidates.face[on])
    return int(one.drive.wanted[found].sum()), int(one.drive.wanted.sum())


def with_features(
    drive: TrainingDrive, features_of: FeaturesOf, *, real: bool = False
) -> FeaturedDrive:
    """The candidates of a drive with their box features."""
    return FeaturedDrive(drive, drive.candidates, features_of(drive, drive.candidates), real)


def _with_regressed(
    one: FeaturedDrive,
    regressor: NetworkModel,
    features_of: FeaturesOf,
    settings: CandidateSettings,
) -> FeaturedDrive:
    """The candidates, and after them those whose box regression changes, at the regressed box."""
    moved = regressed_regions(regressor, one.values, one.candidates.regions, settings)
    new = np.flatnonzero((moved.box != one.candidates.regions.box).any(axis=1))
    candidates = labelled(
        moved.select(new),
        one.candidates.frame[new],
        one.drive.true_faces,
    )
    return replace(
        one,
        candidates=one.candidates.joined(candidates),
        values=np.concatenate([one.values, features_of(one.drive, candidates)]),
    )


def fit_box_classifier(passed: Sequence[FeaturedDrive], seed: int) -> TreeModel:
    """Trees, and the network added to them, that separate boxes on a face from boxes off all of them."""
    rng = np.random.default_rng(seed)
    values, positive, weight = [], [], []
    for one in passed:
        label = one.candidates.label
        near = one.candidates.overlap >= NEAR_FACE
        some = near | (rng.random(len(label)) < BOX_OFF_FRACTION)
        training = (label == ON) | ((label == OFF) & some)
        # the part is weighted as the whole, so that the log odds stay those of all candidates
        fraction = np.where(near, 1.0, 1 / BOX_OFF_FRACTION)
        fraction = np.where(label == ON, face_weights(one.candidates), fraction)
        values.append(one.values[training])
        positive.append(label[training] == ON)
        weight.append(one.weight * fraction[training])
    seen, face = np.concatenate(values), np.concatenate(positive)
    weights = np.concatenate(weight)
    trees = exported_trees(
        fit_trees(seen, face, weights, TREES, seed), box_feature_names(), 0.0, ""
    )
    balanced_weights = weights * np.where(
        face, FACE_FRACTION * weights[~face].sum() / weights[face].sum(), 1.0
    )
    network = fit_network(seen, face, balanced_weights, NETWORK, seed, box_feature_names())
    part = replace(
        network,
        output=np.float32(NETWORK_WEIGHT) * network.output,
        output_bias=np.float32(NETWORK_WEIGHT) * network.output_bias,
    )
    return replace(trees, network=part)
