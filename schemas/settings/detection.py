"""Settings of the candidates for sign faces and of the detector that classifies them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.settings.field import setting

_FAR = "all faces under 40 px on level and hilly rendered roads stand in this band, pitch included"
_NEAR = "all faces under 80 px on level and hilly rendered roads stand in this band, pitch included"
_CLUTTER = "below it lie road, sky and foliage"
_CHOSEN = "chosen by hand"


@dataclass(frozen=True, slots=True)
class CandidateSettings:
    """Where candidates for sign faces come from and how they are classified in one image."""

    judge: str = setting(
        "trees",
        "",
        "trees: learned box classifier on every candidate; report: colour and shape distances",
        choices=("trees", "report"),
    )
    most: int = setting(950, "candidates", "at most this many are classified in one image", low=1)
    keep: int = setting(
        60, "candidates", "at most this many of the best are tracked in one image", low=1
    )

    # --- bands of rows that are searched, as tangents from the optical axis ---
    full_above: float = setting(
        0.062, "tangent", "band at full size, above the axis", origin=_FAR, expert=True
    )
    full_below: float = setting(
        0.056, "tangent", "band at full size, below the axis", origin=_FAR, expert=True
    )
    half_above: float = setting(
        0.16, "tangent", "band at half size, above the axis", origin=_NEAR, expert=True
    )
    half_below: float = setting(
        0.09, "tangent", "band at half size, below the axis", origin=_NEAR, expert=True
    )
    quarter_above: float = setting(
        0.36, "tangent", "band at quarter size, above the axis", origin=_CHOSEN, expert=True
    )
    quarter_below: float = setting(
        0.13, "tangent", "band at quarter size, below the axis", origin=_CHOSEN, expert=True
    )

    # --- contrast maps and stable regions ---
    red_level: int = setting(
        12, "levels", "first level of the map red", origin=_CLUTTER, expert=True, low=1, high=255
    )
    blue_level: int = setting(
        10, "levels", "first level of the map blue", origin=_CLUTTER, expert=True, low=1, high=255
    )
    green_level: int = setting(
        8, "levels", "first level of the map green", origin=_CLUTTER, expert=True, low=1, high=255
    )
    yellow_level: int = setting(
        14, "levels", "first level of the map yellow", origin=_CLUTTER, expert=True, low=1, high=255
    )
    lighter_level: int = setting(
        10,
        "levels",
        "first level of the map lighter",
        origin=_CLUTTER,
        expert=True,
        low=1,
        high=255,
    )
    darker_level: int = setting(
        10, "levels", "first level of the map darker", origin=_CLUTTER, expert=True, low=1, high=255
    )
    map_dark_level: int = setting(
        64,
        "grey values",
        "added to the largest channel before a difference of channels is divided by it",
        origin="keeps the noise of shadows down",
        expert=True,
        low=1,
    )
    neighbourhood_px: int = setting(
        104,
        "px",
        "side of the square whose mean a pixel is compared with, in pixels of the map",
        origin=_CHOSEN,
        expert=True,
        low=8,
    )
    level_step: int = setting(
        4,
        "levels",
        "width of a level of the sweep",
        origin="the noise of recorded images is about as large",
        expert=True,
        low=1,
    )
    lifetime: int = setting(
        1, "levels", "levels over which a box must stay the same", origin=_CHOSEN, expert=True
    )
    stable_iou: float = setting(
        0.8,
        "IoU",
        "a growing component has the same box down to this overlap with its first",
        origin="Matas et al. 2002, with the box in the place of the area",
        expert=True,
        low=0,
        high=1,
    )
    narrowest_map_px: int = setting(
        3, "px", "narrower regions of a map are dropped", origin=_CHOSEN, expert=True, low=1
    )
    shortest_map_px: int = setting(
        6, "px", "lower regions of a map are dropped", origin=_CHOSEN, expert=True, low=1
    )
    largest_map_px: int = setting(
        400,
        "px",
        "wider or higher regions of a map are dropped",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    most_map_regions: int = setting(
        20_000,
        "regions",
        "at most this many stable regions of one map",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )
    mean_samples: int = setting(
        24,
        "samples",
        "samples each way, about, from which the mean colour of a region is taken",
        origin="chosen by hand, for speed",
        expert=True,
        low=1,
    )

    # --- which boxes can be faces ---
    narrowest_aspect: float = setting(
        0.2, "", "width over height of a face, at least", origin=_CHOSEN, expert=True, low=0
    )
    widest_aspect: float = setting(
        6.5, "", "width over height of a face, at most", origin=_CHOSEN, expert=True, low=0
    )
    shortest_px: int = setting(
        8,
        "px",
        "height of the smallest face searched for",
        origin=_CHOSEN,
        expert=True,
        low=1,
    )

    other_filled: float = setting(
        0.8,
        "boxes",
        "area of a face of a shape that is not known, or fills no fixed part of its box",
        origin="between a circle and a rectangle",
        expert=True,
        low=0.1,
        high=1,
    )

    # --- merging ---
    same_region_iou: float = setting(
        0.7,
        "IoU",
        "boxes that overlap more are one candidate",
        origin="at 0.45 faces were lost to their neighbours, at 0.6 not",
        expert=True,
        low=0.01,
        high=0.99,
    )
    most_compared: int = setting(
        4000,
        "boxes",
        "at most this many boxes of an image are ranked",
        origin="chosen by hand, to bound the time of an image",
        expert=True,
        low=1,
    )
    stack_rounds: int = setting(
        2,
        "rounds",
        "rounds in which regions one above the other are joined",
        origin="faces of up to four pieces",
        expert=True,
        low=0,
    )
    stack_edge: float = setting(
        0.15,
        "widths",
        "difference of the sides of stacked boxes, at most",
        origin=_CHOSEN,
        expert=True,
    )
    stack_edge_px: float = setting(
        1.5, "px", "the same, but at least this", origin=_CHOSEN, expert=True
    )
    stack_gap: float = setting(
        0.35, "heights", "gap between stacked boxes, at most", origin=_CHOSEN, expert=True
    )
    stack_gap_px: float = setting(
        2.0, "px", "the same, but at least this", origin=_CHOSEN, expert=True
    )

    # --- boxes of the detection network ---
    network_score: float = setting(
        -2.2,
        "log odds",
        "boxes of the detection network from here on join the regions",
        origin=_CHOSEN,
        expert=True,
    )
    network_least: float = setting(
        -6.0,
        "log odds",
        "of a face by the detection network: lower ones count as this",
        origin=_CHOSEN,
        expert=True,
    )
    network_most: int = setting(
        60, "boxes", "most of them in an image", origin=_CHOSEN, expert=True, low=0
    )
    network_iou: float = setting(
        0.5,
        "IoU",
        "of the network's boxes, those that overlap a better one more are suppressed",
        origin=_CHOSEN,
        expert=True,
        low=0.01,
        high=0.99,
    )

    # --- boxes of another detector, or of a file ---
    external_score: float = setting(
        0.25,
        "",
        "boxes of another detector, or of a file, with a smaller score are left out",
        origin="the default of Ultralytics' predictions",
        low=0,
        high=1,
    )

    # --- classification ---
    same_face_iou: float = setting(
        0.4,
        "IoU",
        "accepted boxes that overlap a better one more are suppressed",
        origin=_CHOSEN,
        expert=True,
        low=0.01,
        high=0.99,
    )
    regression_margin: float = setting(
        4.0,
        "log odds",
        "boxes down to this below the threshold of the trees are regressed, and the patch CNN is learned on them",
        origin=_CHOSEN,
        expert=True,
        low=0,
    )
    largest_offset: float = setting(
        1.5,
        "box sizes",
        "box regression: larger offsets of a side are neither learned nor applied",
        origin=_CHOSEN,
        expert=True,
        low=0,
    )

    @property
    def bands(self) -> tuple[tuple[float, float], ...]:
        """Upper and lower limit of the rows searched at full, half and quarter size: tangents, up negative."""
        return (
            (-self.full_above, self.full_below),
            (-self.half_above, self.half_below),
            (-self.quarter_above, self.quarter_below),
        )

    @property
    def first_levels(self) -> tuple[int, ...]:
        """First level of each contrast map, in the order of the maps."""
        return (
            self.red_level,
            self.blue_level,
            self.green_level,
            self.yellow_level,
            self.lighter_level,
            self.darker_level,
        )

    def fits_face(self, box: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which boxes (n, 4) have the height and the aspect of a face."""
        wide, tall = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
        return np.asarray(
            (tall >= self.shortest_px)
            & (wide >= self.narrowest_aspect * tall)
            & (wide <= self.widest_aspect * tall)
        )
