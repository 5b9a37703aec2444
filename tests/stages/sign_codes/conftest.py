"""A landmark as the tests of this room take it."""

import numpy as np
import pytest

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark


@pytest.fixture
def landmark():
    """One whose face nothing classified yet."""
    return Landmark(
        track_id=1,
        views=(),
        position=np.zeros(3),
        covariance=np.eye(3),
        right_m=3.0,
        above_m=0.5,
        station_m=12.0,
        best_frame=1,
        best_time_ns=1,
        best_box=(0, 0, 9, 9),
        best_pose=Pose(np.eye(3), np.zeros(3)),
        width_m=0.6,
        height_m=0.76,
        sigma_width_m=0.01,
        sigma_height_m=0.01,
        facing_deg=0.0,
        sigma_facing_deg=5.0,
        color="white",
        color_distance=np.nan,
        shape="rectangle",
        shape_distance=np.nan,
        score=3.0,
        residual_px=0.4,
        verdict="sign",
    )
