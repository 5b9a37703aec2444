"""Landmarks measured over several frames, and frames whose candidates are all decided."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Dropped
from wayside.schemas.frame import Frame, Pose
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import Motion

EVIDENCE_TERMS = {
    "appearance": "how the classifier of boxes scored its views",
    "views": "how many views it has, and how many are missing",
    "size": "how small it is, and how large for its colour and shape",
    "place": "where it stands, compared with the other signs of this drive",
    "rigidity": "how well its boxes agree on a standing point",
    "surroundings": "how far what surrounds it moves apart from it",
}
"""Terms of the evidence for a landmark: what each log-likelihood ratio, sign against anything else, rests on."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One frame's view of a landmark: candidate `row` of frame `frame`; centre in ideal pixels, box in recorded."""

    frame: int
    row: int
    u_px: float
    v_px: float
    box: tuple[float, float, float, float]
    residual_px: float


@dataclass(frozen=True, slots=True)
class Landmark:
    """A panel seen in several frames, in three dimensions, with the verdict on it.

    position (3,), covariance (3, 3): metres in the camera frame of `best_frame` (right, down, ahead); right_m, above_m:
    distance right of the path and above the camera's path, at station_m along it; best_*: the image that shows it
    largest and whole; best_pose: of its camera in the drive's frame; score: log odds that it is a sign; residual_px:
    RMS of the views that the point was fitted to; back: seen from behind; assembly: number of its support, -1: none;
    features: what the landmark classifier saw, in the order of its `FEATURES`; evidence: log-likelihood ratio of each
    term, sign against anything else, whose sum with the prior log odds is the score. trajectory (s, 2, 4): for each
    step between two views that were matched by descriptors u, v, du, dv in the image, and the same without the rotation
    of the camera (`stages.report.trajectory_of`). color_log_probability, shape_log_probability: mean over the views of
    the log probability of each of `COLORS` and `SHAPES`; empty where no network classified them. face_log_probability:
    the same of each class of the face classifier; empty where no view was classified.
    """

    track_id: int
    views: tuple[Observation, ...]
    position: NDArray[np.float64]
    covariance: NDArray[np.float64]
    right_m: float
    above_m: float
    station_m: float
    best_frame: int
    best_time_ns: int
    best_box: tuple[float, float, float, float]
    best_pose: Pose
    width_m: float
    height_m: float
    sigma_width_m: float
    sigma_height_m: float
    facing_deg: float
    sigma_facing_deg: float
    color: str | None
    color_distance: float
    shape: str | None
    shape_distance: float
    score: float
    residual_px: float
    verdict: str
    back: bool = False
    assembly: int = -1
    features: tuple[float, ...] = field(default=(), repr=False)
    evidence: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    trajectory: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2, 4)), repr=False)
    color_log_probability: tuple[float, ...] = field(default=(), repr=False)
    shape_log_probability: tuple[float, ...] = field(default=(), repr=False)
    face_log_probability: tuple[float, ...] = field(default=(), repr=False)


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """A frame whose candidates are all decided.

    track_id (n,) int32 (-1: none), residual_px (n,) float32 per candidate row; region_count: regions of its image;
    landmarks: those seen first in it; dropped: regions that are not among the candidates;
    measurements: what those of its landmarks rest on; matches (k, 4): SIFT points of the previous used frame and where
    they were found in this one, u, v and u, v in recorded pixels (None: not matched by SIFT).
    The pixels are gone by now; `frame.data` keeps the bytes as recorded.
    """

    frame: Frame
    motion: Motion | None
    candidates: Candidates
    track_id: NDArray[np.int32]
    residual_px: NDArray[np.float32]
    region_count: int
    landmarks: tuple[Landmark, ...] = field(default=())
    dropped: Dropped = NOTHING_DROPPED
    measurements: tuple[Measurement, ...] = field(default=(), repr=False)
    matches: NDArray[np.float32] | None = field(default=None, repr=False)
