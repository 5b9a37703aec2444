"""What the truth of a rendered drive says of a view of a face."""

from __future__ import annotations

from typing import Any


def visible_fraction(view: dict[str, Any]) -> float:
    """Fraction of a face that is visible in a view of the truth."""
    return float(view["visible_fraction"] or 0.0)


def height_px(view: dict[str, Any]) -> float:
    """Height of a face in a view of the truth, pixels."""
    return float(view["box"][3] - view["box"][1])
