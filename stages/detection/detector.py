"""The sign face detector: which boxes of an image show the face of a sign.

The box network on each box, box regression, non-maximum suppression. Landmarks are classified later from all their
observations together; so the threshold here is low, and the score is passed on.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Candidates, Detections, Segmentation, verdict_code
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkSum, ScoreModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.box_network import BoxNetwork, BoxScores
from wayside.stages.detection.proposals import fits_face
from wayside.stages.geometry import non_maximum_suppression

SAME_FACE_IOU = 0.4
"""Accepted boxes that overlap a better one more are suppressed (chosen by hand)."""
REGRESSED_FROM = -1.0
"""Boxes of so much more than the threshold, as a front or a back, are moved onto the panel and classified again, log
odds: of 6,183 views of signs 1 % had less before, and no sign is lost (8 learning, 6 development, 9 real drives)."""
LARGEST_OFFSET = 1.5
"""Box regression moves sides no farther, by the size of the box (chosen by hand)."""


def detect(
    items: Iterator[Segmentation],
    *,
    settings: CandidateSettings,
    network: BoxNetwork,
    front: ScoreModel,
    back: ScoreModel | None = None,
) -> Iterator[Detections]:
    """Classify all regions of each image; each becomes a candidate.

    `network`: the box network. A candidate not far below a threshold is scored at the box that the network makes of it
    as well, and moves there where it scores better. Those that are accepted get the log probabilities of colours and
    shapes, and the most probable one of either as their class; the others keep class -1.

    `front`: threshold of faces. Candidates below it get the verdict `score`. Of overlapping ones the best stays
    (`overlap`), of all of them the best `settings.keep` (`score`). `back`: threshold of panels seen from behind. What
    it accepts, and what looks more like one than like a face, gets a `back_score`.
    """
    for item in items:
        image, regions = item.image, item.regions
        candidates = Candidates.of(regions)
        if image.rgb is None or image.frame.camera is None or len(regions) == 0:
            yield Detections(item, candidates)
            continue
        box = regions.box
        found = network.scores(image.rgb, box)
        scores = joined_scores(front.with_network, found.front, item.network_score)
        margin = scores - front.threshold
        if back is not None:
            margin = np.maximum(margin, found.back - back.threshold)
        near = np.flatnonzero(margin >= REGRESSED_FROM)
        moved = regressed_boxes(box[near], found.offset[near], image.frame.camera)
        again = network.scores(image.rgb, moved)
        better = again.best > found.best[near]
        for values, moved_values in zip(found, again, strict=True):
            values[near[better]] = moved_values[better]
        candidates = candidates.with_boxes(near[better], moved[better])
        scores = joined_scores(front.with_network, found.front, item.network_score)
        candidates = with_scores(candidates, scores, front.threshold, settings.keep)
        above = np.flatnonzero(scores >= front.threshold)
        candidates = with_names(candidates, above, found.select(above), grey=image.frame.grey)
        if back is not None:
            behind = (found.back >= back.threshold) & (found.back > scores)
            column = np.where(behind, found.back, np.float32(np.nan))
            candidates = replace(candidates, back_score=column)
        yield Detections(item, candidates)


def regressed_boxes(
    box: NDArray[np.float32], offset: NDArray[np.float32], camera: Camera
) -> NDArray[np.float32]:
    """Boxes (n, 4) with their sides moved by `offset` (n, 4) box sizes, no farther than the border of the image.

    Those that would be too small or of an aspect that no face has stay as they are.
    """
    size = (box[:, 2:] - box[:, :2])[:, [0, 1, 0, 1]]
    moved = (box + np.clip(offset, -LARGEST_OFFSET, LARGEST_OFFSET) * size).astype(np.float32)
    moved = np.clip(moved, 0, np.array([camera.width, camera.height] * 2, np.float32))
    return np.where(fits_face(moved, camera)[:, None], moved, box)


def joined_scores(
    model: NetworkSum | None, own: NDArray[np.float32], network: NDArray[np.float32] | None
) -> NDArray[np.float32]:
    """The sum (n,) of scores by the box network (n,) and the detection network (n,); `own` without model or network."""
    if model is None or network is None:
        return own
    joined = np.float32(model.own) * own + np.float32(model.network) * network
    return np.asarray(joined + np.float32(model.shift), np.float32)


def with_scores(
    candidates: Candidates, score: NDArray[np.float32], threshold: float, keep: int
) -> Candidates:
    """The candidates with `score` (n,) and the verdicts that follow: threshold, suppression, number kept."""
    alive = np.flatnonzero(score >= threshold)
    # Best first; the earlier row wins a tie.
    alive = alive[np.argsort(-score[alive], kind="stable")]
    kept = alive[non_maximum_suppression(candidates.regions.box[alive], SAME_FACE_IOU)]
    verdict = np.full(len(candidates), verdict_code("score"), np.uint8)
    verdict[alive] = verdict_code("overlap")
    verdict[kept] = verdict_code("score")
    verdict[kept[:keep]] = verdict_code("open")
    return replace(candidates, score=score, verdict=verdict)


def with_names(
    candidates: Candidates, rows: NDArray[np.int64], found: BoxScores, *, grey: bool = False
) -> Candidates:
    """The candidates with the log probabilities and the most probable classes of `rows`, which the network `found`.

    `grey`: the camera sees no colour, and none is named.
    """
    columns: dict[str, Any] = {}
    for name, score, seen in (("color", found.color, not grey), ("shape", found.shape, True)):
        likely = np.full((len(candidates), score.shape[1]), np.nan, np.float32)
        columns[name] = getattr(candidates, name).copy()
        columns[f"{name}_log_probability"] = likely
        if seen:
            below = score - score.max(axis=1, keepdims=True)
            likely[rows] = below - np.log(np.exp(below).sum(axis=1, keepdims=True))
            columns[name][rows] = score.argmax(axis=1)
    return replace(candidates, **columns)
