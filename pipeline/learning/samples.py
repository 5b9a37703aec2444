"""What the models are learned from: faces and candidates of rendered drives."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.learning.faces import FaceSample, clear_faces, height_px, visible_fraction
from wayside.schemas.detections import Regions, Segmentation
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera, Image
from wayside.schemas.models import OnnxFile
from wayside.schemas.settings import ReadSettings, Settings
from wayside.stages.detection import (
    SIDE,
    box_feature_names,
    box_features,
    drawn_patches,
    passes_network,
    propose,
)
from wayside.stages.geometry import intersection_areas, iou_matrix
from wayside.stages.imaging import pyramid
from wayside.stages.segmentation import segment

FACE_FRACTION, FACE_PX = 0.4, 8
"""Visible fraction and height of a face, pixels, from which boxes on it are examples; else they count as neither."""

ON_FACE, NEAR_FACE = 0.5, 0.3
"""Overlap (IoU) from which a box is on a face, and below which it is off it; between them it counts as neither."""

TIGHT, INSIDE, UNION = 0.6, 0.85, 0.8
"""Overlap (IoU) from which a box is tight on a face; fraction of a box from which it lies inside one; overlap from
which a box that shows a second face as well is no example rather than a bad one."""

UNKNOWN = 0.5
"""Fraction of a box in a place where nothing is known from which it counts as neither."""

OFF, ON, NEITHER = 0, 1, -1

ANY_SPACING_M = 8.0
"""Distance between the images of logs without poses, where no position is learned from it: about that of the report."""

LEARN_READ = ReadSettings(thin_m=0.0, spacing_m=ANY_SPACING_M)
"""Every image."""

THREADS = 2
"""How many drives are read at a time."""

Item = TypeVar("Item")
Result = TypeVar("Result")

SignViews = list[tuple[dict[str, Any], dict[str, Any]]]
"""Signs of which an image shows the front (or the back), each with its view there (box, visible fraction)."""

INVENTED = "invented"
"""Kind of the faces of rendered drives that no catalogue holds."""


@dataclass(frozen=True, slots=True)
class CandidateSamples:
    """Candidates of one drive that are classified, n rows.

    regions; frame (n,) int32; label (n,) int8 `OFF`, `ON` or `NEITHER`;
    overlap (n,) float32 with the nearest face; face (n,) int32 row of that face among all views of the drive (-1:
    none).
    """

    regions: Regions
    frame: NDArray[np.int32]
    label: NDArray[np.int8]
    overlap: NDArray[np.float32]
    face: NDArray[np.int32]

    def select(self, rows: NDArray[Any]) -> CandidateSamples:
        """Those rows, in that order."""
        rest = (self.frame, self.label, self.overlap, self.face)
        return CandidateSamples(self.regions.select(rows), *(column[rows] for column in rest))

    def joined(self, others: CandidateSamples) -> CandidateSamples:
        """These rows and then the others."""
        rest = (
            np.concatenate([getattr(self, f.name), getattr(others, f.name)])
            for f in fields(self)[1:]
        )
        return CandidateSamples(self.regions.joined(others.regions), *rest)


@dataclass(frozen=True, slots=True)
class FaceLabel:
    """A sign with the colour and shape that its face should be named by."""

    sign: str
    color: str
    shape: str


@dataclass(frozen=True, slots=True)
class TrueFaces:
    """All views of faces of a drive, m rows in order of their images.

    frame (m,) int64; box (m, 4) float64; is_example (m,) bool: whether a box on it is an example. complete (images,)
    bool: whether an image has no face beside those. ignored: boxes (k, 4) of each image in which nothing is known; none
    where everything is.
    """

    frame: NDArray[np.int64]
    box: NDArray[np.float64]
    is_example: NDArray[np.bool_]
    complete: NDArray[np.bool_]
    ignored: tuple[NDArray[np.float32], ...] = ()

    @staticmethod
    def of(
        seen: Sequence[SignViews],
        complete: Sequence[bool],
        ignored: Sequence[NDArray[np.float32]] = (),
    ) -> TrueFaces:
        """The views of each image; the visible fraction of a back is unknown."""
        candidates = [view for here in seen for _, view in here]
        clear = [
            view.get("side") == "back" or visible_fraction(view) >= FACE_FRACTION
            for view in candidates
        ]
        tall = [height_px(view) >= FACE_PX for view in candidates]
        return TrueFaces(
            np.array([index for index, here in enumerate(seen) for _ in here], np.int64),
            np.array([view["box"] for view in candidates], np.float64).reshape(-1, 4),
            np.array(clear, bool) & np.array(tall, bool),
            np.array(complete, bool),
            tuple(ignored),
        )


@dataclass(frozen=True, slots=True)
class TrainingDrive:
    """The samples of one rendered drive.

    wanted (m,) bool: which views of faces should be found (10 px tall, half visible); signs (m,): whose face each
    is; places (signs, 2): right of the path and above the camera, metres, of the signs that face the travel; backs: all
    views of panels from behind; size: width and height of its images, where they are all alike.
    """

    name: str
    frames: int
    faces: tuple[FaceSample, ...]
    candidates: CandidateSamples
    true_faces: TrueFaces
    wanted: NDArray[np.bool_]
    signs: tuple[FaceLabel, ...]
    places: NDArray[np.float64]
    backs: TrueFaces
    size: tuple[int, int] | None = None


def for_each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The result for each item, in order; decoding and the kernels release the interpreter lock."""
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, items))


