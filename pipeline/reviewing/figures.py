"""What a review says of a result: how many rows are right, and what was missed."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.results.result import read_rows
from wayside.pipeline.reviewing.review import ACCEPTED, EDITED, REJECTED, Review
from wayside.pipeline.statistics import Interval, share_interval
from wayside.schemas.tables import SIGNS


@dataclass(frozen=True, slots=True)
class ReviewFigures:
    """Counts of rows with status `sign`, by their review.

    color_stated, shape_stated: right rows that state one; color_right, shape_right: of these, those whose is right.
    """

    rows: int
    accepted: int
    edited: int
    rejected: int
    missing: int
    color_stated: int
    color_right: int
    shape_stated: int
    shape_right: int
    others: int
    """Reviewed rows of another status, which count for nothing here."""

    @property
    def right(self) -> int:
        """Rows that are signs."""
        return self.accepted + self.edited

    @property
    def reviewed(self) -> int:
        """Rows that are reviewed."""
        return self.right + self.rejected

    @property
    def known(self) -> int:
        """Signs known to the reviewer."""
        return self.right + self.missing

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys, with 95 % intervals of both shares."""
        return asdict(self) | {
            "reviewed": self.reviewed,
            "precision": self.right / self.reviewed if self.reviewed else None,
            "precision_interval": share_interval(self.right, self.reviewed),
            "recall": self.right / self.known if self.known else None,
            "recall_interval": share_interval(self.right, self.known),
        }


def review_figures(out: Path, review: Review) -> ReviewFigures:
    """Figures of a review of the result in folder `out`; raises InputError if it is no result, or damaged."""
    columns = ["sign_id", "color", "shape"]
    rows = {row["sign_id"]: row for row in read_rows(out, SIGNS, columns, {"status": "sign"})}
    said = {name: review.rows[name] for name in rows if name in review.rows}
    counts = Counter(one.review for one in said.values())
    looks: dict[str, int] = {}
    for look in ("color", "shape"):
        right = [
            one.review == ACCEPTED or getattr(one, look) == rows[name][look]
            for name, one in said.items()
            if one.review in (ACCEPTED, EDITED) and rows[name][look] is not None
        ]
        looks |= {f"{look}_stated": len(right), f"{look}_right": sum(right)}
    return ReviewFigures(
        rows=len(rows),
        accepted=counts[ACCEPTED],
        edited=counts[EDITED],
        rejected=counts[REJECTED],
        missing=len(review.missing),
        others=len(review.rows) - len(said),
        **looks,
    )


def format_figures(figures: ReviewFigures) -> str:
    """All figures as plain text."""
    f = figures
    precision = _shown(f.right, f.reviewed, share_interval(f.right, f.reviewed))
    recall = _shown(f.right, f.known, share_interval(f.right, f.known))
    lines = [
        f"reviewed   {f.reviewed} of {f.rows} rows with status sign: {f.accepted} accepted, {f.edited} edited, "
        f"{f.rejected} rejected",
        f"precision  {precision} of the reviewed rows are signs",
        f"recall     {recall} of the signs known to the reviewer; {f.missing} missing",
        f"colour     {_shown(f.color_right, f.color_stated)} right",
        f"shape      {_shown(f.shape_right, f.shape_stated)} right",
    ]
    if f.others:
        lines.append(f"not counted: {f.others} reviewed rows with status back or uncertain")
    if f.reviewed < f.rows:
        lines.append(f"{f.rows - f.reviewed} rows are not reviewed: recall counts none of them")
    return "\n".join(lines)


def _shown(count: int, total: int, interval: Interval | None = None) -> str:
    share = "-" if total == 0 else f"{count / total:.3f}"
    between = "" if interval is None else f" ({interval[0]:.3f} to {interval[1]:.3f})"
    return f"{share}   {count} of {total}{between}"
