"""A landmark, and the motion of a straight drive, made by hand."""

import numpy as np

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Landmark, Observation
from wayside.schemas.motion import Motion


def made_landmark(**changes):
    """A yellow diamond seen once, 12 m ahead of the first camera."""
    box = (10, 20, 30, 60)
    seen = {"track_id": 1, "views": (Observation(1, 0, 20.0, 40.0, box, 0.2),), "best_box": box}
    seen |= {"best_frame": 1, "best_time_ns": 10**9, "best_pose": Pose(np.eye(3), np.zeros(3))}
    place = {"position": np.array([3.0, -0.5, 12.0]), "covariance": np.diag([0.01, 0.02, 0.04])}
    place |= {"right_m": 3.0, "above_m": 0.5, "station_m": 12.0, "residual_px": 0.4}
    size = {"width_m": 0.6, "height_m": 0.8, "sigma_width_m": 0.02, "sigma_height_m": 0.02}
    size |= {"facing_deg": 0.0, "sigma_facing_deg": 5.0, "verdict": "sign", "score": 3.0}
    look = {"color": "yellow", "color_distance": 1.0, "shape": "diamond", "shape_distance": 1.0}
    return Landmark(**seen | place | size | look | changes)


def made_motion(step, covariance=None, residual_px=0.1, camera_height_m=1.8):
    """The motion after so many steps of 8 m straight ahead."""
    ahead = Pose(np.eye(3), np.array([0.0, 0.0, 8.0]))
    known = (ahead, covariance, "straight", 8.0) if step else (None, None, "start", 0.0)
    residuals = (None, residual_px, residual_px, False, 0, camera_height_m)
    return Motion(Pose(np.eye(3), step * ahead.centre), *known, 8.0 * step, *residuals)
