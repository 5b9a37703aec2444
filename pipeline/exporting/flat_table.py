"""Rows of a table as single values; those of a drive's signs with what a review says beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline.results.result import read_rows, read_run
from wayside.pipeline.reviewing.review import REVIEWS, Review, Reviewed
from wayside.schemas.errors import InputError
from wayside.schemas.tables import FRAMES, SIGNS, Column, Table

GEOMETRY = "geometry"
Row = dict[str, Any]
"""Values by column name; one that is absent or None is unknown. What is to be written has a `Point` as geometry."""

Point = tuple[float, ...]
"""A place: x, y, or x, y and height."""

_BOX = ("best_x_min", "best_y_min", "best_x_max", "best_y_max")
_WORLD = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_EAST_NORTH_UP = ("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu")
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
    """All columns of `signs.parquet` but the geometry, one for each item of a list, then the columns of the review.

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
    listed = kept_columns(SIGNS)
    signs = read_rows(out, SIGNS, [column.name for column in listed])
    rows = [flat_row(SIGNS, sign) | _said(review.rows.get(sign["sign_id"])) for sign in signs]
    rows += _missing(out, signs, review)
    return FlatTable((*flat_columns(SIGNS), *_REVIEW_COLUMNS), tuple(rows))


def kept_columns(table: Table) -> list[Column]:
    """The columns of a table that its flat one is made of: all but the geometry."""
    return [column for column in table.columns if column.name != GEOMETRY]


def flat_columns(table: Table) -> tuple[Column, ...]:
    """Columns of single values: one for each element of a list of numbers; choices and lists of names are text."""
    flat: list[Column] = []
    for column in kept_columns(table):
        if parts := _parts(table, column.name):
            kind = column.type.value_type  # type: ignore[attr-defined]  # of a list, which the stubs do not say
            words = f"of `{column.name}`: {column.words}"
            flat += [Column(part, kind, column.unit, words) for part in parts]
        else:
            text = column.values or pa.types.is_list(column.type)
            flat.append(
                Column(column.name, pa.string() if text else column.type, column.unit, column.words)
            )
    return tuple(flat)


def flat_row(table: Table, row: Row) -> Row:
    """A row in the columns of `flat_columns`; names of a list stand behind each other, with commas."""
    flat: Row = {}
    for name, value in row.items():
        if parts := _parts(table, name):
            flat |= dict(zip(parts, value or [None] * len(parts), strict=True))
        else:
            flat[name] = ", ".join(value) if isinstance(value, list) else value
    return flat


def _parts(table: Table, name: str) -> tuple[str, ...]:
    """The columns that a column of lists becomes, one an element."""
    covariance = _WORLD if table is SIGNS else _EAST_NORTH_UP
    return {"covariance": covariance, "best_box": _BOX}.get(name, ())


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
        raise InputError(f"{out}: the result has no path of the drive to place missing signs by")
    cameras = np.array([[row["x"], row["y"]] for row in path], np.float64)
    log = signs[0]["log"] if signs else Path(str(read_run(out).get("log", ""))).stem
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
