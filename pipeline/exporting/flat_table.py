"""The signs of a result as rows of single values, with what a review says beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline.result import read_rows
from wayside.pipeline.reviewing.review import REVIEWS, Review, Reviewed
from wayside.schemas.errors import InputError
from wayside.schemas.tables import FRAMES, SIGNS, Column

Row = dict[str, Any]
"""Values by column name; one that is absent or None is unknown."""

_PARTS = {
    "covariance": ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"),
    "best_box": ("best_x_min", "best_y_min", "best_x_max", "best_y_max"),
}
"""Columns of lists, one column an element."""
_REVIEW_COLUMNS = (
    Column("review", pa.string(), "", f"what a reviewer said: {', '.join(REVIEWS)}"),
    Column("reviewed_color", pa.string(), "", "colour by the review"),
    Column("reviewed_shape", pa.string(), "", "shape by the review"),
    Column("reviewer", pa.string(), "", "who reviewed it"),
    Column("review_note", pa.string(), "", "the reviewer's remark"),
)


@dataclass(frozen=True, slots=True)
class FlatTable:
    """Columns of single values with unit and words, and their rows; those of missing signs stand last."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]


def flat_table(out: Path, review: Review) -> FlatTable:
    """All columns of `signs.parquet` but the geometry, those of lists one by one, and then those of the review.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    review
        What is said of its rows; a missing sign is a row of its own.

    Raises
    ------
    InputError
        The folder is no result folder, or damaged.
    """
    listed = [column for column in SIGNS.columns if column.name != "geometry"]
    signs = read_rows(out, SIGNS, [column.name for column in listed])
    rows = [_flat(sign) | _said(review.rows.get(sign["sign_id"])) for sign in signs]
    rows += _missing(out, signs, review)
    columns = [part for column in listed for part in _parts(column)]
    return FlatTable((*columns, *_REVIEW_COLUMNS), tuple(rows))


def _parts(column: Column) -> Sequence[Column]:
    """A column, or one for each element of its lists; choices are text."""
    if column.name in _PARTS:
        kind = column.type.value_type  # type: ignore[attr-defined]  # of a list, which the stubs do not say
        return [
            Column(part, kind, column.unit, f"of `{column.name}`: {column.words}")
            for part in _PARTS[column.name]
        ]
    kind = pa.string() if column.values else column.type
    return [Column(column.name, kind, column.unit, column.words)]


def _flat(sign: Row) -> Row:
    flat: Row = {}
    for name, value in sign.items():
        if name in _PARTS:
            flat |= dict(zip(_PARTS[name], value or [None] * len(_PARTS[name]), strict=True))
        else:
            flat[name] = value
    return flat


def _said(one: Reviewed | None) -> Row:
    if one is None:
        return {}
    values = (one.review, one.color, one.shape, one.reviewer or None, one.note or None)
    return {column.name: value for column, value in zip(_REVIEW_COLUMNS, values, strict=True)}


def _missing(out: Path, signs: Sequence[Row], review: Review) -> list[Row]:
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
        values: Row = {
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
        rows.append(values | _said(one))
    return rows


def _globe_fit(signs: Sequence[Row]) -> NDArray[np.float64] | None:
    """Matrix (3, 2) from 1, x, y to longitude and latitude by least squares over the signs; None where they tell none.

    Over the length of a drive the globe is plane enough for a place that a person clicked on a map.
    """
    known = [sign for sign in signs if sign["lon_deg"] is not None]
    world = np.array([[1.0, sign["x"], sign["y"]] for sign in known], np.float64).reshape(-1, 3)
    if np.linalg.matrix_rank(world) < 3:
        return None
    globe = np.array([[sign["lon_deg"], sign["lat_deg"]] for sign in known], np.float64)
    return np.asarray(np.linalg.lstsq(world, globe, rcond=None)[0])