def read_truth(path: Path) -> dict[str, Any]:
    """Truth of a rendered drive; raises InputError where the file is none."""
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
        if not {"name", "camera", "frames", "signs"} <= truth.keys():
            raise KeyError("name, camera, frames or signs")
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise InputError(
            f"{path}: wanted the truth of a rendered drive, found {type(error).__name__}: {error}; "
            "render the drive again with masks"
        ) from error
    return dict(truth)


def read_drive(
    images: Iterable[Image],
    altered: Iterable[Image],
    truth: dict[str, Any],
    masks: Path,
    settings: Settings,
    network: OnnxFile | None = None,
) -> TrainingDrive:
    """Go through images of a drive: clear faces from `images`, candidates from the same as `altered` for the detector.

    Both in order; `masks` is the folder of FRAME.png with sign ids, `network` the detection network, if any. Clear
    faces are for the classes of the report, which were those of a catalogue: invented faces are no samples.
    """
    seen, behind = views_by_frame(truth)
    faces: list[FaceSample] = []
    for image in images:
        if image.rgb is None:
            continue
        index = image.frame.index
        mask = _read_mask(masks / f"{index:04d}.png", image.rgb.shape[:2])
        listed = [one for one in seen.get(index, []) if one[0]["kind"] != INVENTED]
        faces.extend(clear_faces(image.rgb, mask, listed, truth["name"]))

    last = max((frame["index"] for frame in truth["frames"]), default=-1)
    here = [seen.get(index, []) for index in range(last + 1)]
    drive = read_drive_images(truth["name"], altered, here, [True] * len(here), settings, network)
    size = int(truth["camera"]["width"]), int(truth["camera"]["height"])
    backs = [behind.get(index, []) for index in range(last + 1)]
    return replace(
        drive,
        faces=tuple(faces),
        places=sign_positions(truth),
        backs=TrueFaces.of(backs, [True] * len(backs)),
        size=size,
    )


def views_by_frame(truth: dict[str, Any]) -> tuple[dict[int, SignViews], dict[int, SignViews]]:
    """What each frame of a rendered drive shows: signs that face the travel, and panels from behind."""
    seen: dict[int, SignViews] = {}
    behind: dict[int, SignViews] = {}
    for sign in truth["signs"]:
        for view in sign["frames"]:
            if sign["faces_travel"]:
                seen.setdefault(view["frame"], []).append((sign, view))
            if view["side"] == "back":
                behind.setdefault(view["frame"], []).append((sign, view))
    return seen, behind


