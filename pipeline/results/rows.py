"""The rows of the tables of a result, by column names: what was measured, null where it is not known."""

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from wayside.schemas.landmarks import EVIDENCE_TERMS, TrackedFrame
from wayside.schemas.roadside import SIDES, CrossSection, Posts
from wayside.schemas.sign_catalogue import US, VIENNA
from wayside.schemas.signs import Sign
from wayside.schemas.tables import FRAMES, POSTS, PROFILE, SECTIONS, Table
from wayside.stages.georeference import DrivePath

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_GLOBE = ("lon_deg", "lat_deg", "alt_m", "heading_deg")
_CODE = (
    *("mutcd", "vienna", "legend", "code_probability"),
    *("nominal_width_in", "nominal_height_in"),
)
_OF_SIGN = "status category route measure_unit station_m lateral_m".split()
"""Columns that are attributes of a sign, as `_OF_LANDMARK` of its landmark; of `_NUMBERS_...` nan is null."""
_NUMBERS_OF_SIGN = (
    "confidence up_m bottom_m sigma_bottom_m sigma_width_m sigma_height_m measure spacing_m sigma_spacing_m radius_m "
    "sigma_radius_m"
).split()
_OF_LANDMARK = "color shape best_frame best_time_ns".split()
_NUMBERS_OF_LANDMARK = (
    "color_distance shape_distance facing_deg sigma_facing_deg residual_px".split()
)
_UPPER_TRIANGLE = np.triu_indices(3)
_FIRST_DATE_NS = 10 * 365 * 86_400 * 10**9
"""No camera is older than ten years after 1970: such a clock counts from 0."""


def frame_row(tracked: TrackedFrame) -> dict[str, Any]:
    """All columns of a frame that are known when it is tracked."""
    frame, motion = tracked.frame, tracked.motion
    row = dict.fromkeys(FRAMES.schema.names) | {
        "frame": frame.index,
        "log_time_ns": frame.log_time_ns,
        "header_time_ns": frame.header_time_ns,
        "date": date_us(frame.time_ns),
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
        **{name: getattr(sign, name) for name in _OF_SIGN},
        **{name: finite(getattr(sign, name)) for name in _NUMBERS_OF_SIGN},
        **{name: getattr(landmark, name) for name in _OF_LANDMARK},
        **{name: finite(getattr(landmark, name)) for name in _NUMBERS_OF_LANDMARK},
        **dict(zip(("x", "y", "z"), sign.centre.tolist(), strict=True)),
        "covariance": sign.world_covariance[_UPPER_TRIANGLE].tolist(),
        "sigma_along_m": along,
        "sigma_lateral_m": lateral,
        "sigma_up_m": up,
        "panel_width_m": finite(sign.width_m),
        "panel_height_m": finite(sign.height_m),
        "date": date_us(landmark.best_time_ns),
        "best_box": list(landmark.best_box),
        **dict(zip(("right_m", "down_m", "ahead_m"), sign.position.tolist(), strict=True)),
        "first_frame": min(view.frame for view in landmark.views),
        "last_frame": max(view.frame for view in landmark.views),
        "views": len(landmark.views),
        **{f"evidence_{term}": evidence.get(term) for term in EVIDENCE_TERMS},
        **_code(sign),
        **_on_globe(sign),
        "next_sign_id": None if sign.next_number is None else f"{log}-{sign.next_number:04d}",
        "sign_id": sign_id(sign, log),
        "assembly_id": f"{log}-a{sign.assembly:04d}",
        "log": log,
    }


def sign_id(sign: Sign, log: str) -> str:
    """Name of a sign: `drive-0001`."""
    return f"{log}-{sign.number:04d}"


def date_us(time_ns: int) -> int | None:
    """Microseconds since 1970; None of a clock that counts from 0."""
    return None if time_ns < _FIRST_DATE_NS else time_ns // 1000


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
    """Columns on WGS 84."""
    sigmas, globe = ("sigma_east_m", "sigma_north_m", "sigma_alt_m"), sign.globe
    if globe is None:
        return dict.fromkeys((*located(0, 0, 0), *sigmas, "bearing_deg"))
    place = located(globe.longitude_deg, globe.latitude_deg, globe.altitude_m)
    errors = dict(zip(sigmas, globe.sigma_m, strict=True))
    return place | errors | {"bearing_deg": finite(globe.bearing_deg)}


def located(lon_deg: float, lat_deg: float, alt_m: float) -> dict[str, Any]:
    """Columns of a place on WGS 84; `geometry` is a WKB Point Z."""
    geometry = struct.pack("<BI3d", 1, 1001, lon_deg, lat_deg, alt_m)
    return {"lon_deg": lon_deg, "lat_deg": lat_deg, "alt_m": alt_m, "geometry": geometry}


def roadside_rows(
    sections: Sequence[CrossSection], path: DrivePath
) -> dict[Table, list[dict[str, Any]]]:
    """The rows of `profile.parquet` and `sections.parquet`."""
    rows: dict[Table, list[dict[str, Any]]] = {PROFILE: [], SECTIONS: []}
    for one in sections:
        at: dict[str, Any] = {"station_m": one.station_m}
        globe = np.full((len(one.points), 3), np.nan)
        if path.globe is not None:
            local = path.poses[one.frame].to_camera(one.points)
            globe = path.globe.origin.geodetic(path.globe.pose(one.frame).to_world(local))
        columns = (one.height_m, one.sigma_m, *one.points.T, *globe.T)
        names = ("height_m", "sigma_m", "x", "y", "z", "lon_deg", "lat_deg", "alt_m")
        for offset, count, status, *values in zip(
            one.offset_m.tolist(), one.pairs.tolist(), one.status, *columns, strict=True
        ):
            measured = dict(zip(names, map(finite, values), strict=True))
            strip = {"offset_m": offset, "count": count, "status": status, "frame": one.frame}
            rows[PROFILE].append(at | strip | measured)
        width = finite(one.lane_width_m)
        for side, found in zip(SIDES, one.sides, strict=True):
            known = {name: finite(value) for name, value in asdict(found).items()}
            rows[SECTIONS].append(at | known | {"side": side, "lane_width_m": width})
    return rows


def posts_rows(signs: Sequence[Sign], log: str) -> list[dict[str, Any]]:
    """The rows of `posts.parquet`, by support: what its lowest sign stands on."""
    lowest: dict[int, Sign] = {}
    for sign in sorted(signs, key=lambda sign: (sign.assembly, sign.up_m - sign.height_m / 2)):
        lowest.setdefault(sign.assembly, sign)
    rows = []
    for sign in lowest.values():
        row, found = sign_row(sign, log), sign.landmark.posts or Posts()
        scale = sign.width_m / sign.landmark.width_m
        rows.append(
            {name: row.get(name) for name in POSTS.schema.names}
            | {
                "number": found.number or None,
                "width_m": finite(scale * found.width_m),
                "sigma_width_m": finite(scale * found.sigma_width_m),
                "kind": found.kind,
                "kind_probability": finite(found.probability),
                "views": found.views,
                "frame": sign.landmark.best_frame,
            }
        )
    return rows
