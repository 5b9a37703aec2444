"""After many drives: one inventory of their panels, and what was in view of which drive."""

from wayside.stages.inventory.association import (
    YEAR_NS,
    gone_probability,
    miss_log_ratio,
    place_log_ratio,
)
from wayside.stages.inventory.grouping import combine, face_runs, join_groups, merge_sightings
from wayside.stages.inventory.occlusion import OcclusionCounts, PlaceImage, measure_occlusion
from wayside.stages.inventory.offsets import relative_variance, solve_offsets
from wayside.stages.inventory.visibility import PanelPlaces, PanelViews, match_moved, views_of

__all__ = [
    "YEAR_NS",
    "OcclusionCounts",
    "PanelPlaces",
    "PanelViews",
    "PlaceImage",
    "combine",
    "face_runs",
    "gone_probability",
    "join_groups",
    "match_moved",
    "measure_occlusion",
    "merge_sightings",
    "miss_log_ratio",
    "place_log_ratio",
    "relative_variance",
    "solve_offsets",
    "views_of",
]
