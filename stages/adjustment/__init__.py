"""Bundle adjustment of frames and points together (report chapter 8)."""

from wayside.stages.adjustment.bundle_adjustment import WINDOW_ITERATIONS as WINDOW_ITERATIONS
from wayside.stages.adjustment.bundle_adjustment import Window as Window
from wayside.stages.adjustment.bundle_adjustment import adjust_window as adjust_window
from wayside.stages.adjustment.correlated_errors import TIE_ERRORS as TIE_ERRORS
from wayside.stages.adjustment.correlated_errors import TieErrors as TieErrors
from wayside.stages.adjustment.correlated_errors import (
    correlated_covariance as correlated_covariance,
)
from wayside.stages.adjustment.correlated_errors import correlated_sigma_px as correlated_sigma_px
from wayside.stages.adjustment.correlated_errors import tie_scatter as tie_scatter
from wayside.stages.adjustment.residuals import QUADRATIC as QUADRATIC
from wayside.stages.adjustment.residuals import ResidualBlocks as ResidualBlocks
from wayside.stages.adjustment.residuals import StepConstraints as StepConstraints
from wayside.stages.adjustment.residuals import constraint_residuals as constraint_residuals
from wayside.stages.adjustment.tie_tracks import ANCHOR_SIGMA_PX as ANCHOR_SIGMA_PX
from wayside.stages.adjustment.tie_tracks import DISPLACEMENT_SIGMA as DISPLACEMENT_SIGMA
from wayside.stages.adjustment.tie_tracks import FARTHEST_TIE_M as FARTHEST_TIE_M
from wayside.stages.adjustment.tie_tracks import NEAREST_TIE_M as NEAREST_TIE_M
from wayside.stages.adjustment.tie_tracks import NO_TIES as NO_TIES
from wayside.stages.adjustment.tie_tracks import TIE_SCALE as TIE_SCALE
from wayside.stages.adjustment.tie_tracks import StepTies as StepTies
from wayside.stages.adjustment.tie_tracks import link_tracks as link_tracks
from wayside.stages.adjustment.tie_tracks import select_tracks as select_tracks
from wayside.stages.adjustment.tie_tracks import ties_of_step as ties_of_step
