"""Columns in feet and inches, and the short names of formats that have room for ten characters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from wayside.pipeline.exporting.flat_table import FlatTable, Row
from wayside.pipeline.files.lengths import METRES_IN_FOOT
from wayside.schemas.tables import Column

SHORT_NAME = 10
"""Characters of a column's name in a dBASE file, which holds the attributes of a Shapefile."""
_INCHES = ("panel_width_m", "panel_height_m", "sigma_width_m", "sigma_height_m")
"""Sizes of faces are ordered in inches, distances are in feet."""
_SHORT = {
    "assembly_id": "assembly",
    "color_distance": "color_dist",
    "shape_distance": "shape_dist",
    "sigma_along": "s_along",
    "sigma_lateral": "s_later",
    "sigma_up": "s_up",
    "panel_width": "width",
    "panel_height": "height",
    "sigma_width": "s_width",
    "sigma_height": "s_high",
    "sigma_facing": "s_face",
    "sigma_east": "s_east",
    "sigma_north": "s_north",
    "sigma_alt": "s_alt",
    "best_time": "best",
    "best_x_min": "best_x0",
    "best_y_min": "best_y0",
    "best_x_max": "best_x1",
    "best_y_max": "best_y1",
    "first_frame": "first_fr",
    "last_frame": "last_fr",
    "residual": "resid",
    "measure_unit": "meas_unit",
    "code_probability": "code_prob",
    "nominal_width": "nom_w",
    "nominal_height": "nom_h",
    "evidence_appearance": "ev_appear",
    "evidence_views": "ev_views",
    "evidence_size": "ev_size",
    "evidence_place": "ev_place",
    "evidence_rigidity": "ev_rigid",
    "evidence_surroundings": "ev_surroun",
    "reviewed_color": "rev_color",
    "reviewed_shape": "rev_shape",
    "review_note": "rev_note",
    "replaced_by": "replacedby",
    "bearing": "bear",
    "best_sign_id": "best_sign",
}
"""Short names of columns with long ones, both without the unit."""


def in_feet_and_inches(table: FlatTable) -> FlatTable:
    """Lengths in international feet (0.3048 m exactly), sizes of faces in inches; names and units say so.

    Degrees, pixels and the measure along a route stay as they are.
    """
    converted = {column.name: _imperial(column) for column in table.columns}

    def convert(row: Row) -> Row:
        changed = dict(row)
        for name, (column, factor) in converted.items():
            if factor is not None and name in row:
                value = changed.pop(name)
                changed[column.name] = None if value is None else value * factor
        return changed

    columns = tuple(column for column, _ in converted.values())
    return FlatTable(columns, tuple(map(convert, table.rows)))


def _imperial(column: Column) -> tuple[Column, float | None]:
    """A column as it is called in feet or inches, and its factor; None where it is no length."""
    power = {"m": 1, "m^2": 2}.get(column.unit)
    if power is None:
        return column, None
    unit = "in" if column.name in _INCHES else "ft"
    factor = (12 if unit == "in" else 1) / METRES_IN_FOOT
    unit += "^2" if power == 2 else ""
    name = f"{_stem(column)}_{_suffix(unit)}"
    return replace(column, name=name, unit=unit), factor**power


def short_names(columns: Iterable[Column]) -> dict[str, str]:
    """A name of at most `SHORT_NAME` characters for each column by its name, each another one, units kept.

    A column that the table has no name for keeps its own where that is short enough, else it is cut, with a number
    where the rest is taken.
    """
    names: dict[str, str] = {}
    for column in columns:
        stem = _stem(column)
        unit = column.name.removeprefix(stem)
        stem = _SHORT.get(stem, stem)[: SHORT_NAME - len(unit)]
        number, short = 1, stem + unit
        while short in names.values():
            number += 1
            short = f"{stem[: SHORT_NAME - len(unit) - len(str(number))]}{number}{unit}"
        names[column.name] = short
    return names


def _stem(column: Column) -> str:
    """Name of a column without its unit."""
    return column.name.removesuffix(f"_{_suffix(column.unit)}") if column.unit else column.name


def _suffix(unit: str) -> str:
    return unit.replace("^", "")
