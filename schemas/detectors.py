"""Detectors that are not wayside's: what their files say, the boxes they give, which of their classes are signs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import NONE
from wayside.schemas.frame import Camera, Frame
from wayside.schemas.models import OnnxFile

SUREST = 0.999
"""Largest score of a box, and 1 minus the smallest: no detector is sure beyond all evidence."""

IMAGE_KEYS = ("frame", "log_time_ns", "header_time_ns", "image_name")
"""How a file of boxes names its images: number or times as in `frames.parquet`, or names of files."""


@dataclass(frozen=True, slots=True)
class SignClass:
    """A class of sign faces."""

    color: str | None = None
    """Of all its faces. None: the networks of wayside name it."""
    shape: str | None = None
    """Of all its faces. None: the networks of wayside name it."""


@dataclass(frozen=True, slots=True)
class DetectorFile:
    """A detector in an ONNX file, and how it is run and read."""

    onnx: OnnxFile
    """The file."""
    format: str
    """A value of the setting `models.detector_format` except `auto`."""
    input_size: tuple[int, int] | None
    """Height and width of the image that it takes. None: any multiple of 32."""
    image_input: str
    """Name of the input for the image."""
    size_input: str
    """Name of the input for the size of the image. Empty: none."""
    outputs: tuple[str, ...]
    """Names of its outputs."""
    signs: Mapping[int, SignClass] | None = None
    """Classes that are signs, by number. None: all."""


@dataclass(frozen=True, slots=True)
class ExternalBoxes:
    """Boxes of sign faces in one image, n rows."""

    box: NDArray[np.float32]
    """(n, 4), pixels as recorded, half open."""
    score: NDArray[np.float32]
    """Log odds, (n,)."""
    color: NDArray[np.int8]
    """Index into `COLORS`, (n,). -1: the detector does not say."""
    shape: NDArray[np.int8]
    """Index into `SHAPES`, (n,). -1: the detector does not say."""
    found: int
    """Number of boxes above the least score, of all classes."""

    def __len__(self) -> int:
        """Count rows."""
        return len(self.box)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> ExternalBoxes:
        """Those rows, in that order."""
        return replace(
            self,
            box=self.box[rows],
            score=self.score[rows],
            color=self.color[rows],
            shape=self.shape[rows],
        )

    def inside(self, camera: Camera) -> ExternalBoxes:
        """Those with a part inside the image, cut at its border."""
        box = np.clip(self.box, 0, np.array([camera.width, camera.height] * 2, np.float32))
        return replace(self, box=box).select(np.flatnonzero((box[:, 2:] > box[:, :2]).all(axis=1)))

    @staticmethod
    def empty() -> ExternalBoxes:
        """No rows."""
        none = np.zeros(0, np.int8)
        return ExternalBoxes(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), none, none, 0)


@dataclass(frozen=True, slots=True)
class BoxFile:
    """Boxes made elsewhere, by image."""

    path: str
    """Of the file."""
    sha256: str
    """Of the file."""
    key: str
    """What the numbers of `boxes` are: one of `IMAGE_KEYS` (of `image_name` the place in `names`), or `image_id`."""
    boxes: Mapping[int, ExternalBoxes] = field(repr=False)
    """The boxes by that number."""
    rows: int
    """Number of boxes in the file."""
    names: tuple[str, ...] = ()
    """Of the images, in natural order. Empty: they have none."""
    ids: Mapping[int, int] = field(default_factory=dict, repr=False)
    """Number in `boxes` by the `image_id` of a result, which is taken for the index of the frame."""
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Number of rows that are not among `boxes`, by reason."""
    signs: Mapping[int, SignClass] | None = None
    """Classes that are signs, by number. None: all."""
    fault: str = ""
    """Of the first row that cannot be read. Empty: none."""
    _places: dict[str, int | None] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Note the place of each name, and of what stays of it without folders and suffix where no other has that."""
        for place, name in enumerate(self.names):
            for part in set(_parts(name)):
                self._places[part] = None if part in self._places else place

    def number_of(self, frame: Frame) -> int | None:
        """The number that names this frame in `boxes`; None where it has none.

        Names are those of the files of the log where it knows them; else `image_id` tells, or the order of the names.
        """
        if self.by_id(frame):
            return self.ids.get(frame.index)
        if self.names and frame.name:
            return next((self._places[p] for p in _parts(frame.name) if p in self._places), None)
        if self.key == "log_time_ns":
            return frame.log_time_ns
        return frame.header_time_ns if self.key == "header_time_ns" else frame.index

    def by_id(self, frame: Frame) -> bool:
        """Whether it is `image_id` that tells which boxes are of this frame."""
        return bool(self.ids) and not (self.names and frame.name)

    def of(self, frame: Frame) -> ExternalBoxes:
        """The boxes of a frame as the file has them."""
        number = self.number_of(frame)
        found = None if number is None else self.boxes.get(number)
        return ExternalBoxes.empty() if found is None else found


def _parts(name: str) -> list[str]:
    """A path, what stays of it without folders, and both without suffix; the longest first."""
    folders = name.replace("\\", "/").lower().split("/")
    whole = ["/".join(folders[start:]) for start in range(len(folders))]
    return whole + [str(PurePosixPath(one).with_suffix("")) for one in whole if one]


def score_log_odds(score: NDArray[np.floating]) -> NDArray[np.float32]:
    """Log odds of scores (n,) between 0 and 1, which are cut off at `SUREST`."""
    limited = np.clip(np.asarray(score, np.float64), 1 - SUREST, SUREST)
    return np.asarray(np.log(limited / (1 - limited)), np.float32)


def unnamed(count: int) -> NDArray[np.int8]:
    """Classes (count,) of which nothing is known."""
    return np.full(count, NONE, np.int8)
