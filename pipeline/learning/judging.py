"""The judge of one view: a quick gate, trees on what passes, there and where the face ends, and a closer look.

All that judges a drive here has not seen it: drives are in two groups, each judged by what the other taught.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.calibration import platt
from wayside.pipeline.learning.closer import Looked, calibrated, fit_closer, said_of
from wayside.pipeline.learning.face_boxes import learn_face_box, on_faces
from wayside.pipeline.learning.gating import learn_gate
from wayside.pipeline.learning.networks import Descent, fit_network
from wayside.pipeline.learning.samples import (
    NEAR_FACE,
    NEITHER,
    OFF,
    ON,
    ON_FACE,
    Drive,
    Views,
    face_weights,
    labelled,
)
from wayside.pipeline.learning.strangers import for_strangers
from wayside.schemas.models import ConvolutionModel, NetworkModel, TreeModel
from wayside.stages.classifiers import log_odds
from wayside.stages.detection import (
    OVERLAP,
    REACH,
    moved_regions,
    suppressed_boxes,
    told_of,
    view_names,
)

JUDGE = Boosting()
BESIDE = Descent(hidden=128, shrinkage=0.01, pace=1e-3, rounds=12, batch=256)
"""The network beside the judge's trees: they err on different boxes."""
FACE_SHARE, NETWORK_PART = 0.2, 0.5
"""Faces for each box off them that the network is taught with; the part of its log odds that is added to the trees'."""

JUDGE_OFF_SHARE = 0.1
"""Share of the candidates off any face that the judge is taught with: one background is seen in many pictures."""

REAL_WEIGHT = 2.0
"""How many times a candidate of a real picture counts each time it is shown: there are few, and they matter."""

FALSE_PER_PICTURE = 5.0
"""Boxes off any face, after suppression, that pass in a held-out picture: the judge of a place decides on them."""

FALSE_OF_TREES = 3.0
"""The same for the trees alone: what is less than `REACH` below their bar at that rate is looked at closer."""

AT = (0.1, 0.3, 1.0, 3.0)
"""False boxes a picture at which the share of faces found is stated."""

SeeViews = Callable[[Drive, Views], NDArray[np.float32]]
"""Goes through the pictures of a drive again for what the trees see of some candidates."""

DrawViews = Callable[[Drive, Views], NDArray[np.uint8]]
"""Goes through the pictures of a drive again for the pixels of some candidates."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Candidates of one drive that the gate let pass, with what the judge sees of them."""

    drive: Drive
    views: Views
    values: NDArray[np.float32]
    real: bool = False

    @property
    def weight(self) -> float:
        """How many times each candidate counts."""
        return REAL_WEIGHT if self.real else 1.0


@dataclass(frozen=True, slots=True)
class Held:
    """How a judge does on drives it was not taught with: false boxes a picture, share of faces found, score there."""

    at: tuple[tuple[float, float, float], ...]
    accept: float

    def words(self) -> str:
        """The figures as a sentence."""
        found = ", ".join(f"{share:.3f} at {false:g}" for false, share, _ in self.at)
        return f"held out by drive, share of faces found at false boxes a picture: {found}"


@dataclass(frozen=True, slots=True)
class Judges:
    """The judge and the network for boxes taught with all drives, and for each drive, by name, such as never saw it.

    The judges come with the gate. passed: what the gate let pass of each drive, where it was and moved onto the face,
    for whoever learns from it next.
    """

    judge: TreeModel
    box: NetworkModel
    strangers: dict[str, tuple[TreeModel, NetworkModel]]
    passed: tuple[Passed, ...]


