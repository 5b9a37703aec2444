"""Pictures of curves: one of each classifier, drawn like the evidence sheets."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.canvas import FAINT, MEDIUM, RULE, TEXT, Canvas, text_width
from wayside.pipeline.evidence.marks import Ink
from wayside.pipeline.roc.curves import RocCurve
from wayside.pipeline.roc.questions import ALL, Question
from wayside.schemas.detections import COLOR_RGB

SIDE, LEFT, TOP, RIGHT, BOTTOM = 520, 80, 70, 560, 70
SMALL, TITLE = 15, 19
BAND_INK: Ink = (232, 236, 241)
_INKS: tuple[Ink, ...] = (
    (30, 110, 200),
    (200, 80, 30),
    (20, 140, 90),
    (150, 60, 170),
    (190, 150, 20),
    (70, 70, 70),
    (220, 90, 140),
    (60, 150, 180),
    (120, 90, 50),
    (100, 100, 200),
)
_DARKER = 0.8


def draw_curves(classifier: str, drawn: Sequence[tuple[Question, RocCurve]]) -> NDArray[np.uint8]:
    """RGB image: TPR against FPR of each class, the band of the first; ring: knee, dot: threshold of the run."""
    height = max(TOP + SIDE + BOTTOM, TOP + 46 * len(drawn) + 60)
    page = Canvas(LEFT + SIDE + RIGHT, height)
    page.text((LEFT, 36), f"ROC of {classifier}", TITLE, TEXT, MEDIUM)
    first = drawn[0][1] if drawn else None
    if first is not None and first.tpr_band is not None:
        upper = _points(first.fpr, first.tpr_band[:, 1])
        lower = _points(first.fpr, first.tpr_band[:, 0])
        page.polygon(np.concatenate([upper, lower[::-1]]), BAND_INK)
    for tick in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0):
        (x, y), words = _points(np.array([tick]), np.array([tick]))[0], f"{tick:g}"
        page.line([(LEFT, y), (LEFT + SIDE, y)], RULE, 1)
        page.line([(x, TOP), (x, TOP + SIDE)], RULE, 1)
        page.text((LEFT - 10, y + 5), words, SMALL, FAINT, right=True)
        page.text((x - text_width(words, SMALL) / 2, TOP + SIDE + 22), words, SMALL, FAINT)
    page.text((LEFT, TOP - 12), "true positive rate", SMALL, FAINT)
    page.text((LEFT + SIDE, TOP + SIDE + 46), "false positive rate", SMALL, FAINT, right=True)
    for row, (question, curve) in enumerate(drawn):
        ink = ink_of(question.name, row)
        points = _points(np.append(curve.fpr, 1.0), np.append(curve.tpr, 1.0))
        page.line(points, ink, 3 if question.name == ALL else 2)
        used = question.used_row(curve)
        at = curve.knee if used is None else used
        page.dot(points[curve.knee], 6, (255, 255, 255), ink)
        if used is not None:
            page.dot(points[at], 5, ink)
        y = TOP + 14 + 46 * row
        page.line([(LEFT + SIDE + 30, y - 5), (LEFT + SIDE + 58, y - 5)], ink, 3)
        page.text((LEFT + SIDE + 68, y), f"{question.name}   area {_area(curve)}", SMALL, TEXT)
        shown = float(curve.threshold[at]) if used is None else question.threshold
        value = f"{shown:.4g}" if isfinite(shown) else "none"
        words = f"{'knee' if used is None else 'threshold'} {value}: "
        words += f"{100 * curve.tpr[at]:.1f} % of {curve.positives} signs, "
        words += f"{100 * curve.fpr[at]:.2g} % of {curve.negatives} others"
        page.text((LEFT + SIDE + 68, y + 19), words, SMALL - 2, FAINT)
    key = "dot: threshold of the run; ring: knee; grey: 95 % band of the first curve"
    page.text((LEFT + SIDE + 30, height - 24), key, SMALL - 2, FAINT)
    return page.rgb


def png(rgb: NDArray[np.uint8]) -> bytes:
    """The image as PNG."""
    return bytes(cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))[1])


def ink_of(name: str, row: int) -> Ink:
    """Colour of a curve: dark of a whole classifier, that of a class of colour, somewhat darker, else by its row."""
    if name == ALL:
        return TEXT
    if name in COLOR_RGB:
        r, g, b = (round(_DARKER * v) for v in COLOR_RGB[name])
        return r, g, b
    return _INKS[row % len(_INKS)]


def _points(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([LEFT + SIDE * x, TOP + SIDE * (1 - y)], axis=-1)


def _area(curve: RocCurve) -> str:
    if curve.area_interval is None:
        return f"{curve.area:.3f}"
    return f"{curve.area:.3f} ({curve.area_interval.low:.3f} to {curve.area_interval.high:.3f})"
