"""Bundle adjustment of frames and points together (report chapter 8)."""

from wayside.stages.adjustment.bundle_adjustment import WINDOW_ITERATIONS, Window, adjust_window
from wayside.stages.adjustment.correlated_errors import (
    TIE_ERRORS,
    TieErrors,
    correlated_covariance,
    correlated_sigma_px,
    tie_scatter,
)
from wayside.stages.adjustment.residuals import (
    QUADRATIC,
    ResidualBlocks,
    StepConstraints,
    constraint_residuals,
)
from wayside.stages.adjustment.tie_tracks import (
    ANCHOR_SIGMA_PX,
    DISPLACEMENT_SIGMA,
    FARTHEST_TIE_M,
    NEAREST_TIE_M,
    TIE_SCALE,
    StepTies,
    link_tracks,
    select_tracks,
    ties_of_step,
)

__all__ = [
    "ANCHOR_SIGMA_PX",
    "DISPLACEMENT_SIGMA",
    "FARTHEST_TIE_M",
    "NEAREST_TIE_M",
    "QUADRATIC",
    "TIE_ERRORS",
    "TIE_SCALE",
    "WINDOW_ITERATIONS",
    "ResidualBlocks",
    "StepConstraints",
    "StepTies",
    "TieErrors",
    "Window",
    "adjust_window",
    "constraint_residuals",
    "correlated_covariance",
    "correlated_sigma_px",
    "link_tracks",
    "select_tracks",
    "tie_scatter",
    "ties_of_step",
]
