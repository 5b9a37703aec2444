"""What is sent to a recording: entities at the times of a frame, whole columns, and the names of the timelines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr

from wayside.schemas.frame import Frame

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
MARKS = "world/marks"
NAMES, NAMES_IN_VIEW = "world/names/all", "world/names/in_view"
LOCATION = "location"
RESIDUALS, ITERATIONS, GATES = "residuals", "iterations", "gates"
SIGN_RESIDUALS, SIGN_FIGURES = "sign_residuals", "sign_figures"
PANELS, WINDOW_RESIDUALS = "panels", "window_residuals"
SIGN_PANELS, SIGN_ITERATIONS = "sign_panels", "sign_iterations"
REJECTIONS, INVENTORY = "rejections", "inventory"
MAP = "map"


@dataclass(frozen=True, slots=True)
class Entity:
    """Something to log at one path: archetypes, for the time of the frame or for good."""

    path: str
    parts: tuple[Any, ...]
    static: bool = False


@dataclass(frozen=True, slots=True)
class Times:
    """When and where a frame was taken, one value a timeline; the station is unknown for frames not used."""

    frame: int
    capture_ns: int
    log_ns: int
    station_m: float | None = None

    @staticmethod
    def of(frame: Frame, station_m: float | None = None) -> Times:
        """Times of a frame."""
        return Times(frame.index, frame.time_ns, frame.log_time_ns, station_m)

    def apply(self, stream: rr.RecordingStream) -> None:
        """Set them on a stream, for the calling thread alone."""
        stream.reset_time()
        stream.set_time(FRAME, sequence=self.frame)
        stream.set_time(CAPTURE, timestamp=np.datetime64(self.capture_ns, "ns"))
        stream.set_time(LOG, timestamp=np.datetime64(self.log_ns, "ns"))
        if self.station_m is not None:
            stream.set_time(STATION, sequence=round(100 * self.station_m))


@dataclass(frozen=True, slots=True)
class Batch:
    """Entities of one frame; without times all of them are static."""

    times: Times | None
    entities: tuple[Entity, ...]

    def send(self, stream: rr.RecordingStream) -> None:
        """Log all of it."""
        if self.times is not None:
            self.times.apply(stream)
        for entity in self.entities:
            stream.log(entity.path, *entity.parts, static=entity.static or self.times is None)

    def paths(self) -> Iterator[str]:
        """Paths of its entities."""
        return (entity.path for entity in self.entities)


@dataclass(frozen=True, slots=True)
class Columns:
    """One entity at many frames, sent at once; `columns` come from an archetype's `columns`."""

    path: str
    times: tuple[Times, ...]
    columns: tuple[Any, ...] = field(repr=False)

    def send(self, stream: rr.RecordingStream) -> None:
        """Send all rows."""
        stations = [round(100 * (t.station_m or 0.0)) for t in self.times]
        stream.send_columns(
            self.path,
            [
                rr.TimeColumn(FRAME, sequence=[t.frame for t in self.times]),
                rr.TimeColumn(CAPTURE, timestamp=_nanoseconds(t.capture_ns for t in self.times)),
                rr.TimeColumn(LOG, timestamp=_nanoseconds(t.log_ns for t in self.times)),
                rr.TimeColumn(STATION, sequence=stations),
            ],
            self.columns,
        )


@dataclass(frozen=True, slots=True)
class Bundle:
    """Several things sent as one: none of them can be left out alone."""

    parts: tuple[Batch | Columns | Bundle, ...]

    def send(self, stream: rr.RecordingStream) -> None:
        """Send all of it."""
        for part in self.parts:
            part.send(stream)

    def paths(self) -> Iterator[str]:
        """Paths of its entities."""
        for part in self.parts:
            yield from (part.path,) if isinstance(part, Columns) else part.paths()


def image_plane(frame_id: str) -> str:
    """Coordinate frame that Rerun's importer gives to the images of a camera frame."""
    return f"{frame_id}_image_plane"


def _nanoseconds(values: Any) -> Any:
    return np.array(list(values), "datetime64[ns]")
