"""What a review says of a result: how many rows are right, and what was missed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.results.result import read_rows
from wayside.pipeline.reviewing.review import ACCEPTED, EDITED, REJECTED, Review, Reviewed
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
    def precision_interval(self) -> Interval | None:
        """95 % interval of the share of reviewed rows that are signs."""
        return share_interval(self.right, self.reviewed)

    @property
    def recall_interval(self) -> Interval | None:
        """95 % interval of the share of signs known to the reviewer that have a row."""
        return share_interval(self.right, self.right + self.missing)

    def to_json(self) -> dict[str, Any]:
        """All figures under plain keys."""
        return asdict(self) | {
            "reviewed": self.reviewed,
            "precision": _share(self.right, self.reviewed),
            "precision_interval": self.precision_interval,
            "recall": _share(self.right, self.right + self.missing),
            "recall_interval": self.recall_interval,
        }


def review_figures(out: Path, review: Review) -> ReviewFigures:
    """Figures of a review of the result in folder `out`.

    Raises
    ------
    InputError
        The folder is no result folder, or damaged.
    """
    columns = ["sign_id", "color", "shape"]
    rows = {row["sign_id"]: row for row in read_rows(out, SIGNS, columns, {"status": "sign"})}
    said = {name: review.rows[name] for name in rows if name in review.rows}
    counts = Counter(one.review for one in said.values())
    color, shape = (_looks(rows, said, look) for look in ("color", "shape"))
    return ReviewFigures(
        len(rows),
        counts[ACCEPTED],
        counts[EDITED],
        counts[REJECTED],
        len(review.missing),
        *color,
        *shape,
        len(review.rows) - len(said),
    )


def _looks(
    rows: Mapping[str, Mapping[str, Any]], said: Mapping[str, Reviewed], look: str
) -> tuple[int, int]:
    """How many right rows state a colour or shape, and how many of these are right."""
    stated = [
        one.review == ACCEPTED or getattr(one, look) == rows[name][look]
        for name, one in said.items()
        if one.review in (ACCEPTED, EDITED) and rows[name][look] is not None
    ]
    return len(stated), sum(stated)


def format_figures(figures: ReviewFigures) -> str:
    """All figures as plain text."""
    f = figures
    lines = [
        f"reviewed   {f.reviewed} of {f.rows} rows with status sign: {f.accepted} accepted, {f.edited} edited, "
        f"{f.rejected} rejected",
        f"precision  {_shown(f.right, f.reviewed, f.precision_interval)} of the reviewed rows are signs",
        f"recall     {_shown(f.right, f.right + f.missing, f.recall_interval)} of the signs known to the reviewer; "
        f"{f.missing} missing",
        f"colour     {_shown(f.color_right, f.color_stated)} right",
        f"shape      {_shown(f.shape_right, f.shape_stated)} right",
    ]
    if f.others:
        lines.append(f"not counted: {f.others} reviewed rows with status back or uncertain")
    if f.reviewed < f.rows:
        lines.append(f"{f.rows - f.reviewed} rows are not reviewed: recall counts none of them")
    return "\n".join(lines)


def _share(count: int, total: int) -> float | None:
    return count / total if total else None


def _shown(count: int, total: int, interval: Interval | None = None) -> str:
    share = "-" if total == 0 else f"{count / total:.3f}"
    between = "" if interval is None else f" ({interval[0]:.3f} to {interval[1]:.3f})"
    return f"{share}   {count} of {total}{between}"
