"""The data of the figures: a run of the report's chain over a drive with labels, decoded images, cut-outs."""

import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wayside.pipeline.files.pictures import webp_address
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.learning.asked import ClassifierSamples, faces_of_log, gather_samples
from wayside.pipeline.learning.labelled import ON, Faces
from wayside.pipeline.learning.page import Figure, Picture
from wayside.pipeline.models.model_files import Models, load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.statistics import share_interval
from wayside.pipeline.workers import Item
from wayside.schemas.detections import SHAPES, Detections, Regions, Segmentation
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import Landmark, TrackedFrame
from wayside.schemas.models import GaussianModel, MixtureModel
from wayside.schemas.motion import Motion
from wayside.schemas.settings import Settings
from wayside.stages.classifiers import nearest_class
from wayside.stages.imaging import decode
from wayside.stages.report import fourier_descriptors, outlines_of
from wayside.stages.segmentation import segment

PRESET, SHAPE_PRESET, TRAJECTORY_PRESET = "report", "report-shape", "report-2d"
"""The report's last chain, and the one with its shape classifier."""
REPORT: dict[str, dict[str, dict[str, Any]]] = tomllib.loads(
    Path(__file__).with_name("report.toml").read_text(encoding="utf-8")
)
"""What the report shows: by chapter and number, fields of a `Figure`."""
T = TypeVar("T")
Pixels = NDArray[np.uint8]
Corners = tuple[int, int, int, int]
LABELS_BESIDE = (".truth.json", ".labels.json", ".labels.parquet")
"""Endings of the labels in the folder of a log, in order of preference."""


@dataclass(frozen=True, slots=True)
class FaceOutline:
    """The outline of a region on a labelled face, and the answer of the shape classifier.

    `face`: row of `Faces`. `sequence` (samples,): u + iv in the image. `named`: nearest shape. `accepted`: near enough.
    """

    frame: int
    face: int
    box: NDArray[np.float32]
    sequence: NDArray[np.complex128]
    named: str
    accepted: bool
    distance: float


def clustered(one: Segmentation) -> tuple[Pixels, Pixels]:
    """The image, and in the colours of the clusters of pass one; black where it was not segmented."""
    rgb = one.image.rgb
    assert rgb is not None
    shown = np.zeros_like(rgb)
    if one.labels is not None:
        shown[one.rows[0] : one.rows[1]] = np.rint(one.palette).astype(np.uint8)[one.labels[0]]
    return rgb, shown


