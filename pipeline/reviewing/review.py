"""A review of a result, JSON or CSV: what it says of rows and missing signs, its labels and its figures."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.files.input_files import decoded, open_input, read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json, read_csv
from wayside.pipeline.results.result import read_rows, read_run
from wayside.pipeline.statistics import Interval, share_interval
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, Label, LabelledImage, Labels
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

ACCEPTED, REJECTED, EDITED, MISSING = "accepted", "rejected", "edited", "missing"
REVIEWS = {
    ACCEPTED: "a row that is right, its colour and shape included",
    REJECTED: "a row that is no sign, or not one of its own",
    EDITED: "a sign whose colour or shape is another: those of the review hold",
    MISSING: "a sign that has no row, at x and y of the world frame",
}
COLUMNS = ("result", "sign_id", "review", "color", "shape", "x", "y", "note", "reviewer")
EXPORTED = {"reviewed_color": "color", "reviewed_shape": "shape", "review_note": "note"}
"""Columns of an exported table, and those of a review that they are."""
FILES = ("review.json", "review.csv")
"""Where a review lies in the folder of its result."""


@dataclass(frozen=True, slots=True)
class Reviewed:
    """The review of one sign."""

    review: str
    """A key of `REVIEWS`."""
    sign_id: str | None = None
    """None: it is missing."""
    color: str | None = None
    """Of one edited or missing."""
    shape: str | None = None
    """Of one edited or missing."""
    x: float | None = None
    """Of a missing one in the world frame, metres."""
    y: float | None = None
    note: str = ""
    reviewer: str = ""


@dataclass(frozen=True, slots=True)
class Review:
    """Reviews of rows by `sign_id`, and of signs that are missing."""

    rows: Mapping[str, Reviewed]
    missing: tuple[Reviewed, ...]


NO_REVIEW = Review({}, ())


def find_review(out: Path, given: Path | None) -> Review:
    """The review of a result: the one given, else one that lies in its folder, else none.

    Raises InputError as `read_review` does, or if both of `FILES` lie there.
    """
    found = [out / name for name in FILES if (out / name).is_file()] if given is None else [given]
    if len(found) > 1:
        raise InputError(
            f"{out}: there are two reviews, {' and '.join(FILES)}. Choose one with --review."
        )
    return read_review(found[0], out) if found else NO_REVIEW


def required_review(out: Path, given: Path | None) -> Review:
    """The review of a result as `find_review` finds it; raises UsageError without one."""
    review = find_review(out, given)
    if review == NO_REVIEW:
        raise UsageError(
            f"{out}: there are no corrections to make labels of: no {' or '.join(FILES)}. Save them in its evidence "
            "index, or name the file with --review of `wayside label`."
        )
    return review


def is_review(path: Path) -> bool:
    """Whether a file is a review, by what it holds."""
    try:
        if path.suffix.lower() == ".csv":
            return "review" in read_csv(path)[0]
        with open_input(path) as stream:
            return '"reviews"' in decoded(stream.read(4096))
    except (OSError, ValueError, csv.Error):
        return False


def read_review(path: Path, out: Path) -> Review:
    """A review of the result in folder `out`.

    Raises InputError if it is of another result, names a sign that the result does not hold, or says what is no review.
    """
    try:
        entries = list(_csv_rows(path) if path.suffix.lower() == ".csv" else _json_rows(path))
    except (OSError, csv.Error, *CONTENT_FAULTS) as error:
        found = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise InputError(
            f"{path}: this is not a review as the evidence index saves it: {found[:200]}. See docs/corrections.md."
        ) from error
    known = {str(row["sign_id"]) for row in read_rows(out, SIGNS, ["sign_id"])}
    result = result_name(read_run(out))
    rows: dict[str, Reviewed] = {}
    missing: list[Reviewed] = []
    for number, entry in enumerate(entries, 1):
        if entry.get("result") and entry["result"] != result:
            raise InputError(
                f"{path}: the review is of another run than {out}, whose signs have other numbers. Review the "
                "evidence of this result."
            )
        try:
            one = _reviewed(entry)
            if one.sign_id is None:
                missing.append(one)
                continue
            if one.sign_id not in known:
                raise ValueError(f"{out} has no sign {one.sign_id}")
            if one.sign_id in rows:
                raise ValueError(f"{one.sign_id} is reviewed twice")
            rows[one.sign_id] = one
        except CONTENT_FAULTS as error:
            raise InputError(f"{path}: review {number}: {error}; correct it") from error
    return Review(rows, tuple(missing))


def result_name(run: Mapping[str, Any]) -> str:
    """What tells the signs of one result from those of another run: the start of the digest of their table."""
    stated = run.get("files", {}).get(SIGNS.file)
    digest = stated.get("sha256", "") if isinstance(stated, dict) else ""
    return str(digest)[:16]


def _json_rows(path: Path) -> Iterator[dict[str, Any]]:
    content = parse_json(read_input_text(path))
    shared = {"result": content.get("result", ""), "reviewer": content.get("reviewer", "")}
    for entry in content["reviews"]:
        yield shared | {name: value for name, value in entry.items() if value is not None}


def _csv_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Rows of a review, or of an exported table with reviews filled in. Empty rows are left out."""
    names, rows = read_csv(path, "xy")
    if "review" not in names:
        raise ValueError(f"no column review among {', '.join(names)}")
    exported = not EXPORTED.keys().isdisjoint(names)  # its color and shape are those measured
    taken = {name: name for name in COLUMNS if not exported or name not in EXPORTED.values()}
    taken |= EXPORTED if exported else {}
    for row in rows:
        said = {own: row[name] for name, own in taken.items() if name in row}
        if exported and said.get("review") == EDITED and said.keys().isdisjoint(("color", "shape")):
            raise ValueError(
                f"{said.get('sign_id')} is edited, but its reviewed_color and reviewed_shape are empty"
            )
        if not said.keys().isdisjoint(("review", "color", "shape", "note")):
            yield said


