"""The labelled sign faces of a drive, and whether regions and landmarks are on one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.labels.box_matching import overlap
from wayside.pipeline.labels.read import FrameLabels
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, UNSURE
from wayside.stages.geometry import box_areas, intersection_areas, iou_matrix

OFF, ON, NEITHER = 0, 1, -1

FACE_FRACTION, FACE_PX = 0.4, 8
"""Visible fraction and height of a face, pixels, from which boxes on it are examples; else they count as neither."""

ON_FACE, NEAR_FACE = 0.5, 0.3
"""Overlap (IoU) from which a box is on a face, and below which it is off it; between them it counts as neither."""

ANY_SPACING_M = 8.0
"""Distance between the images of logs without poses, where no position is learned from it: about that of the report."""

NEAREST = 3
"""Views of a landmark, the nearest ones, by which it is on a face or not."""

PART_OF_FACE = 0.5
"""From this fraction on a face, a region is a part of the face, and no example of a thing that is not a sign."""


@dataclass(frozen=True, slots=True)
class Faces:
    """Labelled faces of the images of a drive, m rows.

    `frame` (m,) int64. `box` (m, 4) float64 pixels as recorded. `sign` (m,) int64: number of the physical sign, from 0
    on (a label without the name of its panel is a sign of its own). `color`, `shape` (m,) names, "" where unknown.
    `example` (m,) bool: whether what lies on it is an example of a sign. `complete`: frames whose faces are all
    labelled. `others`: boxes of what is labelled to be no face, by frame. What is on no face is no sign where the frame
    is complete, or where it lies on one of `others`.
    """

    frame: NDArray[np.int64]
    box: NDArray[np.float64]
    sign: NDArray[np.int64]
    color: NDArray[np.str_]
    shape: NDArray[np.str_]
    example: NDArray[np.bool_]
    complete: frozenset[int]
    others: Mapping[int, NDArray[np.float64]]

    def label_regions(
        self, frame: int, box: NDArray[np.floating[Any]]
    ) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """Whether each box (n, 4) of a frame is `ON` a face, `OFF` all, or `NEITHER`, and the row of the face (-1).

        A region is on a face where they overlap by `ON_FACE`. It counts as neither if they overlap by less, but by
        at least `NEAR_FACE`. Part of a face (a letter, its border) and a face that is no example count as neither, too.
        """
        own = np.flatnonzero(self.frame == frame)
        label = self._off(frame, box)
        face = np.full(len(box), -1, np.int64)
        if len(own) and len(box):
            boxes = np.asarray(box, np.float64)
            shared, area = intersection_areas(boxes, self.box[own]), box_areas(boxes)
            iou = shared / (area[:, None] + box_areas(self.box[own]) - shared)
            best = iou.argmax(axis=1)
            nearest = iou[np.arange(len(box)), best]
            part = shared.max(axis=1) >= PART_OF_FACE * area
            label[(nearest >= NEAR_FACE) | part] = NEITHER
            on = (nearest >= ON_FACE) & self.example[own[best]]
            label[on], face[on] = ON, own[best[on]]
        return label, face

    def label_views(self, views: Sequence[tuple[int, Sequence[float]]]) -> int:
        """Whether a landmark with these views (frame, box) is `ON` a face, `OFF` all faces, or `NEITHER`.

        It is on a face where most of its latest views in labelled frames show the face; a part of a panel stands where
        the panel stands. It is off all faces where no view shows one. Without such views it is neither.
        """
        known = [
            (frame, box)
            for frame, box in sorted(views, key=lambda view: -view[0])
            if frame in self.complete or frame in self.others or (self.frame == frame).any()
        ][:NEAREST]
        if not known:
            return NEITHER
        shown = [
            any(overlap(np.array([box]), face)[0] > 0 for face in self.box[self.frame == frame])
            for frame, box in known
        ]
        if 2 * sum(shown) > len(shown):
            return ON
        off = [int(self._off(frame, np.array([box]))[0]) for frame, box in known]
        return max(off) if not any(shown) else NEITHER

    def sign_at(self, frame: int, box: Sequence[float]) -> int:
        """Number of the sign that a box lies on in a frame; -1 where it is on none."""
        own = np.flatnonzero(self.frame == frame)
        if not len(own):
            return -1
        shared = iou_matrix(np.array([box], np.float64), self.box[own])[0]
        best = int(shared.argmax())
        return int(self.sign[own[best]]) if shared[best] >= ON_FACE else -1

    def _off(self, frame: int, box: NDArray[np.floating[Any]]) -> NDArray[np.int8]:
        """`OFF` (n,) where a box on no face is known not to be a sign, else `NEITHER`."""
        label = np.full(len(box), NEITHER, np.int8)
        if frame in self.complete:
            label[:] = OFF
        elif frame in self.others and len(box):
            on = iou_matrix(np.asarray(box, np.float64), self.others[frame]).max(axis=1) >= ON_FACE
            label[on] = OFF
        return label


def labelled_faces(labels: FrameLabels) -> Faces:
    """The faces of a drive by its labels; small, hidden, undecided and unwanted ones are no examples."""
    by_frame = sorted(labels.labels.items())
    listed = [(k, one) for k, own in by_frame for one in own if one.kind in (SIGN, UNSURE)]
    others = {
        frame: np.array([one.box for one in own if one.kind in (BACK, NOT_A_SIGN)], np.float64)
        for frame, own in by_frame
    }
    names: dict[str, int] = {}
    signs = [
        names.setdefault(one.panel or f"\0{row}", len(names)) for row, (_, one) in enumerate(listed)
    ]
    example = [
        one.kind == SIGN
        and one.wanted
        and (one.visible is None or one.visible >= FACE_FRACTION)
        and one.height_px >= FACE_PX
        for _, one in listed
    ]
    return Faces(
        np.array([frame for frame, _ in listed], np.int64),
        np.array([one.box for _, one in listed], np.float64).reshape(-1, 4),
        np.array(signs, np.int64),
        np.array([one.color or "" for _, one in listed], np.str_),
        np.array([one.shape or "" for _, one in listed], np.str_),
        np.array(example, np.bool_),
        labels.complete,
        {frame: boxes for frame, boxes in others.items() if len(boxes)},
    )