def learn_judges(
    drives: Sequence[Drive],
    see: SeeViews,
    draw: DrawViews,
    seed: int,
    provenance: str,
    scenes: Sequence[Drive] = (),
) -> Judges:
    """Learn gate and judge from all drives; the bar is that of judges which had not seen the drive they judge.

    `scenes` are real pictures, a source each: they teach too, but the bar is that of the drives.
    """
    gate, passed, real = _through_gate(drives, scenes, see, seed, provenance)
    names = [one.drive.name for one in (*passed, *real)]
    examples = [on_faces(one.drive, one.views, one.values, see, seed) for one in (*passed, *real)]
    box, other_boxes = for_strangers(
        names, examples, lambda taught: learn_face_box(taught, seed, provenance)
    )
    passed, real = (
        [_with_moved(one, other_boxes[one.drive.name], see) for one in part]
        for part in (passed, real)
    )
    judge, other_judges = for_strangers(names, [*passed, *real], lambda p: fit_judge(p, seed))
    odds = {
        one.drive.name: log_odds(other_judges[one.drive.name], one.values) for one in passed + real
    }
    held = found_at(passed, [odds[one.drive.name] for one in passed], FALSE_OF_TREES)
    words = [provenance, f"{sum(len(p.values) for p in passed)} candidates past the gate"]
    words += [f"{sum(int((p.views.label == ON).sum()) for p in passed)} on faces", held.words()]
    near = held.accept - REACH
    looked = [look_closer(one, odds[one.drive.name], near, draw) for one in passed + real]
    closer, other_closers = _closer_looks(looked, near, seed)
    for look in looked:
        other = other_closers[look.name]
        odds[look.name][look.rows] = other.trees_part * look.trees + said_of(other, look)
    held = found_at(passed, [odds[one.drive.name] for one in passed], FALSE_PER_PICTURE)
    words += [f"with the closer look, {held.words()}"]
    words += [f"accept at {FALSE_PER_PICTURE:g} false boxes a picture, held out"]
    for one in real:
        found, wanted = faces_found(one, odds[one.drive.name], held.accept)
        words.append(f"{one.drive.name}, held out: {found} of {wanted} faces accepted")

    def completed(trees: TreeModel, closer: ConvolutionModel) -> TreeModel:
        said = "; ".join(words)
        return replace(trees, accept=held.accept, provenance=said, gate=gate, closer=closer)

    strangers = {
        name: (completed(trees, other_closers[name]), other_boxes[name])
        for name, trees in other_judges.items()
    }
    return Judges(completed(judge, closer), box, strangers, (*passed, *real))


def look_closer(one: Passed, odds: NDArray[np.float32], near: float, draw: DrawViews) -> Looked:
    """The pixels of what is near enough to a face by the trees' log odds (n,)."""
    rows = np.flatnonzero(odds >= near)
    views = one.views.select(rows)
    return Looked(
        one.drive.name,
        rows,
        draw(one.drive, views),
        told_of(view_names(), one.values[rows]),
        odds[rows],
        views.label,
        views.overlap,
        views.face,
        one.real,
    )


def _closer_looks(
    looked: Sequence[Looked], near: float, seed: int
) -> tuple[ConvolutionModel, dict[str, ConvolutionModel]]:
    """The closer look, and for each drive, by name, one that has not seen it.

    What it and the trees count for, so that both together are log odds, is that of drives they have not seen.
    """
    names = [look.name for look in looked]
    closer, others = for_strangers(names, looked, lambda some: fit_closer(some, near, seed))
    known = [look for look in looked if not look.real]
    label = np.concatenate([look.label for look in known])
    said = [np.stack([look.trees, said_of(others[look.name], look)], axis=1) for look in known]
    (trees_part, slope), shift = platt(
        np.concatenate(said)[label != NEITHER], label[label != NEITHER] == ON
    )
    by = float(trees_part), float(slope), shift
    return calibrated(closer, *by), {name: calibrated(others[name], *by) for name in names}


def found_at(
    passed: Sequence[Passed], scores: Sequence[NDArray[np.float32]], accepted: float
) -> Held:
    """Share of the wanted faces found at several rates of false boxes, after suppression in each picture.

    accepted: the rate at which the bar is.
    """
    rows: list[tuple[float, bool]] = []
    for one, score in zip(passed, scores, strict=True):
        for frame in np.unique(one.views.frame):
            rows += _decisions(one, score, np.flatnonzero(one.views.frame == frame))
    rows.sort(key=lambda row: -row[0])
    false = np.cumsum([not right for _, right in rows])
    right = np.cumsum([right for _, right in rows])
    pictures = sum(p.drive.frames for p in passed)
    wanted = max(sum(int(p.drive.wanted.sum()) for p in passed), 1)

    def at(rate: float) -> tuple[float, float, float]:
        last = int(np.searchsorted(false, rate * pictures, side="right")) - 1
        return rate, float(right[max(last, 0)] / wanted), float(rows[max(last, 0)][0])

    if not rows:
        return Held((), 0.0)
    return Held(tuple(at(rate) for rate in AT), at(accepted)[2])


