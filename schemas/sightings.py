"""Panels as single drives measured them, and the panels and supports that they are of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Rows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Sightings(Rows):
    """Rows of the `signs.parquet` of several drives, near each other; n rows in order of drive, then station."""

    drive: Ints
    """Number of the drive, (n,)."""
    row: Ints
    """Row in its table, (n,)."""
    time_ns: Ints
    """Capture time, (n,)."""
    position: Floats
    """East, north, up in one frame for all, (n, 3), metres."""
    covariance: Floats
    """Relative to the cameras nearby, (n, 3, 3)."""
    common_sigma_m: Floats
    """Level and up: error that neighbouring panels of the drive share, (n, 2)."""
    assembly: Ints
    """Number of the support within the drive, (n,). -1: unknown."""
    color: Ints
    """Code of the class, (n,). -1: unknown."""
    shape: Ints
    """Code of the class, (n,). -1: unknown."""
    code: Ints
    """Index into `CODES`, (n,). -1: not known to its legend."""
    front: Flags
    """Whether the face was seen, not the back, (n,)."""
    bearing_rad: Floats
    """Compass direction that the face looks in, (n,). nan: unknown."""
    size_m: Floats
    """Width and height, (n, 2). nan: unknown."""
    size_sigma_m: Floats
    """Standard deviations of both, (n, 2)."""


@dataclass(frozen=True, slots=True)
class MergedPanels:
    """Panels and supports that sightings show: n sightings, p panels, s supports."""

    offset_m: Floats
    """Estimated error of the drive there, to be subtracted from the position, (n, 3)."""
    panel: Ints
    """Number of the panel, (n,)."""
    position: Floats
    """East, north, up, (p, 3), metres."""
    covariance: Floats
    """Of the position, (p, 3, 3)."""
    support: Ints
    """Number of the support, (p,)."""
    place: Ints
    """Number of the place, (p,): the same for panels that stood one after the other where one stands."""
