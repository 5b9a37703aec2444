"""Why a wanted sign was not found: the last step that a candidate on it passed, in any image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wayside.pipeline.evaluation.figures import (
    MissCause,
)
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

NOT_READ, NO_CANDIDATE = "not_read", "none"
"""What stands for a verdict where an image was not read, and where no candidate is on a view."""
MISPLACED, OTHER_SIGN = "misplaced", "other_sign"
"""Reasons of `reported` beside `back` and `uncertain`: the row is on it but stands too far from it, or is matched with
another sign."""

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
_ORDER = list(STEPS)
Distances = Mapping[tuple[str, int | str], float]
"""Of rows from missed signs, metres, by their names."""


@dataclass(frozen=True, slots=True)
class Face:
    """A wanted sign and its boxes in images, by frame: those views of it that count."""

    id: int | str
    views: Mapping[int, Box]


class Candidates:
    """Rows of `observations.parquet` in their order, by frame: box, verdict, track, sign."""

    COLUMNS = ("frame", "box", "verdict", "track_id", "sign_id")

    def __init__(self, table: pa.Table) -> None:
        """Keep the columns `COLUMNS` of a table sorted by frame."""
        self.frame = np.asarray(table["frame"])
        sides = np.asarray(pc.list_flatten(table["box"]), np.float64)
        self.box: NDArray[np.float64] = sides.reshape(-1, 4)
        self.verdict = [str(verdict) for verdict in table["verdict"].to_pylist()]
        self.followed: list[bool] = [track is not None for track in table["track_id"].to_pylist()]
        self.sign: list[str | None] = table["sign_id"].to_pylist()

    def of_signs(self) -> Iterator[dict[str, Any]]:
        """Rows that belong to a reported sign: `sign_id`, `frame`, `box`."""
        for i, name in enumerate(self.sign):
            if name is not None:
                yield {"sign_id": name, "frame": int(self.frame[i]), "box": self.box[i].tolist()}

    def on(self, frame: int, box: Box) -> list[tuple[int, float]]:
        """Rows that show the content of a box of a frame, with their overlap."""
        first, last = np.searchsorted(self.frame, [frame, frame + 1])
        shared = overlap(self.box[first:last], box)
        return [(int(first + i), float(shared[i])) for i in np.flatnonzero(shared)]


def miss_causes(
    missed: Sequence[Face],
    candidates: Candidates,
    frames: Mapping[int, str],
    rows: Mapping[str, str],
    distances: Distances | None = None,
) -> tuple[MissCause, ...]:
    """The cause of each miss: the last step that a candidate on it passed in any view, and the usual reason there.

    Without that step it would have come further. The verdicts of fewer views are counted separately.

    Parameters
    ----------
    missed
        The signs that were not found.
    candidates
        All candidates of the images that show them.
    frames
        Status of each image that was read.
    rows
        Status of each reported row.
    distances
        Of rows with status `sign` that no sign was matched with, from each missed sign, metres; None where no place is
        known.
    """
    return tuple(_cause(face, candidates, frames, rows, distances or {}) for face in missed)


def _cause(
    face: Face,
    candidates: Candidates,
    frames: Mapping[int, str],
    rows: Mapping[str, str],
    distances: Distances,
) -> MissCause:
    outcomes: list[tuple[str, str]] = []
    on_it: Counter[str] = Counter()
    for frame, box in face.views.items():
        status = frames.get(frame, NOT_READ)
        if status != USED:
            outcomes.append(("unused", status))
            continue
        best = ("no_candidate", NO_CANDIDATE), 0.0
        for row, shared in candidates.on(frame, box):
            step = _step(candidates.verdict[row], followed=candidates.followed[row])
            sign = candidates.sign[row]
            if step == "reported" and sign is not None:
                on_it[sign] += 1
            best = max(
                best,
                ((step, candidates.verdict[row]), shared),
                key=lambda one: (_ORDER.index(one[0][0]), one[1]),
            )
        outcomes.append(best[0])
    views = Counter(verdict for _, verdict in outcomes)
    step = max((s for s, _ in outcomes), key=_ORDER.index, default="unused")
    reasons = Counter(verdict for s, verdict in outcomes if s == step)
    reason = reasons.most_common(1)[0][0] if reasons else NOT_READ
    if step != "reported" or not on_it:
        return MissCause(face.id, step, reason, dict(views.most_common()))
    row_id = on_it.most_common(1)[0][0]
    status, distance = rows.get(row_id, "sign"), distances.get((row_id, face.id))
    if status == "sign":
        reason = OTHER_SIGN if distance is None else MISPLACED
    else:
        reason = status
    return MissCause(face.id, step, reason, dict(views.most_common()), row_id, distance)


def _step(verdict: str, *, followed: bool) -> str:
    if verdict == "moving" and not followed:
        return "not_followed"
    return _STEP_OF_VERDICT.get(verdict, "refused")


def cause_words(cause: MissCause) -> str:
    """One cause in words, with the count of its views by verdict."""
    if cause.row is not None:
        said = {
            MISPLACED: f"{cause.row} is on it but stands {cause.distance_m or 0:.1f} m from it",
            OTHER_SIGN: f"{cause.row} is on it but is that of another sign",
        }.get(cause.reason, f"{cause.row} is on it with status {cause.reason}")
    else:
        said = STEPS[cause.step]
        if cause.step in ("gate", "not_followed", "refused"):
            said += f": {VERDICT_WORDS.get(cause.reason, cause.reason)}"
    counts = ", ".join(f"{count} {verdict}" for verdict, count in cause.views.items())
    return f"{said} ({counts or 'no view'})"


def count_steps(causes: Iterable[MissCause]) -> dict[str, int]:
    """How many signs were lost at each step, in the order of the work; steps that lost none are left out."""
    count = Counter(cause.step for cause in causes)
    return {step: count[step] for step in STEPS if step in count}
