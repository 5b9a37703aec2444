"""Rotations, lens distortion, midpoints, offsets from a path."""

from wayside.stages.geometry.bound import point_bound, step_bound
from wayside.stages.geometry.path import FrenetOffset, frenet_offset
from wayside.stages.geometry.ray_midpoint import meet_rays, midpoint, pair_residual
from wayside.stages.geometry.rotation import (
    across,
    cholesky_solve,
    rotation_from_vector,
    vector_from_rotation,
)
from wayside.stages.geometry.undistortion import (
    distort_points,
    ideal_of_rays,
    ideal_points,
    rays_of_ideal,
    to_rays,
)

__all__ = [
    "FrenetOffset",
    "across",
    "cholesky_solve",
    "distort_points",
    "frenet_offset",
    "ideal_of_rays",
    "ideal_points",
    "meet_rays",
    "midpoint",
    "pair_residual",
    "point_bound",
    "rays_of_ideal",
    "rotation_from_vector",
    "step_bound",
    "to_rays",
    "vector_from_rotation",
]
