"""After many drives: one inventory of their panels, and what was in view of which drive."""

from wayside.stages.inventory.association import FACING_DEG, YEAR_NS, gone_probability
from wayside.stages.inventory.grouping import merge_sightings
from wayside.stages.inventory.vectors import (
    VECTOR_REACH_M,
    Agreement,
    Differences,
    agreement_of,
    measure_differences,
    reference_vectors,
)
from wayside.stages.inventory.visibility import (
    PanelPlaces,
    PlaceImage,
    match_moved,
    measure_occlusion,
    views_of,
)

__all__ = [
    "FACING_DEG",
    "VECTOR_REACH_M",
    "YEAR_NS",
    "Agreement",
    "Differences",
    "PanelPlaces",
    "PlaceImage",
    "agreement_of",
    "gone_probability",
    "match_moved",
    "measure_differences",
    "measure_occlusion",
    "merge_sightings",
    "reference_vectors",
    "views_of",
]
