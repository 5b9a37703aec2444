"""Landmarks measured over several frames, and frames whose candidates are all decided."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import NOTHING_DROPPED, Candidates, Dropped
from wayside.schemas.frame import Camera, Frame, Pose
from wayside.schemas.measurement import Measurement
from wayside.schemas.motion import Motion
from wayside.schemas.roadside import Posts

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
    """The view of a landmark in one frame."""

    frame: int
    """Index of the frame in the log."""
    row: int
    """Row of the candidate in the table of the frame."""
    u_px: float
    """Column of the centre, ideal pixels."""
    v_px: float
    """Row of the centre, ideal pixels."""
    box: tuple[float, float, float, float]
    """x0, y0, x1, y1, pixels as recorded."""
    residual_px: float
    """Distance to the reprojected landmark."""


_VIEW = np.dtype("i4, i4, f8, f8, f4, f4, f4, f4, f8")


class Views(Sequence[Observation]):
    """The views of a landmark as a table of their numbers: all signs of a drive are held until it ends."""

    def __init__(self, *columns: NDArray[Any]) -> None:
        rows = zip(*(column.tolist() for column in columns), strict=True)
        self._table = np.fromiter(rows, _VIEW)

    def __len__(self) -> int:
        """Count views."""
        return len(self._table)

    def __getitem__(self, index: Any) -> Any:
        """One view, or those of a slice."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        frame, row, u_px, v_px, *box, residual_px = self._table[index].item()
        return Observation(frame, row, u_px, v_px, tuple(box), residual_px)


@dataclass(frozen=True, slots=True)
class Crop:
    """The pixels of a view of a landmark."""

    grey: NDArray[np.uint8]
    """Its box and a margin, (height, width)."""
    corner: NDArray[np.float64]
    """Column and row of the first pixel in the image, (2,)."""
    camera: Camera
    """Of the image."""
    motion: Motion
    """Of the camera."""


@dataclass(frozen=True, slots=True)
class Landmark:
    """A panel seen in several frames, in three dimensions, with the verdict on it."""

    track_id: int
    """Number of the landmark in the drive."""
    views: Sequence[Observation]
    """Where it was measured, oldest first."""
    position: NDArray[np.float64]
    """Centre of the panel in the camera frame of `best_frame`, (3,), metres."""
    covariance: NDArray[np.float64]
    """Of the position, relative to that camera, (3, 3)."""
    right_m: float
    """Distance to the right of the path."""
    above_m: float
    """Height above the camera's path."""
    station_m: float
    """Distance along the path."""
    best_frame: int
    """Frame whose image shows it largest and whole."""
    best_time_ns: int
    """Capture time of that frame."""
    best_box: tuple[float, float, float, float]
    """Its box there: x0, y0, x1, y1, pixels as recorded."""
    best_pose: Pose
    """Camera of that frame in the frame of the drive."""
    width_m: float
    """Width of the panel."""
    height_m: float
    """Height of the panel."""
    sigma_width_m: float
    """Standard deviation of the width."""
    sigma_height_m: float
    """Standard deviation of the height."""
    facing_deg: float
    """Normal of the panel relative to the reverse of travel. 0 faces the camera, right turn positive."""
    sigma_facing_deg: float
    """Standard deviation of the facing."""
    color: str | None
    """One of `COLORS`. None: unknown."""
    color_distance: float
    """Mahalanobis distance to that colour. nan: not computed. Presets of the report only."""
    shape: str | None
    """One of `SHAPES`. None: unknown."""
    shape_distance: float
    """Mahalanobis distance to that shape. nan: not computed. Preset `report-shape` only."""
    score: float
    """Log odds that it is a sign."""
    residual_px: float
    """RMS of the views that the point was fitted to."""
    verdict: str
    """One of `VERDICTS`."""
    back: bool = False
    """Whether it is seen from behind."""
    assembly: int = -1
    """Number of its support. -1: none."""
    features: Sequence[float] = field(default=(), repr=False)
    """What the landmark classifier saw, in the order of its `FEATURES`."""
    evidence: tuple[tuple[str, float], ...] = field(default=(), repr=False)
    """Log-likelihood ratio of each term, sign against anything else. With the prior log odds they sum to `score`."""
    trace: tuple[Any, Sequence[Pose]] = field(default=((), ()), repr=False)
    """Its ray (x/z, y/z) in each view, (n, 2), and the camera of each. See `trajectory_of`."""
    crops: tuple[Crop, ...] = field(default=(), repr=False)
    """Its last two views, until its points are triangulated. Presets of the report only."""
    color_log_probability: Sequence[float] = field(default=(), repr=False)
    """Mean over the views, of each of `LEARNED_COLORS`. Empty: no network classified them."""
    shape_log_probability: Sequence[float] = field(default=(), repr=False)
    """The same of each of `SHAPES`."""
    face_log_probability: Sequence[float] = field(default=(), repr=False)
    """The same of each class of the face classifier. Empty: no view was classified."""
    posts: Posts | None = None
    """What the panel stands on. None: not measured."""


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """A frame whose candidates are all decided. Its pixels are gone; `frame.data` keeps the recorded bytes."""

    frame: Frame
    """The frame."""
    motion: Motion | None
    """None: the frame is not used."""
    candidates: Candidates
    """All candidates of its image, n rows."""
    track_id: NDArray[np.int32]
    """Landmark that each belongs to, (n,). -1: none."""
    residual_px: NDArray[np.float32]
    """Distance of each to its reprojected landmark, (n,). nan: none."""
    region_count: int
    """Number of regions of its image."""
    landmarks: tuple[Landmark, ...] = field(default=())
    """Those seen first in this frame."""
    dropped: Dropped = NOTHING_DROPPED
    """Number of regions that are not among the candidates."""
    measurements: tuple[Measurement, ...] = field(default=(), repr=False)
    """What the measurements of those landmarks rest on."""
    matches: NDArray[np.float32] | None = field(default=None, repr=False)
    """Matched regions of the previous used frame and of this one, (k, 4): u, v, u, v, pixels. None: no SIFT."""
