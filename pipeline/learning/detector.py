"""The judge of one view: a quick gate, trees on what passes, there and where the face ends, and a closer look.

All that judges a drive here has not seen it: drives are in two groups, each judged by what the other taught.
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
from wayside.pipeline.learning.prefilter import learn_prefilter
from wayside.pipeline.learning.samples import (
    NEAR_FACE,
    NEITHER,
    OFF,
    ON,
    ON_FACE,
    CandidateSamples,
    TrainingDrive,
    face_weights,
    labelled,
)
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
"""The network beside the judge's trees: they err on different boxes."""
FACE_FRACTION, NETWORK_WEIGHT = 0.2, 0.5
"""Faces for each box off them that the network is taught with; the part of its log odds that is added to the trees'."""

BOX_OFF_FRACTION = 0.1
"""Share of the candidates off any face that the judge is taught with: one background is seen in many pictures."""

REAL_WEIGHT = 2.0
"""How many times a candidate of a real picture counts each time it is shown: there are few, and they matter."""

FALSE_PER_PICTURE = 5.0
"""Boxes off any face, after suppression, that pass in a held-out picture: the judge of a place decides on them."""

FALSE_OF_TREES = 3.0
"""The same for the trees alone: what is less than `regression_margin` below their bar at that rate is looked at closer."""

AT = (0.1, 0.3, 1.0, 3.0)
"""False boxes a picture at which the share of faces found is stated."""

FeaturesOf = Callable[[TrainingDrive, CandidateSamples], NDArray[np.float32]]
"""Goes through the pictures of a drive again for what the trees see of some candidates."""

PatchesOf = Callable[[TrainingDrive, CandidateSamples], NDArray[np.uint8]]
"""Goes through the pictures of a drive again for the pixels of some candidates."""


@dataclass(frozen=True, slots=True)
class PrefilteredDrive:
    """Candidates of one drive that the gate let pass, with what the judge sees of them."""

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
    """How a judge does on drives it was not taught with: false boxes a picture, share of faces found, score there."""

    at: tuple[tuple[float, float, float], ...]
    threshold: float

    def words(self) -> str:
        """The figures as a sentence."""
        found = ", ".join(f"{share:.3f} at {false:g}" for false, share, _ in self.at)
        return f"held out by drive, share of faces found at false boxes a picture: {found}"


@dataclass(frozen=True, slots=True)
class TrainedDetector:
    """The judge and the network for boxes taught with all drives, and for each drive, by name, such as never saw it.

    The judges come with the gate. passed: what the gate let pass of each drive, where it was and moved onto the face,
    for whoever learns from it next.
    """

    judge: TreeModel
    box: NetworkModel
    out_of_fold: dict[str, tuple[TreeModel, NetworkModel]]
    passed: tuple[PrefilteredDrive, ...]


def learn_detector(
    drives: Sequence[TrainingDrive],
    features_of: FeaturesOf,
    patches_of: PatchesOf,
    seed: int,
    provenance: str,
    scenes: Sequence[TrainingDrive] = (),
) -> TrainedDetector:
    """Learn gate and judge from all drives; the bar is that of judges which had not seen the drive they judge.

    `scenes` are real pictures, a source each: they teach too, but the bar is that of the drives.
    """
    prefilter, passed, real = _through_prefilter(drives, scenes, features_of, seed, provenance)
    names = [one.drive.name for one in (*passed, *real)]
    examples = [
        regression_samples(one.drive, one.candidates, one.values, features_of, seed)
        for one in (*passed, *real)
    ]
    box, other_boxes = out_of_fold_models(
        names, examples, lambda taught: learn_box_regressor(taught, seed, provenance)
    )
    passed, real = (
        [_with_regressed(one, other_boxes[one.drive.name], features_of) for one in part]
        for part in (passed, real)
    )
    judge, other_judges = out_of_fold_models(
        names, [*passed, *real], lambda p: fit_box_classifier(p, seed)
    )
    odds = {
        one.drive.name: log_odds(other_judges[one.drive.name], one.values) for one in passed + real
    }
    rates = detection_rates(passed, [odds[one.drive.name] for one in passed], FALSE_OF_TREES)
    words = [provenance, f"{sum(len(p.values) for p in passed)} candidates past the gate"]
    words += [
        f"{sum(int((p.candidates.label == ON).sum()) for p in passed)} on faces",
        rates.words(),
    ]
    near = rates.threshold - CandidateSettings().regression_margin
    looked = [patch_samples(one, odds[one.drive.name], near, patches_of) for one in passed + real]
    patch_cnn, other_closers = _patch_cnns(looked, near, seed)
    for look in looked:
        other = other_closers[look.name]
        odds[look.name][look.rows] = other.tree_weight * look.trees + cnn_log_odds(other, look)
    rates = detection_rates(passed, [odds[one.drive.name] for one in passed], FALSE_PER_PICTURE)
    words += [f"with the closer look, {rates.words()}"]
    words += [f"accept at {FALSE_PER_PICTURE:g} false boxes a picture, held out"]
    for one in real:
        found, wanted = faces_found(one, odds[one.drive.name], rates.threshold)
        words.append(f"{one.drive.name}, held out: {found} of {wanted} faces accepted")

    def completed(trees: TreeModel, patch_cnn: ConvolutionModel) -> TreeModel:
        said = "; ".join(words)
        return replace(
            trees,
            threshold=rates.threshold,
            provenance=said,
            prefilter=prefilter,
            patch_cnn=patch_cnn,
        )

    out_of_fold = {
        name: (completed(trees, other_closers[name]), other_boxes[name])
        for name, trees in other_judges.items()
    }
    return TrainedDetector(completed(judge, patch_cnn), box, out_of_fold, (*passed, *real))


