"""Rotations, lens distortion, midpoints of rays, offsets from a path, linear algebra and Levenberg-Marquardt."""

from wayside.stages.geometry.boxes import (
    box_areas,
    covered_fractions,
    intersection_areas,
    iou_matrix,
    non_maximum_suppression,
)
from wayside.stages.geometry.levenberg_marquardt import Schedule, minimiser
from wayside.stages.geometry.linear_algebra import cholesky_solve, cross_matrices, invert_symmetric
from wayside.stages.geometry.path import FrenetOffset, frenet_offset, median_longitude_deg, turn_deg
from wayside.stages.geometry.ray_midpoint import (
    meet_rays,
    pair_midpoint,
    pair_residual,
    points_of_second,
)
from wayside.stages.geometry.rotation import (
    halfway_direction,
    rotation_from_vector,
    tangent_basis,
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
    "Schedule",
    "box_areas",
    "cholesky_solve",
    "covered_fractions",
    "cross_matrices",
    "distort_points",
    "frenet_offset",
    "halfway_direction",
    "ideal_of_rays",
    "ideal_points",
    "intersection_areas",
    "invert_symmetric",
    "iou_matrix",
    "median_longitude_deg",
    "meet_rays",
    "minimiser",
    "non_maximum_suppression",
    "pair_midpoint",
    "pair_residual",
    "points_of_second",
    "rays_of_ideal",
    "rotation_from_vector",
    "tangent_basis",
    "to_rays",
    "turn_deg",
    "vector_from_rotation",
]