@dataclass
class Drive:
    """A drive that the report's chain goes through; it watches the stages, and keeps what the figures show.

    `shapes`, `density`: the classes of shapes, and of what moves as signs do, that decide in other chains of the
    report. `samples`: what each classifier was asked, by its name. `frames`: motion by frame. `landmarks`: all, with
    their verdicts. `regions`: those of each frame that passed the size gate. `passed`: boxes (n, 4) of those that
    passed the colour gate, too. `outlines`: of those of them that lie on a face, in order of frames. `matches` (k, 4):
    SIFT matches of each frame with the one before, u, v, u, v.
    """

    log: Path
    settings: Settings
    models: Models
    faces: Faces
    shapes: GaussianModel
    density: MixtureModel
    samples: dict[str, ClassifierSamples] = field(default_factory=dict, repr=False)
    frames: dict[int, Motion] = field(default_factory=dict, repr=False)
    landmarks: list[Landmark] = field(default_factory=list, repr=False)
    regions: dict[int, Regions] = field(default_factory=dict, repr=False)
    passed: dict[int, NDArray[np.float32]] = field(default_factory=dict, repr=False)
    outlines: list[FaceOutline] = field(default_factory=list, repr=False)
    matches: dict[int, NDArray[np.float32]] = field(default_factory=dict, repr=False)

    @property
    def signs(self) -> list[Landmark]:
        """Landmarks that are reported."""
        return [one for one in self.landmarks if one.verdict == "sign"]

    def judge(self, sign: Landmark) -> int:
        """Whether a landmark is `ON` a labelled face, `OFF` all, or `NEITHER`."""
        return self.faces.label_views([(view.frame, view.box) for view in sign.views])

    def images(self, wanted: Collection[int]) -> dict[int, Pixels]:
        """Images (height, width, 3) RGB of frames, read and decoded again."""
        found = decode(self._frames(wanted))
        return {one.frame.index: one.rgb for one in found if one.rgb is not None}

    def segmented(self, wanted: Collection[int]) -> dict[int, Segmentation]:
        """Images of frames, segmented again."""
        s = self.settings
        found = segment(decode(self._frames(wanted)), settings=s.segment, gate=s.gate)
        return {one.frame.index: one for one in found if one.frame.used}

    def _frames(self, wanted: Collection[int]) -> Iterator[Frame]:
        read = read_frames(self.log, self.settings.read, ReadReport())
        return (frame for frame in read if frame.index in wanted)

    def see(self, stage: str, item: Item) -> None:
        """Take note of the outlines on faces, and of a frame whose candidates are all decided."""
        if stage == "color" and isinstance(item, Detections):
            self.passed[item.frame.index] = item.candidates.regions.box[item.candidates.open_rows()]
            self.outlines.extend(self._outlines_on_faces(item))
        if stage == "assemble" and isinstance(item, TrackedFrame) and item.motion is not None:
            self.frames[item.frame.index] = item.motion
            self.landmarks.extend(item.landmarks)
            self.regions[item.frame.index] = item.candidates.regions
            if item.matches is not None:
                self.matches[item.frame.index] = item.matches

    def _outlines_on_faces(self, item: Detections) -> Iterator[FaceOutline]:
        rows = item.candidates.open_rows()
        regions, frame = item.candidates.regions.select(rows), item.frame.index
        label, face = self.faces.label_regions(frame, regions.box)
        on = np.flatnonzero(label == ON)
        regions, face = regions.select(on), face[on]
        outlines = outlines_of(item.segmentation, regions)
        code, distance, ratio = nearest_class(fourier_descriptors(outlines), self.shapes, SHAPES)
        for i in np.flatnonzero(code >= 0):
            yield FaceOutline(
                frame,
                int(face[i]),
                regions.box[i],
                outlines.points[i] + 1j * item.segmentation.rows[0],
                SHAPES[code[i]],
                bool(ratio[i] >= self.shapes.threshold),
                float(distance[i]),
            )


def figure(number: str) -> Figure:
    """A figure with what the report shows, and what it needs from a drive."""
    return Figure(number, **next(own[number] for own in REPORT.values() if number in own))


NEARLY_ALL, ALMOST_NO = 0.95, 0.05
"""Numbers for words of the report: "near perfect", "typically all", and "almost no", here one false place
in twenty images."""


def reached(count: int, total: int, share: float) -> str:
    """`met` if a share is at least this, `open` if only its interval reaches this, else `not met`."""
    interval = share_interval(count, total)
    if interval is None:
        return "open"
    return "met" if count >= share * total else "not met" if interval.high < share else "open"


def evenly(values: Sequence[T], count: int) -> list[T]:
    """At most so many of them, evenly spread."""
    at = np.unique(np.linspace(0, len(values) - 1, min(len(values), count)).round().astype(int))
    return [values[i] for i in at] if len(values) else []


def labels_beside(log: Path) -> Path:
    """The file of labels of a log, in the same folder. Raises InputError without such a file."""
    every = [log.with_name(log.stem + ending) for ending in LABELS_BESIDE]
    if found := [path for path in every if path.is_file()]:
        return found[0]
    names = ", ".join(path.name for path in every)
    raise InputError(
        f"{log}: there are no labels next to the log ({names}). The figures compare with labels: give them with "
        "--labels; see docs/labels.md."
    )


def gather_drive(
    log: Path, labels_file: Path, assignments: list[str], options: Mapping[str, Any] | None = None
) -> Drive:
    """Run the report's chain over a log, and keep what the figures show.

    Raises InputError where the log or its labels cannot be used, UsageError where a setting is wrong.
    """

    def chain(preset: str) -> tuple[Settings, Models]:
        settings, _ = load_settings(preset, None, assignments, options)
        return settings, load_models(settings)

    settings, models = chain(PRESET)
    if settings.read.blur:
        raise UsageError(
            "read.blur: these figures also show other things than signs, and are not blurred. Leave it out."
        )
    shapes, density = chain(SHAPE_PRESET)[1].shape_classes, chain(TRAJECTORY_PRESET)[1]
    if shapes is None or density.trajectory_density is None:
        raise InputError(f"models: {SHAPE_PRESET} and {TRAJECTORY_PRESET} must both be loaded")
    faces = faces_of_log(log, read_labels(labels_file), settings.read)
    drive = Drive(log, settings, models, faces, shapes, density.trajectory_density)
    drive.samples = gather_samples(log, faces, settings, models, also=drive)
    drive.outlines.sort(key=lambda one: (one.frame, one.face, one.box.tolist()))
    return drive


