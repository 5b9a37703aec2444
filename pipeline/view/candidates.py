"""Candidates by verdict, and what was found of each in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from wayside.pipeline.view import entities as at
from wayside.pipeline.view.entities import Entity
from wayside.pipeline.view.landmarks import GREY, color_of
from wayside.schemas.detections import COLORS, SHAPES, VERDICTS, Candidates

MANY, MOST_WORDS = ("size", "color"), 100
"""Verdicts of thousands of regions: their boxes are detail. Words for more boxes than this are not made."""


def verdict_entities(candidates: Candidates, shown: set[str], *, detail: bool) -> list[Entity]:
    """Boxes of every verdict; `shown` are the layers that the frame before left something in, changed here."""
    found = []
    for code, verdict in enumerate(VERDICTS):
        path = f"{at.CANDIDATES}/{verdict}"
        rows = np.flatnonzero(candidates.verdict == code)
        if len(rows) and (detail or verdict not in MANY):
            found.append(Entity(path, _boxes(candidates, rows, verdict)))
            shown.add(path)
        elif path in shown:
            found.append(Entity(path, (rr.Clear(recursive=False),)))
            shown.discard(path)
    return found


def _boxes(candidates: Candidates, rows: NDArray[np.int64], verdict: str) -> tuple[Any, ...]:
    sign, many = verdict == "sign", verdict in MANY or len(rows) > MOST_WORDS
    labels = None if many else [candidate_words(candidates, int(row)) for row in rows]
    boxes = rr.Boxes2D(
        array=candidates.regions.box[rows],
        array_format=rr.Box2DFormat.XYXY,
        colors=[color_of(int(c)) for c in candidates.color[rows]] if sign else [GREY],
        labels=labels,
        show_labels=False,  # of some presets, hundreds would cover the image
        radii=rr.Radius.ui_points(1.5 if sign else 0.7),
    )
    return (boxes, rr.AnyValues(score=candidates.score[rows])) if many else (boxes,)


def candidate_words(candidates: Candidates, row: int) -> str:
    """What was found of a candidate: verdict, score, colour and shape, in preset `report` with their distances."""
    parts = [VERDICTS[candidates.verdict[row]]]
    if np.isfinite(candidates.score[row]):
        parts.append(f"score {candidates.score[row]:.1f}")
    if candidates.back_score is not None and np.isfinite(candidates.back_score[row]):
        parts.append(f"back {candidates.back_score[row]:.1f}")
    for names, kind, distance in (
        (COLORS, candidates.color, candidates.color_distance),
        (SHAPES, candidates.shape, candidates.shape_distance),
    ):
        if kind[row] >= 0:
            far = f" {distance[row]:.1f}" if np.isfinite(distance[row]) else ""
            parts.append(names[kind[row]] + far)
    return ", ".join(parts)