def _reviewed(entry: Mapping[str, Any]) -> Reviewed:
    review = entry.get("review")
    if review not in REVIEWS:
        raise ValueError(f"there is no review {review!r} among {', '.join(REVIEWS)}")
    for name, classes in (("color", COLORS), ("shape", SHAPES)):
        if name in entry and entry[name] not in classes:
            raise ValueError(f"there is no {name} {entry[name]!r} among {', '.join(classes)}")
    sign_id = None if review == MISSING else entry.get("sign_id")
    x, y = (float(entry[axis]) if axis in entry else None for axis in "xy")
    placed = x is not None and y is not None and math.isfinite(x) and math.isfinite(y)
    if review == MISSING and not placed:
        raise ValueError("a missing sign has x and y of the world frame")
    if review != MISSING and not sign_id:
        raise ValueError("no sign_id")
    look = entry.get("color"), entry.get("shape")
    words = str(entry.get("note", "")), str(entry.get("reviewer", ""))
    return Reviewed(review, sign_id, *look, x, y, *words)


def review_labels(out: Path, review: Review) -> Labels:
    """A label of each measured view of each reviewed row; a missing sign has no box and is left out, counted.

    Raises InputError if the folder is no result folder, or damaged.
    """
    names = ["sign_id", "log", "status", "color", "shape"]
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, names)}
    frames = read_rows(out, FRAMES, ["frame", "log_time_ns"])
    times_ns = {row["frame"]: row["log_time_ns"] for row in frames}
    labels = []
    for row in read_rows(out, OBSERVATIONS, ["sign_id", "frame", "box"], {"verdict": "sign"}):
        said = review.rows.get(row["sign_id"])
        if said is None:
            continue
        sign = signs[row["sign_id"]]
        look = said if said.review == EDITED else None
        kind = BACK if sign["status"] == "back" else SIGN
        rejected = said.review == REJECTED
        labels.append(
            Label(
                LabelledImage(sign["log"], row["frame"], times_ns[row["frame"]]),
                NOT_A_SIGN if rejected else kind,
                tuple(row["box"]),
                None if rejected else look.color if look else sign["color"],
                None if rejected else look.shape if look else sign["shape"],
                panel=row["sign_id"],
                source=said.reviewer or "review",
                note=said.note,
            )
        )
    left_out = {"missing_without_box": len(review.missing)} if review.missing else {}
    return Labels(tuple(labels), (), left_out)


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
