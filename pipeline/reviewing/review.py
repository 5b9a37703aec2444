"""The review of a result: where it lies, its labels and its figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.results.result import read_rows
from wayside.pipeline.reviewing.entries import ACCEPTED, EDITED, REJECTED, read_entries
from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.matching import NO_REVIEW, Review, settled
from wayside.pipeline.statistics import Interval, share_interval
from wayside.schemas.errors import UsageError
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, Label, LabelledImage, Labels
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

FILES = ("review*.json", "review*.csv")
"""Reviews that lie in the folder of their result."""


def find_review(out: Path, given: Sequence[Path] = (), known: KnownResult | None = None) -> Review:
    """The review of a result by the files given, else by all that lie in its folder, as one.

    known: the rows of the result, where they are read already. Raises InputError if a file is no review, or is of
    another drive.
    """
    files = given or [path for name in FILES for path in sorted(out.glob(name))]
    if not files:
        return NO_REVIEW
    return settled([read_entries(file) for file in files], known or KnownResult.of(out))


def required_review(out: Path, given: Sequence[Path] = ()) -> Review:
    """The review of a result as `find_review` finds it; raises UsageError without one."""
    review = find_review(out, given)
    if review == NO_REVIEW:
        raise UsageError(
            f"{out}: there are no corrections to make labels of: no review.json or review.csv. Save them in its "
            "evidence index, or name the file with --review of `wayside label`."
        )
    return review


def review_labels(out: Path, review: Review) -> Labels:
    """A label of each measured view of each reviewed row; a missing sign has no box and is left out, counted.

    Raises InputError if the folder is no result folder, or damaged.
    """
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, ["sign_id", "log", "status"])}
    frames = read_rows(out, FRAMES, ["frame", "log_time_ns"])
    times_ns = {row["frame"]: row["log_time_ns"] for row in frames}
    labels = []
    for row in read_rows(out, OBSERVATIONS, ["sign_id", "frame", "box"], {"verdict": "sign"}):
        said = review.rows.get(row["sign_id"])
        if said is None:
            continue
        sign = signs[row["sign_id"]]
        look = said.final({})
        kind = BACK if sign["status"] == "back" else SIGN
        rejected = said.review == REJECTED
        labels.append(
            Label(
                LabelledImage(sign["log"], row["frame"], times_ns[row["frame"]]),
                NOT_A_SIGN if rejected else kind,
                tuple(row["box"]),
                None if rejected else look["color"],
                None if rejected else look["shape"],
                panel=row["sign_id"],
                source=said.reviewer or "review",
                note=said.note,
            )
        )
    left_out = {"missing_without_box": len(review.missing), "undecided": len(review.undecided)}
    return Labels(tuple(labels), (), {reason: count for reason, count in left_out.items() if count})


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
            one.final(rows[name])[look] == rows[name][look]
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
