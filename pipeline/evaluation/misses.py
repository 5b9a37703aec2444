"""Why a wanted sign was not found: the last step that a candidate on it passed, in any image."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from wayside.pipeline.evaluation.figures import MissCause, Row
from wayside.pipeline.labels.box_matching import Box, overlap
from wayside.schemas.detections import VERDICT_WORDS
from wayside.schemas.frame import USED

STEPS = {
    "unused": "no image of it was used",
    "no_candidate": "no candidate on it that is classified",
    "gate": "outside a gate",
    "rejected": "below the threshold of the box classifier",
    "suppressed": "suppressed by another box",
    "not_followed": "detected, not followed",
    "refused": "followed and refused",
    "reported": "reported, not as this sign",
}
"""Where a sign can be lost, in the order of the work, in words."""
_ORDER = list(STEPS)
NOT_READ, NO_CANDIDATE = "not_read", "none"
"""Used in place of a verdict if an image was not read, or no candidate is on a view."""
MISPLACED, OTHER_SIGN = "misplaced", "other_sign"
"""Reasons of `reported`: the row on it is too far from it, or belongs to another sign."""
_STEP_OF_VERDICT = {
    "size": "gate",
    "color": "gate",
    "shape": "gate",
    "score": "rejected",
    "overlap": "suppressed",
    "unmatched": "not_followed",
    "few_views": "not_followed",
    "far_view": "not_followed",
    "open": "not_followed",
    "sign": "reported",
}
"""All other verdicts are those of landmarks; `moving` is given to candidates of none as well."""


@dataclass(frozen=True, slots=True)
class Face:
    """A wanted sign that was not found."""

    id: int | str
    views: Mapping[int, Box]
    """Its box by frame, in those views that count."""
    distance_m: Mapping[str, float] = field(default_factory=dict)
    """How far from it the signs stand that are matched with none, by `sign_id`."""


class Candidates:
    """Rows of `observations.parquet`, sorted by frame."""

    COLUMNS = ("frame", "box", "verdict", "track_id", "sign_id")

    def __init__(self, table: pa.Table) -> None:
        """Keep a table of the columns `COLUMNS`."""
        self._table, self._frame = table, np.asarray(table["frame"])

    def of_signs(self) -> list[dict[str, Any]]:
        """Rows that belong to a reported sign."""
        rows: list[dict[str, Any]] = self._table.filter(
            pc.is_valid(self._table["sign_id"])
        ).to_pylist()
        return rows

    def on(self, frame: int, box: Box) -> list[tuple[Row, float]]:
        """Rows that show the content of a box of a frame, with their overlap."""
        first, last = np.searchsorted(self._frame, [frame, frame + 1]).tolist()
        rows = self._table.slice(first, last - first).to_pylist()
        shared = overlap(np.array([row["box"] for row in rows], np.float64), box).tolist()
        return [(row, share) for row, share in zip(rows, shared, strict=True) if share > 0]


def miss_cause(
    face: Face, candidates: Candidates, frames: Mapping[int, str], rows: Mapping[str, str]
) -> MissCause:
    """The last step that a candidate on a missed sign passed in any view, and the usual reason there.

    `candidates`: all of the images that show it. `frames`: status of each image that was read. `rows`: status of each
    reported row.
    """
    outcomes: list[tuple[str, str]] = []
    on_it: Counter[str] = Counter()
    for frame, box in face.views.items():
        status = frames.get(frame, NOT_READ)
        if status != USED:
            outcomes.append(("unused", status))
            continue
        furthest = "no_candidate", NO_CANDIDATE, 0.0
        for row, shared in candidates.on(frame, box):
            step = _STEP_OF_VERDICT.get(row["verdict"], "refused")
            if row["verdict"] == "moving" and row["track_id"] is None:
                step = "not_followed"
            if step == "reported" and row["sign_id"] is not None:
                on_it[row["sign_id"]] += 1
            if (_ORDER.index(step), shared) > (_ORDER.index(furthest[0]), furthest[2]):
                furthest = step, row["verdict"], shared
        outcomes.append(furthest[:2])
    views = dict(Counter(verdict for _, verdict in outcomes).most_common())
    step = max((step for step, _ in outcomes), key=_ORDER.index, default="unused")
    reasons = Counter(verdict for at, verdict in outcomes if at == step)
    reason = reasons.most_common(1)[0][0] if reasons else NOT_READ
    if step != "reported" or not on_it:
        return MissCause(face.id, step, reason, views)
    sign_id = on_it.most_common(1)[0][0]
    reason, distance = rows.get(sign_id, "sign"), face.distance_m.get(sign_id)
    if reason == "sign":
        reason = OTHER_SIGN if distance is None else MISPLACED
    return MissCause(face.id, step, reason, views, sign_id, distance)


def cause_words(cause: MissCause) -> str:
    """One cause in words, with the count of its views by verdict."""
    said = STEPS[cause.step]
    if cause.row is not None:
        why = {
            MISPLACED: f"but stands {cause.distance_m or 0:.1f} m from it",
            OTHER_SIGN: "but is that of another sign",
        }.get(cause.reason, f"with status {cause.reason}")
        said = f"{cause.row} is on it {why}"
    elif cause.step in ("gate", "not_followed", "refused"):
        said += f": {VERDICT_WORDS.get(cause.reason, cause.reason)}"
    counts = ", ".join(f"{count} {verdict}" for verdict, count in cause.views.items())
    return f"{said} ({counts or 'no view'})"


def count_steps(causes: Iterable[MissCause]) -> dict[str, int]:
    """How many signs were lost at each step, in the order of the work; steps that lost none are left out."""
    count = Counter(cause.step for cause in causes)
    return {step: count[step] for step in STEPS if step in count}
