"""What is found in one image: regions, candidates for sign faces, key points.

Pixel coordinates; boxes `[x0, y0, x1, y1]`, half open. RGB order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Frame, Image

COLOR_RGB = {
    "white": (245, 245, 245),
    "yellow": (245, 200, 40),
    "green": (40, 160, 80),
    "red": (210, 40, 50),
    "orange": (245, 130, 30),
    "blue": (40, 110, 210),
    "brown": (140, 90, 50),
    "fluorescent_yellow_green": (190, 240, 50),
    "black": (102, 102, 108),
    "pink": (245, 120, 170),
}
"""Colour classes, and in what they are drawn: the colours of the signs, bright enough on a dark ground."""
COLORS = tuple(COLOR_RGB)
LEARNED_COLORS = COLORS[:8]
"""Those that the networks know, in their order. Black is measured; pink comes from labels and reviews."""
SHAPES = (
    "rectangle",
    "diamond",
    "octagon",
    "triangle",
    "circle",
    "pentagon",
    "pennant",
    "shield",
    "crossbuck",
    "other",
)
SOURCES = ("pass1", "pass2", "level", "stack", "predicted", "moved", "network", "external")
"""Where a region comes from: K-means pass one or two, in results of earlier versions a level of a contrast map or two
of these one above the other, a landmark of other frames projected into this one, any of these with its box moved by box
regression, a box of the detection network, or a box of a detector that is not wayside's (or of a file of boxes)."""

VERDICT_WORDS = {
    "open": "undecided when the drive ended",
    "sign": "part of a reported panel",
    "size": "too few or too many pixels, or no height or aspect of a face: counted, without a row",
    "color": "mean colour too far from every sign colour",
    "shape": "outline too far from every sign shape",
    "score": "rejected by the classifier of boxes in one image",
    "overlap": "covered by a candidate of higher score on the same face",
    "unmatched": "no candidate of another frame matches",
    "far_view": "an early view of a track with more views than `track.longest` allows",
    "few_views": "seen in fewer images than `track.fewest_views`, or missing in too many that should show it",
    "moving": "moves along the road",
    "residual": "rays do not meet in one point, or the few views look different",
    "location": "too far from the usual places of signs",
    "attached": "its surroundings move with it: part of a wall, a vehicle or a larger board",
    "panel_size": "measured width or height outside the limits of a sign panel",
    "place_score": "its views do not look like a sign: the weakest evidence on the landmark",
    "duplicate": "on the pixels of a more likely panel, or a second measurement of one",
    "trajectory": "does not move in the image as signs do (preset `report-2d`)",
}
"""How far a region went: `open` while undecided, `sign`, or the reason it went no further."""
VERDICTS = tuple(VERDICT_WORDS)
NONE = -1


def verdict_code(name: str) -> int:
    """Position of a verdict in `VERDICTS`."""
    return VERDICTS.index(name)


