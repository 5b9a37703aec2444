"""A part of a drive for self-calibration: its images with their motion, ties linked to tracks, and points."""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from wayside.schemas.frame import Camera
from wayside.schemas.motion import Motion
from wayside.stages.adjustment import (
    DISPLACEMENT_SIGMA,
    FARTHEST_TIE_M,
    NEAREST_TIE_M,
    NO_TIES,
    TIE_ERRORS,
    StepTies,
    correlated_sigma_px,
    link_tracks,
    select_tracks,
    ties_of_step,
)
from wayside.stages.geometry import distort_points, ideal_of_rays, tangent_basis
from wayside.stages.kernels import Array, Numbers

SEGMENT_IMAGES = 12
"""Images of a segment, within which tracks are adjusted together."""
FEWEST_TRACKS = 20
"""A segment with fewer tracks is left out."""
KNOWN_TURNS = ("poses", "odometry")
"""Sources of motion that know how the camera turned."""

_SHORTEST_M = 1e-3


class Segment(NamedTuple):
    """Images of a part of a drive, the first at the origin, and the tracks in them.

    `rotations` (m, 3, 3), `centres` (m, 3): world from camera, world that of the first camera. `turns` (m - 1, 3, 3):
    rotation of each image in the axes of the one before, by the log. `turn_sigma` (m - 1,): its standard deviation,
    rad, inf where unknown. `lengths` (m - 1,) m.

    Of each pair of a point and an image that shows it, those of a track together and in order: `frame`, `track` (o,).

    Of each tie, in the same order: `early` (n,): pair in its earlier image; the next one is that in its later image.
    `start`, `end` (n, 2): recorded pixels. `warp` (n, 3): map of the surroundings of `start` to those of `end`.
    `sigma_px` (n,) of a coordinate. `shared_px` (n,): sigma of the error common to neighbouring ties. `head` (p,):
    first tie of each track.

    A point is origin + (ray + offset @ basis) / w, with origin, ray (p, 3) and basis (p, 2, 3) constant. The rows of
    `points` (p, 3) are offset and w, the inverse distance.
    """

    rotations: Array
    centres: Array
    turns: Array
    turn_sigma: Array
    lengths: Array
    frame: Numbers
    track: Numbers
    early: Numbers
    start: Array
    end: Array
    warp: Array
    sigma_px: Array
    shared_px: Array
    head: Numbers
    origin: Array
    ray: Array
    basis: Array
    points: Array


def cut_segments(
    motions: Sequence[Motion], camera: Camera, images: int = SEGMENT_IMAGES, cell_px: float = 0.0
) -> list[Segment]:
    """Segments of `images` images, each beginning with the last of the one before; those with few tracks left out.

    `cell_px`: of the ties of an image, one is kept in each cell of this size, longest tracks first; 0: all.
    """
    starts = range(0, len(motions) - 2, images - 1)
    found = (make_segment(motions[k : k + images], camera, cell_px) for k in starts)
    return [one for one in found if one is not None and len(one.head) >= FEWEST_TRACKS]


def make_segment(motions: Sequence[Motion], camera: Camera, cell_px: float = 0.0) -> Segment | None:
    """Link the ties of a part of a drive to tracks and place their points.

    camera: that the ties were undistorted with. What led to the first image is ignored. cell_px: see `cut_segments`.

    Returns None without a track over three images.
    """
    steps = (ties_of_step(k, m, camera, camera, inliers=False) for k, m in enumerate(motions[1:]))
    all_ties = StepTies.joined([NO_TIES, *steps])
    all_ties = all_ties.select(np.flatnonzero((all_ties.corners >= 0).all(axis=1)))
    linked = link_tracks(all_ties.step, all_ties.corners)
    long = np.bincount(linked, minlength=1)[linked] >= 2
    if cell_px > 0:
        cell = np.floor(all_ties.pixel / cell_px).astype(np.int64)
        long &= select_tracks(linked, all_ties.step, cell)
    if not long.any():
        return None
    order = np.flatnonzero(long)[np.lexsort((all_ties.step[long], linked[long]))]
    tied = all_ties.select(order)
    _, head, track = np.unique(linked[order], return_index=True, return_inverse=True)
    poses = [m.pose.relative_to(motions[0].pose) for m in motions]
    rotations = np.array([pose.rotation for pose in poses])
    centres = np.array([pose.centre for pose in poses])
    early = np.arange(len(track)) + track
    pairs = np.zeros((2, len(track) + len(head)), np.int64)
    for shift in (0, 1):
        pairs[:, early + shift] = tied.step + shift, track
    begin = tied.step[head]
    local = np.column_stack([tied.source[head], np.ones(len(head))])
    local /= np.linalg.norm(local, axis=1)[:, None]
    ray = np.einsum("nij,nj->ni", rotations[begin], local)
    distance = np.einsum("ni,ni->n", tied.place[head], local)
    known = np.isfinite(distance) & (distance > NEAREST_TIE_M)
    inverse = np.where(known, 1 / np.where(known, distance, 1.0), 1 / FARTHEST_TIE_M)
    priors = [m.prior if m.source in KNOWN_TURNS else None for m in motions[1:]]
    gaps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    return Segment(
        rotations=rotations,
        centres=centres,
        turns=np.array([np.eye(3) if p is None else p.rotation for p in priors]),
        turn_sigma=np.array([inf if p is None else p.sigma_rotation for p in priors]),
        lengths=np.maximum(gaps, _SHORTEST_M),
        frame=pairs[0],
        track=pairs[1],
        early=early,
        start=distort_points(camera, ideal_of_rays(camera, tied.source)),
        end=distort_points(camera, tied.pixel),
        warp=tied.warp,
        sigma_px=np.hypot(TIE_ERRORS.sigma_px, DISPLACEMENT_SIGMA * tied.displacement_px),
        shared_px=correlated_sigma_px(tied.displacement_px),
        head=np.asarray(head, np.int64),
        origin=centres[begin],
        ray=ray,
        basis=np.array([tangent_basis(np.ascontiguousarray(one)) for one in ray]),
        points=np.column_stack([np.zeros((len(head), 2)), inverse]),
    )
