"""Entries of COCO JSON, for boxes of a detector and for labels alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from wayside.schemas.labels import Box

Entry = Mapping[str, Any]


def coco_box(entry: Entry) -> Box:
    """Corners of the box of an annotation or a result, pixels. Raises ValueError without a box."""
    values = entry.get("bbox")
    try:
        x, y, width, height = (float(value) for value in values or ())
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"bbox is {str(values)[:40]}, not x, y, width, height") from error
    return x, y, x + width, y + height


def coco_classes(content: Entry) -> dict[Any, str]:
    """Names of the classes of a data set by their ids."""
    return {one["id"]: str(one["name"]) for one in content.get("categories", ())}
