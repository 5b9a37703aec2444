"""The table as CSV and as GeoJSON."""

from __future__ import annotations

import csv
import io
import json
import math
from typing import Any

from wayside.pipeline.csv_text import guarded
from wayside.pipeline.exporting.flat_table import FlatTable
from wayside.pipeline.exporting.place import Placement


def format_csv(table: FlatTable) -> str:
    """Names of the columns in the first line; empty where a value is unknown; no text is a formula."""
    text = io.StringIO()
    names = [column.name for column in table.columns]
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: _cell(v) for k, v in row.items()} for row in table.rows)
    return text.getvalue()


def format_geojson(table: FlatTable, placement: Placement) -> str:
    """RFC 7946: WGS 84, longitude before latitude; the height is that above the ellipsoid."""
    names = [column.name for column in table.columns]
    features = []
    for row, point in zip(table.rows, placement.points, strict=True):
        geometry = None if point is None else {"type": "Point", "coordinates": point}
        values = {name: _finite(row.get(name)) for name in names}
        features.append({"type": "Feature", "geometry": geometry, "properties": values})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def _cell(value: Any) -> Any:
    return "" if value is None else guarded(value) if isinstance(value, str) else value


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
