"""What only the report's own chains need: colour, shape and trajectory gates, SIFT matching (chapters 3 to 5)."""

from wayside.stages.report.color import COLOR_SPACES, classify_color, color_features
from wayside.stages.report.match import extract_sift, match_segments
from wayside.stages.report.points import merge_segments, triangulate_points
from wayside.stages.report.shape import (
    TERMS,
    classify_shape,
    fourier_descriptors,
    outlines_of,
    region_descriptors,
)
from wayside.stages.report.trajectory import (
    STEP_M,
    TRAJECTORY_FORMS,
    classify_trajectory,
    mean_log_ratio,
)

__all__ = [
    "COLOR_SPACES",
    "STEP_M",
    "TERMS",
    "TRAJECTORY_FORMS",
    "classify_color",
    "classify_shape",
    "classify_trajectory",
    "color_features",
    "extract_sift",
    "fourier_descriptors",
    "match_segments",
    "mean_log_ratio",
    "merge_segments",
    "outlines_of",
    "region_descriptors",
    "triangulate_points",
]
