"""The evidence sheet of one sign as an image: crops, maps and figures on one page."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.canvas import (
    ACCENT,
    BOLD,
    FAINT,
    MEDIUM,
    PANEL,
    PAPER,
    RULE,
    TEXT,
    Canvas,
    shortened,
)
from wayside.pipeline.evidence.crops import Crop
from wayside.pipeline.evidence.figures import evidence_terms, figures_of
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView
from wayside.pipeline.evidence.maps import draw_drive_map, draw_ellipse_map, draw_sight_map
from wayside.pipeline.evidence.marks import appearance_of, ink_of, outline_of
from wayside.schemas.landmarks import EVIDENCE_TERMS

WIDTH, MARGIN, GAP = 1600, 48, 26
BIG = 752, 564
_TILES = 5
TILE = (WIDTH - 2 * MARGIN - (_TILES - 1) * GAP) // _TILES, 210
PROPORTION = TILE[0] / TILE[1]
"""Width over height of every crop, large or small."""
_MAP = (WIDTH - 2 * MARGIN - 2 * GAP) // 3, 340
_CAPTION, _RESIDUAL, _HALO = 36, 86, 3
_TOP = 150
_BARS = _TOP + BIG[1] + _CAPTION + 44
_BAR_ROW, _BAR_UNIT, _BAR_END = 26, 42.0, 6.0
"""Bars of the evidence: height of a row and length of a log-likelihood ratio of 1, pixels; the largest drawn whole."""
_MIDDLE = _BARS + (1 + len(EVIDENCE_TERMS)) * _BAR_ROW + 70
_BOTTOM = _MIDDLE + _MAP[1] + 60
_H1, _H2, _BODY, _SMALL = 42, 22, 19, 17
_FIGURES = MARGIN + BIG[0] + 2 * GAP
_VALUE_END, _REMARK_END = _FIGURES + 490, WIDTH - MARGIN
_ROW, _GROUP_GAP = 29.5, 17
_LONGEST_VALUE = 360


def draw_sheet(
    evidence: Evidence, crops: Mapping[SignView, Crop], drive: DriveMap, log: str, world: str
) -> NDArray[np.uint8]:
    """Draw the sheet of a sign.

    Parameters
    ----------
    evidence, drive
        What the tables say.
    crops
        Cut-outs of `PROPORTION` by view; a view without one is left empty and labelled so.
    log, world
        Name of the log and of its world frame.

    Returns
    -------
    RGB page (height, `WIDTH`, 3) uint8.
    """
    rows = math.ceil(len(evidence.views) / _TILES)
    page = Canvas(WIDTH, _BOTTOM + rows * (TILE[1] + _CAPTION + 12) + MARGIN - 24)
    _draw_header(page, evidence, log)
    _draw_view(page, (MARGIN, _TOP), BIG, evidence.best, crops)
    _draw_figures(page, evidence, world)
    _draw_evidence(page, evidence)
    _draw_maps(page, evidence, drive)
    _draw_views(page, evidence, crops)
    return page.rgb


def _draw_header(page: Canvas, evidence: Evidence, log: str) -> None:
    sign, radius = evidence.sign, 34
    middle = np.array([MARGIN + radius, 80.0])
    glyph = middle + radius * np.array(outline_of(sign["shape"]))
    page.polygon(glyph, ink_of(sign["color"]), TEXT, 3)
    left, right = MARGIN + 2 * radius + GAP, WIDTH - MARGIN
    page.text((left, 80), shortened(evidence.name, _H1, BOLD, right - left - 380), _H1, TEXT, BOLD)
    page.text(
        (left, 113),
        f"{appearance_of(sign['color'], sign['shape'])}, status {sign['status']}",
        _H2,
        FAINT,
    )
    confidence = "unknown" if sign["confidence"] is None else f"{sign['confidence']:.2f}"
    page.text((right, 80), confidence, _H1, TEXT, BOLD, right=True)
    page.text((right, 113), "confidence", _H2, FAINT, right=True)
    page.block((MARGIN, 132), (WIDTH - 2 * MARGIN, 2), RULE)
    middle_words = shortened(log, _H2, MEDIUM, 320)
    page.text((right - 180, 80), middle_words, _H2, TEXT, MEDIUM, right=True)
    page.text((right - 180, 113), "log", _H2, FAINT, right=True)


def _draw_figures(page: Canvas, evidence: Evidence, world: str) -> None:
    baseline = float(_TOP + 18)
    for heading, figures in figures_of(evidence.sign, world).items():
        page.text((_FIGURES, baseline), heading, _BODY, TEXT, BOLD)
        page.block((_FIGURES, round(baseline) + 9), (_REMARK_END - _FIGURES, 1), RULE)
        baseline += _ROW + 4
        for figure in figures:
            page.text((_FIGURES, baseline), figure.label, _BODY, FAINT)
            value = shortened(figure.value, _BODY, MEDIUM, _LONGEST_VALUE)
            page.text((_VALUE_END, baseline), value, _BODY, TEXT, MEDIUM, right=True)
            page.text((_REMARK_END, baseline), figure.remark, _BODY, FAINT, right=True)
            baseline += _ROW
        baseline += _GROUP_GAP


def _draw_evidence(page: Canvas, evidence: Evidence) -> None:
    """A bar for each log-likelihood ratio: to the right for a sign, to the left against."""
    terms = evidence_terms(evidence.sign)
    page.text((MARGIN, _BARS), "Evidence for a sign, log-likelihood ratios", _BODY, TEXT, BOLD)
    page.block((MARGIN, _BARS + 9), (BIG[0], 1), RULE)
    if not terms:
        page.text((MARGIN, _BARS + 9 + _BAR_ROW), "not weighed", _BODY, FAINT)
    axis = MARGIN + BIG[0] - round((_BAR_END + 1) * _BAR_UNIT)
    for number, (term, ratio) in enumerate(terms, 1):
        baseline = _BARS + 9 + number * _BAR_ROW
        page.text((MARGIN, baseline), term.capitalize(), _BODY, FAINT)
        length = round(min(abs(ratio), _BAR_END) * _BAR_UNIT)
        left = axis if ratio >= 0 else axis - length
        page.block((left, baseline - 14), (max(length, 1), 16), TEXT if ratio >= 0 else ACCENT)
        page.text((MARGIN + BIG[0], baseline), f"{ratio:+.1f}", _BODY, TEXT, MEDIUM, right=True)
    if terms:
        page.block((axis, _BARS + 18), (1, len(terms) * _BAR_ROW), FAINT)


def map_images(evidence: Evidence, drive: DriveMap) -> list[tuple[str, NDArray[np.uint8]]]:
    """The maps of a sign with their headings, RGB (height, width, 3) each."""
    maps = (
        ("Whole drive", draw_drive_map),
        ("Lines of sight", draw_sight_map),
        ("2-sigma error ellipse and panel", draw_ellipse_map),
    )
    drawn = []
    for heading, draw in maps:
        part = Canvas(*_MAP, PANEL)
        draw(part, evidence, drive)
        drawn.append((heading, part.rgb))
    return drawn


def _draw_maps(page: Canvas, evidence: Evidence, drive: DriveMap) -> None:
    for number, (heading, image) in enumerate(map_images(evidence, drive)):
        corner = MARGIN + number * (_MAP[0] + GAP), _MIDDLE
        page.text((corner[0], _MIDDLE - 12), heading, _BODY, TEXT, BOLD)
        page.paste(corner, image)
        page.frame(corner, _MAP)


def _draw_views(page: Canvas, evidence: Evidence, crops: Mapping[SignView, Crop]) -> None:
    count = len(evidence.views)
    heading = f"All {count} views" if count > 1 else "The only view"
    page.text((MARGIN, _BOTTOM - 14), heading, _BODY, TEXT, BOLD)
    legend = "frame; distance from the camera; residual of the panel projected back"
    page.text((WIDTH - MARGIN, _BOTTOM - 14), legend, _SMALL, FAINT, right=True)
    for number, view in enumerate(evidence.views):
        row, column = divmod(number, _TILES)
        corner = MARGIN + column * (TILE[0] + GAP), _BOTTOM + row * (TILE[1] + _CAPTION + 12)
        _draw_view(page, corner, TILE, view, crops)


def _draw_view(
    page: Canvas,
    corner: tuple[int, int],
    size: tuple[int, int],
    view: SignView,
    crops: Mapping[SignView, Crop],
) -> None:
    """A crop with its box, and its caption below."""
    (x, y), (width, height) = corner, size
    crop = crops.get(view)
    if crop is None:
        page.block(corner, size, PANEL)
        page.text((x + 16, y + 34), "image not readable", _SMALL, FAINT)
    else:
        page.paste(corner, draw_crop(crop, size))
    page.frame(corner, size)
    baseline = y + height + 25
    distance = "" if view.range_m is None else f"{view.range_m:.1f} m"
    residual = "" if view.residual_px is None else f"{view.residual_px:.2f} px"
    label = shortened(view.image or f"frame {view.frame}", _SMALL, MEDIUM, width - _RESIDUAL - 64)
    page.text((x, baseline), label, _SMALL, TEXT, MEDIUM)
    page.text((x + width - _RESIDUAL, baseline), distance, _SMALL, FAINT, right=True)
    page.text((x + width, baseline), residual, _SMALL, FAINT, right=True)


def draw_crop(crop: Crop, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A crop with its box, (height, width, 3) uint8 RGB; `size` is width, height of `PROPORTION`."""
    scaled = crop.scaled_to(*size)
    part = Canvas(*size)
    part.paste((0, 0), scaled.rgb)
    thickness = 2 if size[0] <= TILE[0] else 3
    x0, y0, x1, y1 = (edge - 0.5 for edge in scaled.box)  # pixel centres stand at integers
    gap = (thickness + _HALO) / 2 + 1  # the line goes around the face, not over it
    x0, y0, x1, y1 = x0 - gap, y0 - gap, x1 + gap, y1 + gap
    outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    part.line(outline, PAPER, thickness + _HALO, closed=True)
    part.line(outline, ACCENT, thickness, closed=True)
    return part.rgb