def _decisions(
    one: Passed, score: NDArray[np.float32], rows: NDArray[np.int64]
) -> list[tuple[float, bool]]:
    """Score of each surviving box of a picture and whether it is on a wanted face; what is neither is left out."""
    rows = rows[np.argsort(-score[rows], kind="stable")]
    rows = rows[~suppressed_boxes(one.views.regions.box[rows], OVERLAP)]
    found: list[tuple[float, bool]] = []
    taken: set[int] = set()
    for row in rows:
        overlap, face = one.views.overlap[row], int(one.views.face[row])
        if overlap >= ON_FACE:
            if face not in taken and one.drive.wanted[face]:
                found.append((float(score[row]), True))
            taken.add(face)
        elif overlap < NEAR_FACE:
            found.append((float(score[row]), False))
    return found


def faces_found(one: Passed, score: NDArray[np.float32], accept: float) -> tuple[int, int]:
    """How many wanted faces have a box on them that is accepted, and how many are wanted."""
    on = (one.views.overlap >= ON_FACE) & (score >= accept)
    found = np.unique(one.views.face[on])
    return int(one.drive.wanted[found].sum()), int(one.drive.wanted.sum())


def _through_gate(
    drives: Sequence[Drive], scenes: Sequence[Drive], see: SeeViews, seed: int, provenance: str
) -> tuple[TreeModel, list[Passed], list[Passed]]:
    """The gate of a run, and what one lets pass of the drives and of the scenes to teach the judge."""
    taught, gate = learn_gate([*drives, *scenes], seed, provenance)
    passed = [_pass(drive, taught, see) for drive in drives]
    return gate, passed, [_pass(source, taught, see, real=True) for source in scenes]


def _pass(drive: Drive, gate: TreeModel, see: SeeViews, *, real: bool = False) -> Passed:
    rows = np.flatnonzero(log_odds(gate, drive.views.glance) >= gate.accept)
    views = drive.views.select(rows)
    return Passed(drive, views, see(drive, views), real)


def _with_moved(one: Passed, box: NetworkModel, see: SeeViews) -> Passed:
    """What passed, and after it the same with boxes moved onto the face, as far as that changes them."""
    moved = moved_regions(box, one.values, one.views.regions)
    new = np.flatnonzero((moved.box != one.views.regions.box).any(axis=1))
    views = labelled(
        moved.select(new), one.views.glance[new], one.views.frame[new], one.drive.shown
    )
    return replace(
        one,
        views=one.views.joined(views),
        values=np.concatenate([one.values, see(one.drive, views)]),
    )


def fit_judge(passed: Sequence[Passed], seed: int) -> TreeModel:
    """Trees, and the network beside them, that tell what is on a face from what is off all of them."""
    rng = np.random.default_rng(seed)
    values, positive, weight = [], [], []
    for one in passed:
        label = one.views.label
        near = one.views.overlap >= NEAR_FACE
        some = near | (rng.random(len(label)) < JUDGE_OFF_SHARE)
        taught = (label == ON) | ((label == OFF) & some)
        # the part stands for the whole, so that the log odds stay those of all candidates
        share = np.where(near, 1.0, 1 / JUDGE_OFF_SHARE)
        share = np.where(label == ON, face_weights(one.views), share)
        values.append(one.values[taught])
        positive.append(label[taught] == ON)
        weight.append(one.weight * share[taught])
    seen, face = np.concatenate(values), np.concatenate(positive)
    weights = np.concatenate(weight)
    trees = exported_trees(fit_trees(seen, face, weights, JUDGE, seed), view_names(), 0.0, "")
    evened = weights * np.where(face, FACE_SHARE * weights[~face].sum() / weights[face].sum(), 1.0)
    network = fit_network(seen, face, evened, BESIDE, seed, view_names())
    part = replace(
        network,
        output=np.float32(NETWORK_PART) * network.output,
        output_bias=np.float32(NETWORK_PART) * network.output_bias,
    )
    return replace(trees, network=part)
