"""The plot of the page on the report's generations: precision against recall, drawn like the evidence sheets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from seeing_plot import LEFT, SMALL, TALL, TITLE, TOP

from wayside.pipeline.evidence.canvas import FAINT, MEDIUM, RULE, TEXT, Canvas, text_width
from wayside.pipeline.evidence.marks import Ink

WIDE, APART, HEIGHT = 440, 110, 616
TICKS = (0.0, 0.25, 0.5, 0.75, 1.0)
INKS: dict[str, Ink] = {
    "location": (30, 110, 200),
    "trajectory, image": (200, 120, 0),
    "trajectory, compensated": (120, 130, 142),
    "location and trajectory, compensated": (0, 140, 90),
}
"""Curves of the gates."""
POINTS: dict[str, Ink] = {
    "report-shape": (150, 60, 200),
    "report-2d": (230, 90, 60),
    "report": (214, 0, 128),
    "default": (20, 20, 30),
}
"""Presets, of one point each."""


def draw(
    panels: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]],
) -> NDArray[np.uint8]:
    """RGB image: for each set of drives the (recall, precision) of gates at their rates, and of presets."""
    page = Canvas(LEFT + len(panels) * (WIDE + APART), HEIGHT)
    for k, (title, lines) in enumerate(panels.items()):
        left = LEFT + k * (WIDE + APART)
        _axes(page, left, f"Precision against recall, {title} drives")
        for name, points in lines.items():
            if not points:
                continue
            at = np.array([(left + WIDE * x, TOP + TALL * (1 - y)) for x, y in points])
            ink = INKS.get(name) or POINTS[name]
            page.line(at, ink, 2)
            for point in at:
                page.dot(point, 4 if name in INKS else 6, ink)
    for row, (name, ink) in enumerate((INKS | POINTS).items()):
        x, y = LEFT + (row % 2) * (WIDE + APART), HEIGHT - 122 + 28 * (row // 2)
        if name in INKS:
            page.line([(x, y - 5), (x + 28, y - 5)], ink, 2)
        else:
            page.dot((x + 14, y - 5), 6, ink)
        page.text((x + 38, y), name, SMALL, TEXT)
    return page.rgb


def _axes(page: Canvas, left: int, title: str) -> None:
    page.text((left, TOP - 24), title, TITLE, TEXT, MEDIUM)
    for tick in TICKS:
        y, words = TOP + TALL * (1 - tick), f"{100 * tick:.0f} %"
        page.line([(left, y), (left + WIDE, y)], RULE, 1)
        page.text((left - 10, y + 5), words, SMALL, FAINT, right=True)
        x = left + WIDE * tick - text_width(words, SMALL) / 2
        page.text((x, TOP + TALL + 24), words, SMALL, FAINT)
    middle = left + (WIDE - text_width("recall", SMALL)) / 2
    page.text((middle, TOP + TALL + 48), "recall", SMALL, FAINT)
