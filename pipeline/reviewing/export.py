"""The signs of a result in one flat table for other programs, with what a review says beside what was measured."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.result import read_rows
from wayside.pipeline.reviewing.review import Review
from wayside.pipeline.writing import write_file
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.tables import FRAMES, SIGNS

FORMATS = ("csv", "geojson")
REVIEW_COLUMNS = ("review", "reviewed_color", "reviewed_shape", "reviewer", "review_note")
_PARTS = {
    "covariance": ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"),
    "best_box": ("best_x_min", "best_y_min", "best_x_max", "best_y_max"),
}
"""Columns of lists, one column an element."""


def export(out: Path, review: Review, file: Path, kind: str, *, overwrite: bool = False) -> int:
    """Write the signs of a result to a file; how many rows.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    review
        What is said of its rows; a missing sign is a row of its own.
    file, kind
        Where it goes, and a name of `FORMATS`.
    overwrite
        Replace a file that stands there.

    Raises
    ------
    UsageError
        GeoJSON of a result that has no place on the globe.
    InputError
        The folder is no result folder, or damaged.
    OutputError
        The file cannot be written.
    """
    names = [column.name for column in SIGNS.columns if column.name != "geometry"]
    signs = read_rows(out, SIGNS, names)
    rows = [_flat(sign) | _said(review, sign["sign_id"]) for sign in signs]
    rows += _missing(out, signs, review)
    text = _csv(rows, names) if kind == "csv" else _geojson(out, rows)
    write_file(file, text.encode("utf-8"), overwrite=overwrite)
    return len(rows)


def _flat(sign: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in sign.items():
        if name in _PARTS:
            flat |= dict(zip(_PARTS[name], value or [None] * len(_PARTS[name]), strict=True))
        else:
            flat[name] = value
    return flat


def _said(review: Review, sign_id: str) -> dict[str, Any]:
    one = review.rows.get(sign_id)
    values = (
        (None,) * 5
        if one is None
        else (one.review, one.color, one.shape, one.reviewer or None, one.note or None)
    )
    return dict(zip(REVIEW_COLUMNS, values, strict=True))


def _missing(out: Path, signs: Sequence[dict[str, Any]], review: Review) -> list[dict[str, Any]]:
    """Rows of missing signs: their place as the reviewer gave it, and nothing that was measured."""
    if not review.missing:
        return []
    columns = ["frame", "x", "y", "station_m"]
    path = [row for row in read_rows(out, FRAMES, columns) if row["x"] is not None]
    if not path:
        raise InputError(
            f"{out}: wanted the path of the drive to place missing signs by, found none"
        )
    cameras = np.array([[row["x"], row["y"]] for row in path], np.float64)
    log = signs[0]["log"] if signs else ""
    to_globe = _globe_fit(signs)
    rows = []
    for number, one in enumerate(review.missing, 1):
        place = np.array([one.x, one.y], np.float64)
        nearest = path[int(np.argmin(np.linalg.norm(cameras - place, axis=1)))]
        values: dict[str, Any] = {
            "sign_id": f"{log}-missing-{number}",
            "log": log,
            "x": one.x,
            "y": one.y,
            "station_m": nearest["station_m"],
            "best_frame": nearest["frame"],
        }
        if to_globe is not None:
            lon, lat = np.array([1.0, *place]) @ to_globe
            values |= {"lon_deg": float(lon), "lat_deg": float(lat)}
        said = (one.review, one.color, one.shape, one.reviewer or None, one.note or None)
        rows.append(values | dict(zip(REVIEW_COLUMNS, said, strict=True)))
    return rows


def _globe_fit(signs: Sequence[dict[str, Any]]) -> Any:
    """Matrix (3, 2) from 1, x, y to longitude and latitude by least squares over the signs; None where they tell none.

    Over the length of a drive the globe is plane enough for a place that a person clicked on a map.
    """
    known = [sign for sign in signs if sign["lon_deg"] is not None]
    world = np.array([[1.0, sign["x"], sign["y"]] for sign in known], np.float64).reshape(-1, 3)
    if np.linalg.matrix_rank(world) < 3:
        return None
    globe = np.array([[sign["lon_deg"], sign["lat_deg"]] for sign in known], np.float64)
    return np.linalg.lstsq(world, globe, rcond=None)[0]


def _columns(names: Sequence[str]) -> list[str]:
    flat = [part for name in names for part in _PARTS.get(name, (name,))]
    return [*flat, *REVIEW_COLUMNS]


def _csv(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, _columns(names), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: "" if v is None else v for k, v in row.items()} for row in rows)
    return text.getvalue()


def _geojson(out: Path, rows: Sequence[dict[str, Any]]) -> str:
    """RFC 7946: WGS 84, longitude before latitude; the height is that above the ellipsoid."""
    unplaced = sum(row.get("lon_deg") is None for row in rows)
    if rows and unplaced == len(rows):
        raise UsageError(
            f"{out}: wanted signs on the globe for GeoJSON, found none with longitude and latitude: the log has no "
            "satellite fixes; export CSV, whose x, y and station_m are relative to the drive"
        )
    features = []
    for row in rows:
        place = [row.get(name) for name in ("lon_deg", "lat_deg", "alt_m")]
        known = [value for value in place if value is not None]
        geometry = {"type": "Point", "coordinates": known} if len(known) >= 2 else None
        values = {
            k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()
        }
        features.append({"type": "Feature", "geometry": geometry, "properties": values})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"
