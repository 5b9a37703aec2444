"""A panel as a plane: rectified views, their registration, the outer outline, the facing."""

from wayside.stages.panel.facing import solve_facing
from wayside.stages.panel.image_alignment import warp_to_template
from wayside.stages.panel.outline import OUTLINE_FEATURES, FaceOutline, outline_candidates
from wayside.stages.panel.outline_edges import gradients_of
from wayside.stages.panel.outline_shapes import (
    ASPECT,
    OUTLINE_SHAPES,
    box_round,
    face_corners,
    segments_of,
)
from wayside.stages.panel.posts import (
    FEATURES,
    POST_SPACE,
    measure_posts,
    post_below,
    post_features,
)
from wayside.stages.panel.rectification import PanelPlane, PosedImage, usable_views
from wayside.stages.panel.registration import RegisteredViews, outline_of, register_views

__all__ = [
    "ASPECT",
    "FEATURES",
    "OUTLINE_FEATURES",
    "OUTLINE_SHAPES",
    "POST_SPACE",
    "FaceOutline",
    "PanelPlane",
    "PosedImage",
    "RegisteredViews",
    "box_round",
    "face_corners",
    "gradients_of",
    "measure_posts",
    "outline_candidates",
    "outline_of",
    "post_below",
    "post_features",
    "register_views",
    "segments_of",
    "solve_facing",
    "usable_views",
    "warp_to_template",
]
