"""A review of a result: rows accepted, rejected or corrected, and signs that are missing; JSON or CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.files.input_files import decoded, open_input, read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json, read_csv
from wayside.pipeline.results.result import read_rows, read_run
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.tables import SIGNS

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