Ink = tuple[int, int, int]
ACCENT: Ink = (255, 0, 140)
SIGN_INK: Ink = (255, 230, 0)
_PAPER, _GAP, _SHIFT = 255, 6, 4
_WIDEST, IMAGE_WIDE = 1100, 800
"""Most pixels of the width of a picture, and of one that shows a whole image."""


def around(
    box: ArrayLike, size: tuple[int, int], *, times: float = 2.4, least: int = 40
) -> Corners:
    """Corners (x0, y0, x1, y1) of a square that is `times` as large as a box and inside an image (height, width)."""
    x0, y0, x1, y1 = (float(v) for v in np.asarray(box))
    side = min(max(round(times * max(x1 - x0, y1 - y0)), least), *size)
    left = int(np.clip(round((x0 + x1 - side) / 2), 0, size[1] - side))
    top = int(np.clip(round((y0 + y1 - side) / 2), 0, size[0] - side))
    return left, top, left + side, top + side


def cut(image: Pixels, corners: Corners, tall: int) -> Pixels:
    """A cut-out as RGB, enlarged or shrunk to a height."""
    x0, y0, x1, y1 = corners
    part = image[y0:y1, x0:x1]
    part = part if part.ndim == 3 else np.repeat(part[..., None], 3, axis=2)
    size = (max(round((x1 - x0) * tall / (y1 - y0)), 1), tall)
    method = cv2.INTER_NEAREST if tall > y1 - y0 else cv2.INTER_AREA
    return np.asarray(cv2.resize(np.ascontiguousarray(part), size, interpolation=method), np.uint8)


def beside(images: Sequence[Pixels], columns: int = 99) -> Pixels:
    """Pictures of one height in rows of `columns`, with gaps."""
    framed = [_widened(one, _GAP, _GAP) for one in images]
    rows = [np.hstack(framed[i : i + columns]) for i in range(0, len(framed), columns)]
    wide = max(row.shape[1] for row in rows)
    return np.vstack([_widened(row, wide - row.shape[1]) for row in rows])


def _widened(image: Pixels, right: int, below: int = 0) -> Pixels:
    return np.pad(image, ((0, below), (0, right), (0, 0)), constant_values=_PAPER)


def boxed(rgb: Pixels, boxes: Sequence[ArrayLike], ink: Ink = ACCENT, width: int = 3) -> Pixels:
    """A copy with rectangles round boxes."""
    page = rgb.copy()
    for box in boxes:
        x0, y0, x1, y1 = (round(float(v)) for v in np.asarray(box))
        cv2.rectangle(page, (x0 - 1, y0 - 1), (x1, y1), ink, width)
    return page


def lined(
    image: Pixels, corners: Corners, tall: int, curves: Sequence[tuple[NDArray[np.complex128], Ink]]
) -> Pixels:
    """A cut-out with closed curves u + iv of the image on it."""
    page = cut(image, corners, tall)
    scale = tall / (corners[3] - corners[1])
    for curve, ink in curves:
        at = np.column_stack([curve.real - corners[0] + 0.5, curve.imag - corners[1] + 0.5]) * scale
        fixed = np.rint((at - 0.5) * (1 << _SHIFT)).astype(np.int32)[:, None]
        cv2.polylines(page, [fixed], True, ink, 2, cv2.LINE_AA, _SHIFT)
    return page


def photo(rgb: Pixels, words: str = "", wide: int = _WIDEST) -> Picture:
    """An image (height, width, 3) RGB or (height, width) grey, shrunk to a width in pixels where it is wider."""
    factor = min(1.0, wide / rgb.shape[1])
    size = round(rgb.shape[1] * factor), max(round(rgb.shape[0] * factor), 1)
    shown = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    source = webp_address(shown if shown.ndim == 3 else np.dstack([shown] * 3))
    alt = f'width="{size[0]}" height="{size[1]}" alt="{escape(words)}"'
    return Picture(f'<img src="{source}" {alt}>', words)
