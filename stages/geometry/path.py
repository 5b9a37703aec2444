"""Frenet coordinates of a point relative to the travelled path; longitudes and directions, which go round."""

from typing import NamedTuple, TypeVar

import numpy as np

from wayside.stages.kernels import Array

Degrees = TypeVar("Degrees", float, Array)


class FrenetOffset(NamedTuple):
    """Station along the path, and the offset at that station: to the right, above the camera's path; metres."""

    station: float
    right: float
    above: float


def frenet_offsets(
    points: Array, centres: Array, ups: Array, stations: Array, ahead: Array
) -> list[FrenetOffset]:
    """Project points onto the polyline of camera centres, which is extended straight beyond both ends.

    `points` (k, 3), `centres` (n, 3): in the world; cameras in the order of travel, n at least 1.
    `ups` (n, 3), `stations` (n,): up axis of each camera in the world, and distance along the path, metres.
    `ahead` (3,): direction of travel, used for a single camera.
    """
    if len(centres) == 1:
        starts, steps, lengths = centres, ahead[None], np.ones(1)
    else:
        starts, steps = centres[:-1], np.diff(centres, axis=0)
        lengths = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    fraction = ((points[:, None] - starts) * steps).sum(axis=2) / lengths**2
    fraction[:, 1:] = np.maximum(fraction[:, 1:], 0.0)
    fraction[:, :-1] = np.minimum(fraction[:, :-1], 1.0)
    apart = points[:, None] - (starts + fraction[..., None] * steps)
    row, at = np.arange(len(points)), (apart**2).sum(axis=2).argmin(axis=1)
    offset, along = apart[row, at], steps[at] / lengths[at, None]
    up = ups[at] - (ups[at] * along).sum(axis=1)[:, None] * along
    up /= np.linalg.norm(up, axis=1)[:, None]
    right = along[:, [1, 2, 0]] * up[:, [2, 0, 1]] - along[:, [2, 0, 1]] * up[:, [1, 2, 0]]
    station = stations[at] + fraction[row, at] * lengths[at]
    found = station, (offset * right).sum(axis=1), (offset * up).sum(axis=1)
    return [*map(FrenetOffset._make, np.stack(found, axis=1).tolist())]


def turn_deg(start: float, end: Degrees) -> Degrees:
    """From one longitude, or compass direction, to another the short way round, degrees, -180 to 180."""
    return (end - start + 180.0) % 360.0 - 180.0


def median_longitude_deg(longitudes: Array) -> float:
    """Median of longitudes (n,), degrees, on whichever side of 180 they lie; of a drive, not of the earth."""
    first = float(longitudes[0])
    return turn_deg(0.0, first + float(np.median(turn_deg(first, longitudes))))