def read_drive_images(
    name: str,
    images: Iterable[Image],
    seen: Sequence[SignViews],
    complete: Sequence[bool],
    settings: Settings,
    network: OnnxFile | None = None,
    ignored: Sequence[NDArray[np.float32]] = (),
) -> TrainingDrive:
    """Candidates of all images, labelled by the faces `seen` in each; no clear faces, no places.

    Where the faces of an image are not `complete`, what is on none of them counts as neither; so does what lies in
    the boxes that are `ignored` in it.
    """
    true_faces = TrueFaces.of(seen, complete, ignored)
    segmented = segment(iter(images), settings.segment, settings.gate)
    found = propose(segmented, settings=settings.candidates, network=network)
    parts = [_views(one, true_faces, settings) for one in found if one.image.rgb is not None]
    if not parts:
        raise InputError(f"{name}: wanted images, found none that can be used")
    faces = [face for here in seen for face in here]
    return TrainingDrive(
        name,
        len(parts),
        (),
        reduce(CandidateSamples.joined, parts),
        true_faces,
        np.array([visible_fraction(v) >= 0.5 and height_px(v) >= 10 for _, v in faces], bool),
        tuple(FaceLabel(f"{name}/{s['id']}", s["color"], s["shape"]) for s, _ in faces),
        np.zeros((0, 2)),
        TrueFaces.of([[]] * len(seen), complete),
    )


def read_box_features(images: Iterable[Image], candidates: CandidateSamples) -> NDArray[np.float32]:
    """Box features (n, features) of `candidates`, from the `images` of their drive read once more."""
    seen = np.zeros((len(candidates.frame), len(box_feature_names())), np.float32)
    for rows, levels, regions, camera in _revisited(images, candidates):
        seen[rows] = box_features(levels, regions, camera)
    return seen


def read_patches(images: Iterable[Image], candidates: CandidateSamples) -> NDArray[np.uint8]:
    """The pixels of `candidates` and their surroundings, (n, 32, 32, 3): another way through the `images`."""
    seen = np.zeros((len(candidates.frame), SIDE, SIDE, 3), np.uint8)
    for rows, levels, regions, _ in _revisited(images, candidates):
        seen[rows] = drawn_patches(levels, regions.box)
    return seen


def _revisited(
    images: Iterable[Image], candidates: CandidateSamples
) -> Iterator[tuple[NDArray[np.int64], tuple[NDArray[np.uint8], ...], Regions, Camera]]:
    """Rows of the views that each image has, its levels, the views as regions, and its camera."""
    for image in images:
        rows = np.flatnonzero(candidates.frame == image.frame.index)
        camera = image.frame.camera
        if image.rgb is not None and camera is not None and len(rows):
            yield rows, pyramid(image.rgb), candidates.regions.select(rows), camera


def sign_positions(truth: dict[str, Any]) -> NDArray[np.float64]:
    """Right of the path and above the camera's path of the signs that face the travel, (n, 2) metres."""
    height = truth["camera"]["mount"]["height_m"]
    rows = [
        (sign["lateral_m"], sign["up_m"] - height)
        for sign in truth["signs"]
        if sign["faces_travel"] and sign["eligible_frames"] > 0
    ]
    return np.array(rows, np.float64).reshape(-1, 2)


