"""Detectors that are not wayside's: what their files say, the boxes they give, which of their classes are signs."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows
from wayside.schemas.models import OnnxFile

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
class ExternalBoxes(Rows):
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

    @staticmethod
    def empty() -> "ExternalBoxes":
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
    places: Mapping[str, int | None] = field(default_factory=dict, repr=False)
    """Index into `names` by `name_parts` of each. None: several names share the part."""
