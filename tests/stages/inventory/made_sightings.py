"""Sightings of drives that see all panels of a road once."""

import numpy as np

from wayside.schemas.sightings import Sightings


def road(n, step_m=25.0):
    """Places of panels on both sides of a road (n, 3)."""
    along = step_m * np.arange(n)
    return np.stack([along, np.where(np.arange(n) % 2, 6.0, -6.0), np.full(n, 2.2)], axis=1)


def make_sightings(position, drives, *, own_m, common_m, face, **more):
    """Rows of drives (d) times panels (n) at positions (d n, 3), with faces (n,) that differ by number."""
    count, panels = len(position), len(position) // drives
    panel = np.tile(np.arange(panels), drives)
    seen = {"drive": np.repeat(np.arange(drives), panels), "row": panel, "assembly": panel}
    seen |= {"time_ns": np.arange(count) * 10**9, "position": position}
    errors = {"covariance": np.tile(np.eye(3) * own_m**2, (count, 1, 1))}
    errors |= {"common_sigma_m": np.full((count, 2), common_m)}
    size = {"size_m": np.full((count, 2), 0.75), "size_sigma_m": np.full((count, 2), 0.02)}
    look = {"color": face[panel] % 5, "shape": face[panel] % 3, "code": np.full(count, -1)}
    look |= {"front": np.ones(count, bool), "bearing_rad": np.zeros(count)}
    return Sightings(**seen | errors | size | look | more)
