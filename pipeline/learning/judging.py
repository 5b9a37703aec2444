"""The judge of one view: a quick gate on every candidate, the judge on what passes, both held out by drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.boosting import Boosting, exported_trees, fit_trees
from wayside.pipeline.learning.samples import NEAR_FACE, OFF, ON, ON_FACE, Drive, Views
from wayside.schemas.models import TreeModel
from wayside.stages.judge import OVERLAP, gate_names, view_names
from wayside.stages.numerics.boxes import suppressed_boxes
from wayside.stages.numerics.trees import log_odds

GATE = Boosting(trees=80, leaves=16, pace=0.12, share_of_features=0.5)
JUDGE = Boosting()

GATE_OFF_SHARE = 0.2
"""Share of the candidates off any face that the gate is taught with: there are a hundred to one."""

JUDGE_OFF_SHARE = 0.25
"""The same for the judge: one background is seen in many pictures."""

REAL_WEIGHT = 2.0
"""How many times a candidate of a real picture counts each time it is shown: there are few, and they matter."""

PASSED = 500.0
"""Candidates of a picture that the gate lets pass, in the mean over the learning drives."""

FALSE_PER_PICTURE = 2.0
"""Boxes off any face, after suppression, that pass in a held-out picture: the judge of a place decides on them."""

AT = (0.1, 0.3, 1.0, 3.0)
"""False boxes a picture at which the share of faces found is stated."""

SeeViews = Callable[[Drive, Views], NDArray[np.float32]]
"""Goes through the pictures of a drive again for what the judge sees of some candidates."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Candidates of one drive that the gate let pass, with what the judge sees of them; each counts `weight` times."""

    drive: Drive
    views: Views
    values: NDArray[np.float32]
    weight: float = 1.0


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
    """The judge taught with all drives, and for each drive, by name, one that has not seen it; all with the gate.

    passed: what the gate let pass of each drive, for whoever learns from it next.
    """

    judge: TreeModel
    strangers: dict[str, TreeModel]
    passed: tuple[Passed, ...]


def learn_judges(
    drives: Sequence[Drive],
    see: SeeViews,
    seed: int,
    provenance: str,
    scenes: Sequence[Drive] = (),
) -> Judges:
    """Learn gate and judge from all drives; the bar is that of judges which had not seen the drive they judge.

    `scenes` are real pictures, a source each: they teach too, but the bar is that of the drives.
    """
    gate, passed, real = _through_gate(drives, scenes, see, seed, provenance)
    strangers = _strangers([*passed, *real], seed)
    held = found_at(passed, [log_odds(strangers[p.drive.name], p.values) for p in passed])
    words = [provenance, f"{sum(len(p.values) for p in passed)} candidates past the gate"]
    words += [f"{sum(int((p.views.label == ON).sum()) for p in passed)} on faces", held.words()]
    words += [f"accept at {FALSE_PER_PICTURE:g} false boxes a picture, held out"]
    for one in real:
        found, wanted = faces_found(
            one, log_odds(strangers[one.drive.name], one.values), held.accept
        )
        words.append(f"{one.drive.name}, held out: {found} of {wanted} faces accepted")

    def completed(judge: TreeModel) -> TreeModel:
        return replace(judge, accept=held.accept, provenance="; ".join(words), gate=gate)

    return Judges(
        completed(_fit([*passed, *real], seed)),
        {name: completed(judge) for name, judge in strangers.items()},
        (*passed, *real),
    )


def learn_judge(
    drives: Sequence[Drive], scenes: Sequence[Drive], see: SeeViews, seed: int, accept: float
) -> TreeModel:
    """Gate and judge alone, with a bar that is known: what a judge is worth without some of what there is to teach."""
    gate, passed, real = _through_gate(drives, scenes, see, seed, "")
    return replace(_fit([*passed, *real], seed), accept=accept, gate=gate)


def learn_gate(drives: Sequence[Drive], seed: int, provenance: str) -> TreeModel:
    """Learn the gate; it lets pass `PASSED` candidates a picture of its own drives."""
    label = np.concatenate([d.views.label for d in drives])
    values = np.concatenate([d.views.glance for d in drives])
    some = np.random.default_rng(seed).random(len(label)) < GATE_OFF_SHARE
    far = np.concatenate([d.views.overlap for d in drives]) < NEAR_FACE
    taught = (label == ON) | ((label == OFF) & some & far)
    weight = np.concatenate([face_weights(d.views) for d in drives])
    fitted = fit_trees(values[taught], label[taught] == ON, weight[taught], GATE, seed)
    gate = exported_trees(fitted, gate_names(), 0.0, provenance)
    count = min(round(PASSED * sum(d.frames for d in drives)), len(values))
    score = np.sort(log_odds(gate, values))[::-1]
    words = f"{provenance}; accept at {PASSED:g} candidates a picture"
    return replace(gate, accept=float(score[count - 1]), provenance=words)


def face_weights(views: Views) -> NDArray[np.float64]:
    """Weights (n,) that give each view of a face the same, however many boxes are on it; 1 off the faces.

    Narrow and torn faces (mile posts, crossbucks) have few boxes, and would hardly be taught otherwise.
    """
    on = views.label == ON
    weight = np.ones(len(views.label))
    if on.any():
        _, which, count = np.unique(views.face[on], return_inverse=True, return_counts=True)
        weight[on] = count.mean() / count[which]
    return weight


def _strangers(passed: Sequence[Passed], seed: int) -> dict[str, TreeModel]:
    """For each drive trees that have not seen it: drives in two groups, each judged by the other's trees.

    A drive alone is judged by its own: there is no other.
    """
    judges: dict[str, TreeModel] = {}
    for group in (0, 1):
        own = passed[group::2]
        others = passed[1 - group :: 2] or own
        if own:
            judge = _fit(others, seed)
            judges |= {p.drive.name: judge for p in own}
    return judges


def found_at(passed: Sequence[Passed], scores: Sequence[NDArray[np.float32]]) -> Held:
    """Share of the wanted faces found at several rates of false boxes, after suppression in each picture."""
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
    return Held(tuple(at(rate) for rate in AT), at(FALSE_PER_PICTURE)[2])


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
    """The gate, and what it lets pass of the drives and of the scenes."""
    gate = learn_gate([*drives, *scenes], seed, provenance)
    passed = [_pass(drive, gate, see) for drive in drives]
    return gate, passed, [_pass(source, gate, see, REAL_WEIGHT) for source in scenes]


def _pass(drive: Drive, gate: TreeModel, see: SeeViews, weight: float = 1.0) -> Passed:
    rows = np.flatnonzero(log_odds(gate, drive.views.glance) >= gate.accept)
    views = drive.views.select(rows)
    return Passed(drive, views, see(drive, views), weight)


def _fit(passed: Sequence[Passed], seed: int) -> TreeModel:
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
    fitted = fit_trees(
        np.concatenate(values), np.concatenate(positive), np.concatenate(weight), JUDGE, seed
    )
    return exported_trees(fitted, view_names(), 0.0, "")
