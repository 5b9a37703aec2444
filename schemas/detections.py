"""What is found in one image: regions, candidates for sign faces, key points.

Pixel coordinates; boxes `[x0, y0, x1, y1]`, half open. RGB order.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Frame, Image

COLORS = (
    "white",
    "yellow",
    "green",
    "red",
    "orange",
    "blue",
    "brown",
    "fluorescent_yellow_green",
)
COLOR_RGB = {
    "white": (245, 245, 245),
    "yellow": (245, 200, 40),
    "green": (40, 160, 80),
    "red": (210, 40, 50),
    "orange": (245, 130, 30),
    "blue": (40, 110, 210),
    "brown": (140, 90, 50),
    "fluorescent_yellow_green": (190, 240, 50),
}
"""Colours in which the classes are drawn: those of the signs, bright enough on a dark ground."""
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

VERDICTS = (
    "open",
    "sign",
    "size",
    "color",
    "shape",
    "score",
    "overlap",
    "unmatched",
    "far_view",
    "few_views",
    "moving",
    "residual",
    "location",
    "attached",
    "panel_size",
    "place_score",
    "duplicate",
    "trajectory",
)
"""How far a region went: `open` while undecided, `sign`, or the reason it went no further. `place_score`: that
of the landmark classifier."""
NONE = -1


def verdict_code(name: str) -> int:
    """Position of a verdict in `VERDICTS`."""
    return VERDICTS.index(name)


@dataclass(frozen=True, slots=True)
class Regions:
    """Connected regions of one image that passed the size gate, n parallel rows.

    box (n, 4) float32, area_px (n,) int32, rgb (n, 3) float32 mean colour, source (n,) uint8 into `SOURCES`.
    """

    box: NDArray[np.float32]
    area_px: NDArray[np.int32]
    rgb: NDArray[np.float32]
    source: NDArray[np.uint8]

    def __post_init__(self) -> None:
        """Refuse columns of different length."""
        _same_length(self)

    def __len__(self) -> int:
        """Count rows."""
        return len(self.box)

    def select(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Regions:
        """Those rows, in that order."""
        return Regions(self.box[rows], self.area_px[rows], self.rgb[rows], self.source[rows])

    def joined(self, others: Regions) -> Regions:
        """These rows and then the others."""
        return Regions(
            *(
                np.concatenate([getattr(self, f.name), getattr(others, f.name)])
                for f in fields(self)
            )
        )

    @staticmethod
    def empty() -> Regions:
        """No rows."""
        return Regions(
            np.zeros((0, 4), np.float32),
            np.zeros(0, np.int32),
            np.zeros((0, 3), np.float32),
            np.zeros(0, np.uint8),
        )


def box_centers(box: NDArray[np.float32]) -> NDArray[np.float64]:
    """Centres (n, 2) of boxes (n, 4), pixel centres at integers."""
    return np.asarray((box[:, :2] + box[:, 2:] - 1).astype(np.float64) / 2)


@dataclass(frozen=True, slots=True)
class Candidates:
    """Regions with their classification; a row is never dropped, its `verdict` says where it stopped.

    center (n, 2) float64: measured centre of the face, distorted pixels; ideal (n, 2) float64: the same without
    lens distortion; color, shape (n,) int8 into `COLORS`, `SHAPES` or -1; color_distance, shape_distance (n,)
    float32 Mahalanobis distances, of shapes in preset `report-shape` alone, nan where not computed; score (n,)
    float32 log odds of being a sign face, nan where not scored; verdict (n,) uint8 into `VERDICTS`.
    color_log_probability (n, colours), shape_log_probability (n, shapes) float32: log probability of each name, nan
    where not computed; None: for no row. back_score (n,) float32: log odds of being a panel seen from behind, nan
    where not accepted; None: for no row.
    """

    regions: Regions
    center: NDArray[np.float64]
    ideal: NDArray[np.float64]
    color: NDArray[np.int8]
    color_distance: NDArray[np.float32]
    shape: NDArray[np.int8]
    shape_distance: NDArray[np.float32]
    score: NDArray[np.float32]
    verdict: NDArray[np.uint8]
    color_log_probability: NDArray[np.float32] | None = None
    shape_log_probability: NDArray[np.float32] | None = None
    back_score: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        """Refuse columns of different length."""
        _same_length(self)

    def __len__(self) -> int:
        """Count rows."""
        return len(self.center)

    def open_rows(self) -> NDArray[np.int64]:
        """Rows that are still undecided."""
        return np.flatnonzero(self.verdict == 0)

    def back_rows(self) -> NDArray[np.int64]:
        """Rows that may show the back of a panel."""
        if self.back_score is None:
            return np.zeros(0, np.int64)
        return np.flatnonzero(~np.isnan(self.back_score))

    def joined(self, others: Candidates) -> Candidates:
        """These rows and then the others; columns that only one of both has are nan in the rows of the other."""

        def column(name: str) -> NDArray[Any] | None:
            parts = [getattr(self, name), getattr(others, name)]
            known = next((part for part in parts if part is not None), None)
            if known is None:
                return None
            counts = (len(self), len(others))
            filled = [
                np.full((n, *known.shape[1:]), np.nan, np.float32) if p is None else p
                for p, n in zip(parts, counts, strict=True)
            ]
            return np.concatenate(filled)

        rest = {f.name: column(f.name) for f in fields(self) if f.name != "regions"}
        return Candidates(self.regions.joined(others.regions), **rest)  # type: ignore[arg-type]

    def with_verdict(self, rows: NDArray[np.int64], name: str) -> Candidates:
        """The same with this verdict in `rows` (m,)."""
        verdict = self.verdict.copy()
        verdict[rows] = verdict_code(name)
        return replace(self, verdict=verdict)

    def with_boxes(self, rows: NDArray[np.int64], box: NDArray[np.float32]) -> Candidates:
        """The same with the boxes `box` (m, 4) and their centres in `rows` (m,), source `moved`."""
        boxes, source, center = (
            self.regions.box.copy(),
            self.regions.source.copy(),
            self.center.copy(),
        )
        boxes[rows], source[rows], center[rows] = box, SOURCES.index("moved"), box_centers(box)
        regions = replace(self.regions, box=boxes, source=source)
        return replace(self, regions=regions, center=center, ideal=center.copy())

    @staticmethod
    def of(regions: Regions) -> Candidates:
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
class NetworkBoxes:
    """Boxes found in one image, n rows, best first.

    box (n, 4) float32 pixels; score (n,) float32: log odds of the likelier side; front (n,) float32: of a face; color
    (n, colours) and shape (n, shapes) float32: log probabilities but for a constant a row; left_out: how many further
    ones of the maxima that were looked at were found.
    """

    box: NDArray[np.float32]
    score: NDArray[np.float32]
    front: NDArray[np.float32]
    color: NDArray[np.float32]
    shape: NDArray[np.float32]
    left_out: int = 0

    @staticmethod
    def none() -> NetworkBoxes:
        """No boxes."""
        one, two = np.zeros(0, np.float32), np.zeros((0, 4), np.float32)
        colors, shapes = (np.zeros((0, len(names)), np.float32) for names in (COLORS, SHAPES))
        return NetworkBoxes(two, one, one, colors, shapes)


class Dropped(NamedTuple):
    """How many regions of an image have no row in its table, by reason.

    size: too few or too many pixels, or no height or aspect of a face; merged: nearly the same as one that stays;
    left_out: boxes of the detection network beyond the best.
    """

    size: int = 0
    merged: int = 0
    left_out: int = 0

    def plus(self, others: Dropped) -> Dropped:
        """Both together."""
        return Dropped(*(a + b for a, b in zip(self, others, strict=True)))


NOTHING_DROPPED = Dropped()


@dataclass(frozen=True, slots=True)
class Segmentation:
    """An image with its regions.

    palette (k, 3) float32: centres of pass one; difference_levels (j,): first difference value of each class of
    pass two; rows (2,): first and one past the last image row that was segmented; labels: class of each pixel of
    those rows in pass one and in pass two, (rows, width) uint8 each (None where not kept); dropped: regions that are
    not in the table; region_count: regions of both passes before any was dropped; network_score (regions,) float32: log
    odds of a face by the detection network (None without one).
    """

    image: Image
    regions: Regions
    region_count: int
    palette: NDArray[np.float32]
    difference_levels: NDArray[np.float32]
    rows: tuple[int, int]
    labels: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None = field(default=None, repr=False)
    dropped: Dropped = NOTHING_DROPPED
    network_score: NDArray[np.float32] | None = None

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.image.frame


@dataclass(frozen=True, slots=True)
class Features:
    """Key points of one image.

    corners (n, 2) float32: tie-point corners, distorted pixels, sorted by row; descriptors (n, 32) uint8
    (binary); sign_points (m, 2) float32, sign_descriptors (m, 128) float32 (SIFT), sign_rows (m,) int32: the
    candidate row each belongs to.
    """

    corners: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    sign_points: NDArray[np.float32]
    sign_descriptors: NDArray[np.float32]
    sign_rows: NDArray[np.int32]

    @staticmethod
    def empty() -> Features:
        """No key points."""
        return Features(
            np.zeros((0, 2), np.float32),
            np.zeros((0, 32), np.uint8),
            np.zeros((0, 2), np.float32),
            np.zeros((0, 128), np.float32),
            np.zeros(0, np.int32),
        )


@dataclass(frozen=True, slots=True)
class Detections:
    """All that one image shows by itself: its segmentation, its candidates as far as they are decided, key points."""

    segmentation: Segmentation = field(repr=False)
    candidates: Candidates
    features: Features = field(default_factory=Features.empty)

    @property
    def image(self) -> Image:
        """The image itself."""
        return self.segmentation.image

    @property
    def frame(self) -> Frame:
        """The frame that the image belongs to."""
        return self.segmentation.image.frame


def _same_length(table: object) -> None:
    columns = {f.name: getattr(table, f.name) for f in fields(table)}  # type: ignore[arg-type]
    lengths = {name: len(column) for name, column in columns.items() if column is not None}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{type(table).__name__}: columns of different length: {lengths}")
