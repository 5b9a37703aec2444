"""Rows of the tables `signs` and `frames`: what is known of a sign or a frame, in the names of the columns."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import EVIDENCE_TERMS, TrackedFrame
from wayside.schemas.motion import Motion
from wayside.schemas.sign_catalogue import US, VIENNA
from wayside.schemas.signs import Sign
from wayside.stages.georeference import Globe

FRAME_COLUMNS = (
    *(
        "frame",
        "log_time_ns",
        "header_time_ns",
        "status",
        "image_name",
        "image_date",
        "motion_source",
    ),
    *("ties", "residual_straight_px", "residual_px", "adjusted", "iterations"),
    *("regions", "outside_size", "merged", "left_out", "candidates"),
)
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
GLOBE_COLUMNS = ("lon_deg", "lat_deg", "alt_m", "heading_deg")
_UPPER_TRIANGLE = np.triu_indices(3)


def frame_row(tracked: TrackedFrame) -> tuple[Any, ...]:
    """`FRAME_COLUMNS` of a frame."""
    frame, motion = tracked.frame, tracked.motion
    times = (frame.log_time_ns, frame.header_time_ns)
    head = (frame.index, *times, frame.status, frame.name or None, frame.date or None)
    if motion is None:
        return (*head, *(None,) * (len(FRAME_COLUMNS) - len(head)))
    counts = (tracked.region_count, *tracked.dropped, len(tracked.candidates))
    return (*head, motion.source, *_step(motion), *counts)


def pose_row(pose: Pose | None) -> tuple[float | None, ...]:
    """`POSE_COLUMNS` of a camera: centre, and quaternion x, y, z, w."""
    if pose is None:
        return (None,) * len(POSE_COLUMNS)
    quaternion = Rotation.from_matrix(pose.rotation).as_quat(canonical=True)
    return (*pose.centre.tolist(), *quaternion.tolist())


def globe_rows(globe: Globe | None, frames: Sequence[int]) -> list[tuple[float | None, ...]]:
    """`GLOBE_COLUMNS` of the cameras of frames."""
    unknown = (None,) * len(GLOBE_COLUMNS)
    if globe is None:
        return [unknown] * len(frames)
    placed = np.column_stack([globe.route(), globe.heading_deg()]).tolist()
    return [tuple(placed[globe.rows[f]]) if f in globe.rows else unknown for f in frames]


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
    nominal = None if code is None else code.nominal_in
    return {
        "mutcd": code.code if code is not None and code.system == US else None,
        "vienna": code.code if code is not None and code.system == VIENNA else None,
        "legend": None if code is None else code.legend,
        "code_probability": None if code is None else code.probability,
        "nominal_width_in": None if nominal is None else nominal[0],
        "nominal_height_in": None if nominal is None else nominal[1],
    }


def _on_globe(sign: Sign) -> dict[str, Any]:
    """Columns on WGS 84; `geometry` is a WKB Point Z."""
    names = ("lon_deg", "lat_deg", "alt_m", "sigma_east_m", "sigma_north_m", "sigma_alt_m")
    globe = sign.globe
    if globe is None:
        return dict.fromkeys((*names, "geometry"))
    place = (globe.longitude_deg, globe.latitude_deg, globe.altitude_m)
    values = dict(zip(names, (*place, *globe.sigma_m), strict=True))
    return values | {"geometry": struct.pack("<BIddd", 1, 1001, *place)}


def _step(motion: Motion) -> tuple[Any, ...]:
    """Columns of the step to a frame; unknown at the first used one."""
    if motion.step is None:
        return (None,) * 5
    ties = 0 if motion.ties is None else len(motion.ties.inlier)
    residuals = (finite(motion.residual_straight_px), finite(motion.residual_px))
    return (ties, *residuals, motion.adjusted, motion.iterations)
