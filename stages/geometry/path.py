"""Where a point lies beside the travelled path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class FrenetOffset(NamedTuple):
    """Station along the path, and the offset at that station: to the right, above the camera's path; metres."""

    station: float
    right: float
    above: float


def frenet_offset(
    point: NDArray[np.float64],
    centres: NDArray[np.float64],
    ups: NDArray[np.float64],
    stations: NDArray[np.float64],
    ahead: NDArray[np.float64],
) -> FrenetOffset:
    """Project a point on the chain of camera centres; before and past its ends the path goes on straight.

    Parameters
    ----------
    point
        (3,) in the world.
    centres
        Camera centres in the order of travel, (n, 3), n at least 1.
    ups
        The cameras' own up in the world, (n, 3).
    stations
        Distance along the path at each centre, (n,), metres.
    ahead
        Direction of travel where there is one camera only, (3,).
    """
    if len(centres) == 1:
        starts, steps, lengths = centres, ahead[None], np.ones(1)
    else:
        starts, steps = centres[:-1], np.diff(centres, axis=0)
        lengths = np.maximum(np.linalg.norm(steps, axis=1), 1e-9)
    share = ((point - starts) * steps).sum(axis=1) / lengths**2
    low, high = np.zeros(len(steps)), np.ones(len(steps))
    low[0], high[-1] = -np.inf, np.inf
    share = np.clip(share, low, high)
    foot = starts + share[:, None] * steps
    nearest = int(np.argmin(((point - foot) ** 2).sum(axis=1)))
    along = steps[nearest] / lengths[nearest]
    up = ups[nearest] - (ups[nearest] @ along) * along
    up /= np.linalg.norm(up)
    gap = point - foot[nearest]
    station = stations[nearest] + share[nearest] * lengths[nearest]
    return FrenetOffset(float(station), float(gap @ np.cross(along, up)), float(gap @ up))
