"""What is sent to a recording: paths of entities, and entities at the times of a frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

APPLICATION = "wayside"

FRAME, CAPTURE, STATION, LOG = "frame", "capture_time", "station_cm", "message_log_time"
"""Timelines: number of the frame, its capture time, distance along the road, and the time in the log.

The last has the name that Rerun's own MCAP importer gives it, so that results align with an imported log.
"""

WORLD = "world"
VEHICLE = "world/vehicle"
CAMERA = "world/vehicle/camera"
IMAGE = f"{CAMERA}/image"
PASSES = (f"{CAMERA}/segments/pass1", f"{CAMERA}/segments/pass2")
DIFFERENCE = f"{CAMERA}/segments/difference"
CANDIDATES = f"{CAMERA}/candidates"
KEYPOINTS, MATCHES = f"{CAMERA}/keypoints", f"{CAMERA}/matches"
SIFT_POINTS, SIFT_MATCHES = f"{CAMERA}/sift_points", f"{CAMERA}/sift_matches"
OUTLINES = f"{CAMERA}/outlines"
TRACKS, REPROJECTED = f"{CAMERA}/tracks", f"{CAMERA}/signs"
CHAINS = f"{CAMERA}/chains"
PATH, RAYS, LANDMARKS = "world/path", "world/rays", "world/places"
POINTS_STRAIGHT, POINTS_ADJUSTED = "world/points/straight", "world/points/adjusted"
MOVED = "world/adjusted"
SIGNS, SIGN_RAYS = "world/signs", "world/sign_rays"
GROUND = "world/ground"
MARKS = "world/marks"
NAMES, NAMES_IN_VIEW = "world/names/all", "world/names/in_view"
LOCATION = "location"
RESIDUALS, ITERATIONS, GATES = "residuals", "iterations", "gates"
SIGN_RESIDUALS, SIGN_FIGURES = "sign_residuals", "sign_figures"
PANELS, WINDOW_RESIDUALS = "panels", "window_residuals"
SIGN_PANELS, SIGN_ITERATIONS = "sign_panels", "sign_iterations"
REJECTIONS, INVENTORY = "rejections", "inventory"
MAP = "map"


class Entity:
    """Archetypes to log at one path."""

    def __init__(self, path: str, *parts: Any) -> None:
        self.path, self.parts = path, parts


def cleared(path: str, *, recursive: bool = False) -> Entity:
    """Nothing at a path, and with `recursive` below it, from now on."""
    return Entity(path, rr.Clear(recursive=recursive))


@dataclass(frozen=True, slots=True)
class Times:
    """When and where a frame was taken, one value a timeline."""

    frame: int
    capture_ns: int
    log_ns: int
    station_m: float | None = None
    """None: of a frame that is not used."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Entities of one frame; without times all of them are static."""

    times: Times | None
    entities: tuple[Entity, ...]

    def send(self, stream: rr.RecordingStream) -> None:
        """Log all of it, at times that are set for the calling thread alone."""
        if (times := self.times) is not None:
            stream.reset_time()
            stream.set_time(FRAME, sequence=times.frame)
            stream.set_time(CAPTURE, timestamp=np.datetime64(times.capture_ns, "ns"))
            stream.set_time(LOG, timestamp=np.datetime64(times.log_ns, "ns"))
            if times.station_m is not None:
                stream.set_time(STATION, sequence=round(100 * times.station_m))
        for one in self.entities:
            stream.log(one.path, *one.parts, static=times is None)