def patch_samples(
    one: PrefilteredDrive, odds: NDArray[np.float32], near: float, patches_of: PatchesOf
) -> PatchSamples:
    """The pixels of what is near enough to a face by the trees' log odds (n,)."""
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
    looked: Sequence[PatchSamples], near: float, seed: int
) -> tuple[ConvolutionModel, dict[str, ConvolutionModel]]:
    """The closer look, and for each drive, by name, one that has not seen it.

    What it and the trees count for, so that both together are log odds, is that of drives they have not seen.
    """
    names = [look.name for look in looked]
    patch_cnn, others = out_of_fold_models(
        names, looked, lambda some: fit_patch_cnn(some, near, seed)
    )
    known = [look for look in looked if not look.real]
    label = np.concatenate([look.label for look in known])
    said = [np.stack([look.trees, cnn_log_odds(others[look.name], look)], axis=1) for look in known]
    (tree_weight, slope), shift = platt(
        np.concatenate(said)[label != NEITHER], label[label != NEITHER] == ON
    )
    by = float(tree_weight), float(slope), shift
    return calibrated(patch_cnn, *by), {name: calibrated(others[name], *by) for name in names}


def detection_rates(
    passed: Sequence[PrefilteredDrive], scores: Sequence[NDArray[np.float32]], accepted: float
) -> DetectionRates:
    """Share of the wanted faces found at several rates of false boxes, after suppression in each picture.

    accepted: the rate at which the bar is.
    """
    rows: list[tuple[float, bool]] = []
    for one, score in zip(passed, scores, strict=True):
        for frame in np.unique(one.candidates.frame):
            rows += _decisions(one, score, np.flatnonzero(one.candidates.frame == frame))
    rows.sort(key=lambda row: -row[0])
    false = np.cumsum([not right for _, right in rows])
    right = np.cumsum([right for _, right in rows])
    images = sum(p.drive.frames for p in passed)
    wanted = max(sum(int(p.drive.wanted.sum()) for p in passed), 1)

    def at(rate: float) -> tuple[float, float, float]:
        last = int(np.searchsorted(false, rate * images, side="right")) - 1
        return rate, float(right[max(last, 0)] / wanted), float(rows[max(last, 0)][0])

    if not rows:
        return DetectionRates((), 0.0)
    return DetectionRates(tuple(at(rate) for rate in AT), at(accepted)[2])


def _decisions(
    one: PrefilteredDrive, score: NDArray[np.float32], rows: NDArray[np.int64]
) -> list[tuple[float, bool]]:
    """Score of each surviving box of a picture and whether it is on a wanted face; what is neither is left out."""
    rows = rows[np.argsort(-score[rows], kind="stable")]
    max_iou = CandidateSettings().same_face_iou
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
    one: PrefilteredDrive, score: NDArray[np.float32], threshold: float
) -> tuple[int, int]:
    """How many wanted faces have a box on them that is accepted, and how many are wanted."""
    on = (one.candidates.overlap >= ON_FACE) & (score >= threshold)
    found = np.unique(one.candidates.face[on])
    return int(one.drive.wanted[found].sum()), int(one.drive.wanted.sum())


def _through_prefilter(
    drives: Sequence[TrainingDrive],
    scenes: Sequence[TrainingDrive],
    features_of: FeaturesOf,
    seed: int,
    provenance: str,
) -> tuple[TreeModel, list[PrefilteredDrive], list[PrefilteredDrive]]:
    """The gate of a run, and what one lets pass of the drives and of the scenes to teach the judge."""
    taught, prefilter = learn_prefilter([*drives, *scenes], seed, provenance)
    passed = [_through(drive, taught, features_of) for drive in drives]
    return (
        prefilter,
        passed,
        [_through(source, taught, features_of, real=True) for source in scenes],
    )


def _through(
    drive: TrainingDrive, prefilter: TreeModel, features_of: FeaturesOf, *, real: bool = False
) -> PrefilteredDrive:
    rows = np.flatnonzero(
        log_odds(prefilter, drive.candidates.prefilter_values) >= prefilter.threshold
    )
    candidates = drive.candidates.select(rows)
    return PrefilteredDrive(drive, candidates, features_of(drive, candidates), real)


def _with_regressed(
    one: PrefilteredDrive, box: NetworkModel, features_of: FeaturesOf
) -> PrefilteredDrive:
    """What passed, and after it the same with boxes moved onto the face, as far as that changes them."""
    moved = regressed_regions(box, one.values, one.candidates.regions, CandidateSettings())
    new = np.flatnonzero((moved.box != one.candidates.regions.box).any(axis=1))
    candidates = labelled(
        moved.select(new),
        one.candidates.prefilter_values[new],
        one.candidates.frame[new],
        one.drive.true_faces,
    )
    return replace(
        one,
        candidates=one.candidates.joined(candidates),
        values=np.concatenate([one.values, features_of(one.drive, candidates)]),
    )


def fit_box_classifier(passed: Sequence[PrefilteredDrive], seed: int) -> TreeModel:
    """Trees, and the network beside them, that tell what is on a face from what is off all of them."""
    rng = np.random.default_rng(seed)
    values, positive, weight = [], [], []
    for one in passed:
        label = one.candidates.label
        near = one.candidates.overlap >= NEAR_FACE
        some = near | (rng.random(len(label)) < BOX_OFF_FRACTION)
        taught = (label == ON) | ((label == OFF) & some)
        # the part stands for the whole, so that the log odds stay those of all candidates
        share = np.where(near, 1.0, 1 / BOX_OFF_FRACTION)
        share = np.where(label == ON, face_weights(one.candidates), share)
        values.append(one.values[taught])
        positive.append(label[taught] == ON)
        weight.append(one.weight * share[taught])
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
