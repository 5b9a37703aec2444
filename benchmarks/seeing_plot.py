"""The plot of the page on seeing: two curves side by side, drawn like the evidence sheets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from reached import CANDIDATE, PASSED, SIGN

from wayside.pipeline.evidence.canvas import FAINT, MEDIUM, RULE, TEXT, Canvas, text_width
from wayside.pipeline.evidence.marks import Ink

WIDTH, HEIGHT = 1240, 470
LEFT, TOP, TALL = 70, 60, 320
WIDE, SECOND, SQUARE = 620, 850, 340
SMALL, TITLE = 15, 19
LINES: tuple[tuple[int, str, Ink], ...] = (
    (CANDIDATE, "has a candidate", (120, 130, 142)),
    (PASSED, "past the classifier of one view", (30, 110, 200)),
    (SIGN, "view of a reported sign", (214, 0, 128)),
)


def draw(
    names: Sequence[str],
    levels: Sequence[Sequence[int]],
    sure: Sequence[tuple[float, int, int]],
) -> NDArray[np.uint8]:
    """RGB image: fraction of faces that went so far against height; fraction of true rows against confidence.

    names, levels: a bin of heights each, how far its faces went; sure: mean confidence, true rows, rows of each bin.
    """
    page = Canvas(WIDTH, HEIGHT)
    _axes(page, LEFT, WIDE, "Fraction of faces, by height in the image")
    places = LEFT + WIDE * (np.arange(len(names)) + 0.5) / len(names)
    for x, name, own in zip(places, names, levels, strict=True):
        words = name.removesuffix(" and more").removesuffix(" px")
        words = f"{words}+" if name.endswith("more") else words
        _centred(page, x, TOP + TALL + 24, words, TEXT)
        _centred(page, x, TOP + TALL + 44, f"n {len(own)}", FAINT)
    _centred(page, LEFT + WIDE / 2, TOP + TALL + 70, "height of the face, px", FAINT)
    for row, (stage, words, ink) in enumerate(LINES):
        points = np.array(
            [
                (x, _level(sum(level >= stage for level in own) / len(own)))
                for x, own in zip(places, levels, strict=True)
                if own
            ]
        )
        page.line(points, ink, 3)
        for point in points:
            page.dot(point, 5, ink)
        at = (LEFT + WIDE - 250, TOP + TALL - 80 + 26 * row)
        page.line([at, (at[0] + 28, at[1])], ink, 3)
        page.text((at[0] + 38, at[1] + 5), words, SMALL, TEXT)
    _reliability(page, sure)
    return page.rgb


def _reliability(page: Canvas, sure: Sequence[tuple[float, int, int]]) -> None:
    """Points with the interval that holds the true fraction in two of three cases (Wilson 1927), size by rows."""
    _axes(page, SECOND, SQUARE, "Fraction of true rows, by confidence")
    page.line([(SECOND, TOP + TALL), (SECOND + SQUARE, TOP)], RULE, 2)
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        _centred(page, SECOND + SQUARE * tick, TOP + TALL + 24, f"{tick:g}", TEXT)
    _centred(page, SECOND + SQUARE / 2, TOP + TALL + 70, "confidence", FAINT)
    for mean, right, rows in sure:
        x = SECOND + SQUARE * mean
        low, high = wilson(right, rows)
        page.line([(x, _level(low)), (x, _level(high))], FAINT, 2)
        page.dot((x, _level(right / rows)), 3 + min(6.0, rows**0.5 / 2), LINES[-1][2])


def wilson(right: int, rows: int) -> tuple[float, float]:
    """Interval of one standard deviation about a fraction (Wilson 1927, eq. for the score interval)."""
    fraction, slack = right / rows, 1.0 / rows
    middle = (fraction + slack / 2) / (1 + slack)
    half = np.sqrt(fraction * (1 - fraction) / rows + slack / (4 * rows)) / (1 + slack)
    return float(middle - half), float(middle + half)


def _axes(page: Canvas, left: int, width: int, title: str) -> None:
    page.text((left, TOP - 24), title, TITLE, TEXT, MEDIUM)
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        page.line([(left, _level(tick)), (left + width, _level(tick))], RULE, 1)
        page.text((left - 10, _level(tick) + 5), f"{100 * tick:.0f} %", SMALL, FAINT, right=True)


def _level(fraction: float) -> float:
    return TOP + TALL * (1 - fraction)


def _centred(page: Canvas, x: float, y: float, words: str, ink: Ink) -> None:
    page.text((x - text_width(words, SMALL) / 2, y), words, SMALL, ink)