def _read_mask(path: Path, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if mask is None or mask.shape != shape or mask.dtype != np.uint8:
        found = "none" if mask is None else f"{mask.shape} {mask.dtype}"
        raise InputError(
            f"{path}: wanted an 8-bit mask of {shape[1]} x {shape[0]}, found {found}; "
            "render the drive again with masks"
        )
    return np.asarray(mask, np.uint8)


def _views(item: Segmentation, true_faces: TrueFaces, settings: Settings) -> CandidateSamples:
    regions = item.regions.select(passes_network(item, settings.candidates))
    return labelled(regions, np.full(len(regions), item.frame.index), true_faces)


def labelled(
    regions: Regions,
    frame: NDArray[np.integer[Any]],
    true_faces: TrueFaces,
) -> CandidateSamples:
    """Regions (n,) of some images, `frame` (n,), labelled by the faces there."""
    n = len(regions)
    overlap, nearest = np.zeros(n, np.float32), np.full(n, -1, np.int32)
    label = np.full(n, OFF, np.int8)
    for index in np.unique(frame):
        rows, own = np.flatnonzero(frame == index), np.flatnonzero(true_faces.frame == index)
        box = regions.box[rows]
        if len(own):
            iou = iou_matrix(box, true_faces.box[own])
            overlap[rows] = iou.max(axis=1)
            nearest[rows] = np.where(overlap[rows] > 0, own[iou.argmax(axis=1)], -1)
            label[rows] = face_labels(box, true_faces.box[own], true_faces.is_example[own])
        unknown = np.full(len(rows), not true_faces.complete[index])
        if true_faces.ignored and len(true_faces.ignored[index]):
            shared = intersection_areas(box, true_faces.ignored[index])
            unknown |= shared.max(axis=1) > UNKNOWN * np.prod(box[:, 2:] - box[:, :2], axis=1)
        label[rows[unknown & (label[rows] == OFF)]] = NEITHER
    return CandidateSamples(regions, frame.astype(np.int32), label, overlap, nearest)


def face_labels(
    box: NDArray[np.floating[Any]], faces: NDArray[np.floating[Any]], is_example: NDArray[np.bool_]
) -> NDArray[np.int8]:
    """Label (n,) of each box (n, 4): `ON` a face (m, 4), `OFF` all, or `NEITHER`.

    A face is its whole panel. Where a tight box is on it, a looser one is no example, and what shows only a part of it
    or a second face as well is none: a classifier that accepts both loses the plaque below a sign. Faces that
    are no example (m,) bool make none of the boxes near them.
    """
    overlap = iou_matrix(box, faces)
    shared = intersection_areas(box, faces)
    best = overlap.argmax(axis=1)
    rows = np.arange(len(box))
    nearest = overlap[rows, best]
    tight = overlap.max(axis=0)[best] >= TIGHT
    label = np.where(nearest >= NEAR_FACE, NEITHER, OFF).astype(np.int8)
    label[(nearest >= np.where(tight, TIGHT, ON_FACE)) & is_example[best]] = ON
    own = np.prod(box[:, 2:] - box[:, :2], axis=1)
    part = (shared[rows, best] > INSIDE * own) & (nearest < ON_FACE)
    label[part & tight & is_example[best]] = OFF
    # a second face in the box, that does not itself lie on the first
    area = np.prod(faces[:, 2:] - faces[:, :2], axis=1)
    apart = intersection_areas(faces, faces) < 0.3 * np.minimum(area[:, None], area[None])
    second = ((shared > 0.5 * area) & apart[best] & is_example).any(axis=1)
    label[second & (nearest < UNION) & tight] = OFF
    label[second & (nearest >= UNION)] = NEITHER
    return label


def face_weights(candidates: CandidateSamples) -> NDArray[np.float64]:
    """Weights (n,) that give each view of a face the same, however many boxes are on it; 1 off the faces.

    Narrow and torn faces (mile posts, crossbucks) have few boxes, and would hardly be learned otherwise.
    """
    on = candidates.label == ON
    weight = np.ones(len(candidates.label))
    if on.any():
        _, which, count = np.unique(candidates.face[on], return_inverse=True, return_counts=True)
        weight[on] = count.mean() / count[which]
    return weight
