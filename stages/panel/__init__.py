"""A panel as a plane: rectified views, their registration, the outer outline, the facing."""

from wayside.stages.panel.facing import solve_facing as solve_facing
from wayside.stages.panel.image_alignment import warp_to_template as warp_to_template
from wayside.stages.panel.outline import OUTLINE_FEATURES as OUTLINE_FEATURES
from wayside.stages.panel.outline import FaceOutline as FaceOutline
from wayside.stages.panel.outline import outline_candidates as outline_candidates
from wayside.stages.panel.outline_edges import gradients_of as gradients_of
from wayside.stages.panel.outline_shapes import ASPECT as ASPECT
from wayside.stages.panel.outline_shapes import OUTLINE_SHAPES as OUTLINE_SHAPES
from wayside.stages.panel.outline_shapes import box_round as box_round
from wayside.stages.panel.outline_shapes import face_corners as face_corners
from wayside.stages.panel.outline_shapes import segments_of as segments_of
from wayside.stages.panel.posts import POST_FEATURES as POST_FEATURES
from wayside.stages.panel.posts import measure_posts as measure_posts
from wayside.stages.panel.rectification import PanelPlane as PanelPlane
from wayside.stages.panel.rectification import PosedImage as PosedImage
from wayside.stages.panel.rectification import usable_views as usable_views
from wayside.stages.panel.registration import RegisteredViews as RegisteredViews
from wayside.stages.panel.registration import register_views as register_views
