"""What only the report's own chains need: colour, shape and trajectory gates, SIFT matching (chapters 3 to 5)."""

from wayside.stages.report.color import COLOR_SPACES as COLOR_SPACES
from wayside.stages.report.color import classify_color as classify_color
from wayside.stages.report.color import color_features as color_features
from wayside.stages.report.match import extract_sift as extract_sift
from wayside.stages.report.match import match_segments as match_segments
from wayside.stages.report.points import merge_segments as merge_segments
from wayside.stages.report.points import triangulate_points as triangulate_points
from wayside.stages.report.shape import DESCRIPTORS as DESCRIPTORS
from wayside.stages.report.shape import TERMS as TERMS
from wayside.stages.report.shape import classify_shape as classify_shape
from wayside.stages.report.shape import fourier_descriptors as fourier_descriptors
from wayside.stages.report.shape import outlines_of as outlines_of
from wayside.stages.report.trajectory import classify_trajectory as classify_trajectory
from wayside.stages.report.trajectory import track_log_ratio as track_log_ratio
