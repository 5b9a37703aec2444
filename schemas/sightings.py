"""Panels as single drives measured them, and the panels and supports that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Rows:
    """Columns of one length, the fields of a dataclass."""

    __slots__ = ()

    def select(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Self:
        """Some of the rows."""
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))  # type: ignore[arg-type]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The rows of several, one after the other; at least one."""
        names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True, slots=True)
class Sightings(Rows):
    """Rows of the `signs.parquet` of several drives, near each other; n rows in order of drive, then station.

    Metres and radians; nan and -1: unknown. drive (n,): number of the drive; row (n,): in its table; time_ns (n,);
    position (n, 3): east, north, up in one frame for all; covariance (n, 3, 3): relative to the cameras nearby;
    common_sigma_m (n, 2): level and up, standard deviation of the error that neighbouring panels of the drive share;
    assembly (n,): number of the support within the drive; color, shape (n,): codes of the classes;
    front (n,): whether the face was seen, not the back;
    bearing_rad (n,): compass direction that the face looks in; size_m, size_sigma_m (n, 2): width and height.
    """

    drive: Ints
    row: Ints
    time_ns: Ints
    position: Floats
    covariance: Floats
    common_sigma_m: Floats
    assembly: Ints
    color: Ints
    shape: Ints
    front: Flags
    bearing_rad: Floats
    size_m: Floats
    size_sigma_m: Floats

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.drive)


@dataclass(frozen=True, slots=True)
class MergedPanels:
    """What sightings are sightings of: n sightings, p panels, s supports.

    offset_m (n, 3): estimated error that the drive had there, to be subtracted from the position; panel (n,): number of
    the panel; position (p, 3), covariance (p, 3, 3): east, north, up; support (p,): number of the support;
    place (p,): the same for panels that stood one after the other where one stands.
    """

    offset_m: Floats
    panel: Ints
    position: Floats
    covariance: Floats
    support: Ints
    place: Ints
