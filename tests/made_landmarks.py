"""A landmark made by hand."""

from dataclasses import replace

import numpy as np

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, Observation


def made_landmark(**changes):
    """A yellow diamond seen once, 12 m ahead of the first camera."""
    box = (10, 20, 30, 60)
    made = Landmark(
        track_id=1,
        views=(Observation(1, 0, 20.0, 40.0, box, 0.2),),
        position=np.array([3.0, -0.5, 12.0]),
        covariance=np.diag([0.01, 0.02, 0.04]),
        right_m=3.0,
        above_m=0.5,
        station_m=12.0,
        best_frame=1,
        best_time_ns=10**9,
        best_box=box,
        best_pose=Pose(np.eye(3), np.zeros(3)),
        width_m=0.6,
        height_m=0.8,
        sigma_width_m=0.02,
        sigma_height_m=0.02,
        facing_deg=0.0,
        sigma_facing_deg=5.0,
        color="yellow",
        color_distance=1.0,
        shape="diamond",
        shape_distance=1.0,
        score=3.0,
        residual_px=0.4,
        verdict="sign",
    )
    return replace(made, **changes)
