"""Rows of the tables `signs` and `frames`: what is known of a sign or a frame, in the names of the columns."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.schemas.landmarks import EVIDENCE_TERMS, TrackedFrame
from wayside.schemas.sign_catalogue import US, VIENNA
from wayside.schemas.signs import Sign
from wayside.schemas.tables import FRAMES
from wayside.stages.georeference import DrivePath

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_GLOBE = ("lon_deg", "lat_deg", "alt_m", "heading_deg")
_CODE = (
    *("mutcd", "vienna", "legend", "code_probability"),
    *("nominal_width_in", "nominal_height_in"),
)
_UPPER_TRIANGLE = np.triu_indices(3)


def frame_row(tracked: TrackedFrame) -> dict[str, Any]:
    """All columns of a frame that are known when it is tracked."""
    frame, motion = tracked.frame, tracked.motion
    row = dict.fromkeys(FRAMES.schema.names) | {
        "frame": frame.index,
        "log_time_ns": frame.log_time_ns,
        "header_time_ns": frame.header_time_ns,
        "status": frame.status,
        "image_name": frame.name or None,
        "image_date": frame.date or None,
    }
    if motion is None:
        return row
    row |= {
        "motion_source": motion.source,
        "regions": tracked.region_count,
        "outside_size": tracked.dropped.size,
        "merged": tracked.dropped.merged,
        "left_out": tracked.dropped.left_out,
        "candidates": len(tracked.candidates),
    }
    if motion.step is None:  # of the first used frame
        return row
    return row | {
        "ties": 0 if motion.ties is None else len(motion.ties.inlier),
        "residual_straight_px": finite(motion.residual_straight_px),
        "residual_px": finite(motion.residual_px),
        "adjusted": motion.adjusted,
        "iterations": motion.iterations,
    }


def place_rows(path: DrivePath, frames: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Columns of where the cameras of frames were: centre and quaternion, WGS 84, station and distance."""
    globe = path.globe
    placed = None if globe is None else np.column_stack([globe.route(), globe.heading_deg()])
    for frame in frames:
        row = {"station_m": path.stations.get(frame), "baseline_m": path.baselines.get(frame)}
        if (pose := path.poses.get(frame)) is not None:
            quaternion = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
            row |= zip(_POSE, (*pose.centre.tolist(), *quaternion.tolist()), strict=True)
        if globe is not None and placed is not None and frame in globe.rows:
            row |= zip(_GLOBE, placed[globe.rows[frame]].tolist(), strict=True)
        yield row


def sign_row(sign: Sign, log: str) -> dict[str, Any]:
    """All columns of a sign; log: the stem of the log's name, the first part of the sign's."""
    landmark = sign.landmark
    along, lateral, up = np.sqrt(np.diag(sign.covariance))[[2, 0, 1]].tolist()
    evidence = dict(landmark.evidence)
    return {
        "status": sign.status,
        "confidence": finite(sign.confidence),
        "color": landmark.color,
        "color_distance": finite(landmark.color_distance),
        "shape": landmark.shape,
        "shape_distance": finite(landmark.shape_distance),
        **dict(zip(("x", "y", "z"), sign.centre.tolist(), strict=True)),
        "covariance": sign.world_covariance[_UPPER_TRIANGLE].tolist(),
        "sigma_along_m": along,
        "sigma_lateral_m": lateral,
        "sigma_up_m": up,
        "station_m": sign.station_m,
        "lateral_m": sign.lateral_m,
        "up_m": finite(sign.up_m),
        "bottom_m": finite(sign.bottom_m),
        "panel_width_m": finite(sign.width_m),
        "panel_height_m": finite(sign.height_m),
        "sigma_width_m": finite(sign.sigma_width_m),
        "sigma_height_m": finite(sign.sigma_height_m),
        "facing_deg": finite(landmark.facing_deg),
        "sigma_facing_deg": finite(landmark.sigma_facing_deg),
        "best_frame": landmark.best_frame,
        "best_time_ns": landmark.best_time_ns,
        "best_box": list(landmark.best_box),
        **dict(zip(("right_m", "down_m", "ahead_m"), sign.position.tolist(), strict=True)),
        "first_frame": min(view.frame for view in landmark.views),
        "last_frame": max(view.frame for view in landmark.views),
        "views": len(landmark.views),
        "residual_px": finite(landmark.residual_px),
        **{f"evidence_{term}": evidence.get(term) for term in EVIDENCE_TERMS},
        **_code(sign),
        **_on_globe(sign),
        "route": sign.route,
        "measure": finite(sign.measure),
        "measure_unit": sign.measure_unit,
        "sign_id": sign_id(sign, log),
        "assembly_id": f"{log}-a{sign.assembly:04d}",
        "log": log,
    }


def sign_id(sign: Sign, log: str) -> str:
    """Name of a sign: `drive-0001`."""
    return f"{log}-{sign.number:04d}"


def finite(value: float) -> float | None:
    """The value, None where it is not known."""
    return float(value) if math.isfinite(value) else None


def _code(sign: Sign) -> dict[str, Any]:
    """Columns of what sign it is."""
    code = sign.code
    if code is None:
        return dict.fromkeys(_CODE)
    mutcd, vienna = (code.code if code.system == system else None for system in (US, VIENNA))
    size = code.nominal_in or (None, None)
    return dict(zip(_CODE, (mutcd, vienna, code.legend, code.probability, *size), strict=True))


def _on_globe(sign: Sign) -> dict[str, Any]:
    """Columns on WGS 84; `geometry` is a WKB Point Z."""
    names = ("lon_deg", "lat_deg", "alt_m", "sigma_east_m", "sigma_north_m", "sigma_alt_m")
    globe = sign.globe
    if globe is None:
        return dict.fromkeys((*names, "geometry"))
    place = (globe.longitude_deg, globe.latitude_deg, globe.altitude_m)
    values = dict(zip(names, (*place, *globe.sigma_m), strict=True))
    return values | {"geometry": struct.pack("<BIddd", 1, 1001, *place)}