@dataclass(frozen=True, slots=True)
class Rows:
    """A table whose columns are its fields that are arrays or tables, of n rows; other fields hold for all rows."""

    def __post_init__(self) -> None:
        """Refuse columns of different length."""
        if len(set(map(len, self.columns().values()))) > 1:
            lengths = {name: len(column) for name, column in self.columns().items()}
            raise ValueError(f"{type(self).__name__}: columns of different length: {lengths}")

    def __len__(self) -> int:
        """Count rows."""
        return len(next(iter(self.columns().values())))

    def select(self, rows: Any) -> Self:
        """Those rows, in that order."""
        return replace(self, **{name: own[rows] for name, own in self.columns().items()})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The rows of several, at least one, in that order; columns that only some have are nan in the others."""
        tables, every = [part.columns() for part in parts], dict[str, Any]()
        for name, known in {name: own for table in tables for name, own in table.items()}.items():
            found: list[Any] = [
                t[name] if name in t else np.full((len(p), *known.shape[1:]), np.nan, np.float32)
                for p, t in zip(parts, tables, strict=True)
            ]
            every[name] = (known.joined if isinstance(known, Rows) else np.concatenate)(found)
        return replace(parts[0], **every)

    def columns(self) -> dict[str, Any]:
        """The columns by name."""
        names: tuple[str, ...] = self.__slots__
        return {n: own for n in names if isinstance(own := getattr(self, n), (np.ndarray, Rows))}


@dataclass(frozen=True, slots=True)
class Regions(Rows):
    """Regions of one image that can be faces, n parallel rows."""

    box: NDArray[np.float32]
    """(n, 4)."""
    area_px: NDArray[np.int32]
    """Pixels of the region, (n,)."""
    rgb: NDArray[np.float32]
    """Mean colour, (n, 3), 0 to 255."""
    source: NDArray[np.uint8]
    """Index into `SOURCES`, (n,)."""

    @staticmethod
    def empty() -> "Regions":
        """No rows."""
        box = np.zeros((0, 4), np.float32)
        return Regions(box, np.zeros(0, np.int32), box[:, :3], np.zeros(0, np.uint8))


def box_centers(box: NDArray[np.float32]) -> NDArray[np.float64]:
    """Centres (n, 2) of boxes (n, 4), pixel centres at integers."""
    return np.asarray((box[:, :2] + box[:, 2:] - 1).astype(np.float64) / 2)


@dataclass(frozen=True, slots=True)
class Candidates(Rows):
    """Regions with their classification, n rows. No row is dropped: its `verdict` says where it stopped."""

    regions: Regions
    """The n regions."""
    center: NDArray[np.float64]
    """Measured centre of the face, (n, 2), distorted pixels."""
    ideal: NDArray[np.float64]
    """The same without lens distortion, (n, 2)."""
    color: NDArray[np.int8]
    """Index into `COLORS`, (n,). -1: none."""
    color_distance: NDArray[np.float32]
    """Mahalanobis distance to that colour, (n,). nan: not computed. Presets of the report only."""
    shape: NDArray[np.int8]
    """Index into `SHAPES`, (n,). -1: none."""
    shape_distance: NDArray[np.float32]
    """Mahalanobis distance to that shape, (n,). nan: not computed. Preset `report-shape` only."""
    score: NDArray[np.float32]
    """Log odds of being a sign face, (n,). nan: not scored."""
    verdict: NDArray[np.uint8]
    """Index into `VERDICTS`, (n,)."""
    color_log_probability: NDArray[np.float32] | None = None
    """Of each of `LEARNED_COLORS`, (n, colours). nan: not computed. None: for no row."""
    shape_log_probability: NDArray[np.float32] | None = None
    """Of each of `SHAPES`, (n, shapes). nan: not computed. None: for no row."""
    back_score: NDArray[np.float32] | None = None
    """Log odds of being a panel seen from behind, (n,). nan: not accepted. None: for no row."""

    def open_rows(self) -> NDArray[np.int64]:
        """Rows that are still undecided."""
        return np.flatnonzero(self.verdict == 0)

    def back_rows(self) -> NDArray[np.int64]:
        """Rows that may show the back of a panel."""
        if self.back_score is None:
            return np.zeros(0, np.int64)
        return np.flatnonzero(~np.isnan(self.back_score))

    def with_verdict(self, rows: NDArray[np.int64], name: str) -> "Candidates":
        """The same with this verdict in `rows` (m,)."""
        verdict = self.verdict.copy()
        verdict[rows] = verdict_code(name)
        return replace(self, verdict=verdict)

    def with_boxes(self, rows: NDArray[np.int64], box: NDArray[np.float32]) -> "Candidates":
        """The same with the boxes `box` (m, 4) and their centres in `rows` (m,), source `moved`."""
        own = self.regions
        boxes, source, center = own.box.copy(), own.source.copy(), self.center.copy()
        boxes[rows], source[rows], center[rows] = box, SOURCES.index("moved"), box_centers(box)
        regions = replace(own, box=boxes, source=source)
        return replace(self, regions=regions, center=center, ideal=center.copy())

    @staticmethod
    def of(regions: Regions) -> "Candidates":
        """Rows before classification; centres start at those of the boxes."""
        n = len(regions)
        middle = box_centers(regions.box)
        return Candidates(
            regions,
            middle,
            middle.copy(),
            np.full(n, NONE, np.int8),
            np.full(n, np.nan, np.float32),
            np.full(n, NONE, np.int8),
            np.full(n, np.nan, np.float32),
            np.full(n, np.nan, np.float32),
            np.zeros(n, np.uint8),
        )


@dataclass(frozen=True, slots=True)
class NetworkBoxes(Rows):
    """Boxes that the detection network found in one image, n rows, best first."""

    box: NDArray[np.float32]
    """(n, 4), pixels."""
    score: NDArray[np.float32]
    """Log odds of the likelier side, (n,)."""
    front: NDArray[np.float32]
    """Log odds of a face, (n,)."""
    shape: NDArray[np.int8]
    """Index into `SHAPES` of the most probable one, (n,)."""
    left_out: int = 0
    """Number of further boxes that were found and are not kept."""


class Dropped(NamedTuple):
    """Number of regions of an image that have no row in its table, by reason."""

    size: int = 0
    """Too few or too many pixels, or no height or aspect of a face."""
    left_out: int = 0
    """Boxes of the detection network beyond the best."""


NOTHING_DROPPED = Dropped()


@dataclass(frozen=True, slots=True)
class Segmentation:
    """An image with its regions."""

    image: Image
    """The image."""
    regions: Regions
    """Its regions."""
    region_count: int
    """Number of regions of both passes before any was dropped."""
    palette: NDArray[np.float32]
    """Mean colours of the classes of pass one, (k, 3), RGB."""
    difference_levels: NDArray[np.float32]
    """First difference value of each class of pass two, (j,)."""
    rows: tuple[int, int]
    """First image row that was segmented, and the one past the last."""
    labels: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None = field(default=None, repr=False)
    """Class of each pixel of those rows in pass one and in pass two, (rows, width). None: not kept."""
    dropped: Dropped = NOTHING_DROPPED
    """Number of regions that are not in the table."""
    network_score: NDArray[np.float32] | None = None
    """Log odds of a face by the detection network, (regions,). None: without that network."""

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.image.frame


@dataclass(frozen=True, slots=True)
class Features:
    """Key points of one image: n corners for the motion, m described regions (presets of the report)."""

    corners: NDArray[np.float32]
    """Corners that may become tie points, (n, 2), distorted pixels."""
    descriptors: NDArray[np.uint8]
    """Binary descriptors of the corners, (n, 32)."""
    sign_descriptors: NDArray[np.float32]
    """Of the m open candidates, (m, 132): SIFT, share of the box, and colour."""

    @staticmethod
    def empty() -> "Features":
        """No key points."""
        return Features(
            np.zeros((0, 2), np.float32),
            np.zeros((0, 32), np.uint8),
            np.zeros((0, 132), np.float32),
        )


@dataclass(frozen=True, slots=True)
class Detections:
    """All that one image shows by itself."""

    segmentation: Segmentation = field(repr=False)
    """The image and its regions."""
    candidates: Candidates
    """Its candidates, as far as one image decides them."""
    features: Features = field(default_factory=Features.empty)
    """Its key points."""

    @property
    def image(self) -> Image:
        """The image itself."""
        return self.segmentation.image

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.segmentation.image.frame
