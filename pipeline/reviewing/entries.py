"""The files of a review, JSON or CSV, and what each of their rows says."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.files.input_files import decoded, open_input, read_input_text
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json, read_csv
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.labels import Box

ACCEPTED, REJECTED, EDITED, MISSING = "accepted", "rejected", "edited", "missing"
REVIEWS = {
    ACCEPTED: "a row that is right",
    REJECTED: "a row that is no sign, or not one of its own",
    EDITED: "a sign whose code, legend, colour or shape is another: those of the review hold",
    MISSING: "a sign that has no row, at x and y of the world frame",
}
UNKNOWN = "unknown"
"""In place of a code, legend, colour or shape: it cannot be told, whatever was measured."""
LOOK = ("code", "legend", "color", "shape")
_NUMBERS = ("x", "y", "right_m", "ahead_m")
COLUMNS = (
    *("result", "sign_id", "review", *LOOK, *_NUMBERS, "image", "views", "note", "reviewer"),
)
EXPORTED = {f"final_{name}": name for name in LOOK} | {"review_note": "note"}
"""Columns of an exported table, and those of a review that they are."""


@dataclass(frozen=True, slots=True)
class Reviewed:
    """The review of one sign."""

    review: str
    """A key of `REVIEWS`."""
    sign_id: str | None = None
    """None: it is missing."""
    result: str = ""
    """Name of the result that has the row, see `result_name`; empty: not stated."""
    code: str | None = None
    """What the sign is by the reviewer; None: as measured. May be `UNKNOWN`."""
    legend: str | None = None
    """The same."""
    color: str | None = None
    """The same."""
    shape: str | None = None
    """The same."""
    x: float | None = None
    """World frame of that result, metres; stated of a missing sign."""
    y: float | None = None
    """The same."""
    image: str | None = None
    """An image near the sign by its `image_key`, by which its place is found in other results."""
    right_m: float | None = None
    """To the right of the camera of that image."""
    ahead_m: float | None = None
    """Ahead of it, level."""
    views: tuple[tuple[str, Box], ...] = ()
    """Images that show the row, and its box in each."""
    note: str = ""
    """The reviewer's remark."""
    reviewer: str = ""
    """Who says so."""

    @property
    def look(self) -> dict[str, str | None]:
        """Code, legend, colour and shape."""
        return {name: getattr(self, name) for name in LOOK}

    def final(self, measured: Mapping[str, Any]) -> dict[str, str | None]:
        """The look that counts: what was reviewed, else what was measured."""
        whole = {name: value or measured.get(name) for name, value in self.look.items()}
        if self.review == REJECTED:
            whole = {name: measured.get(name) for name in LOOK}
        return {name: None if value == UNKNOWN else value for name, value in whole.items()}

    def to_row(self) -> dict[str, Any]:
        """As the evidence index keeps it."""
        return {name: value for name, value in asdict(self).items() if value not in (None, ())}


def is_review(path: Path) -> bool:
    """Whether a file is a review, by what it holds."""
    try:
        if path.suffix.lower() == ".csv":
            return "review" in read_csv(path)[0]
        with open_input(path) as stream:
            return '"reviews"' in decoded(stream.read(4096))
    except (OSError, ValueError, csv.Error):
        return False


def read_entries(path: Path) -> list[Reviewed]:
    """The rows of a file; raises InputError if it is no review, or a row says what none can."""
    try:
        rows = list(_csv_rows(path) if path.suffix.lower() == ".csv" else _json_rows(path))
    except (OSError, csv.Error, *CONTENT_FAULTS) as error:
        found = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise InputError(
            f"{path}: this is not a review as the evidence index saves it: {found[:200]}. See docs/corrections.md."
        ) from error
    entries = []
    for number, row in enumerate(rows, 1):
        try:
            entries.append(_reviewed(row))
        except CONTENT_FAULTS as error:
            raise InputError(f"{path}: review {number}: {error}; correct it") from error
    return entries


def _json_rows(path: Path) -> Iterator[dict[str, Any]]:
    content = parse_json(read_input_text(path))
    shared = {"result": content.get("result", ""), "reviewer": content.get("reviewer", "")}
    for entry in content["reviews"]:
        yield shared | {name: value for name, value in entry.items() if value is not None}


def _csv_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Rows of a review, or of an exported table with reviews filled in. Empty rows are left out."""
    names, rows = read_csv(path, _NUMBERS)
    if "review" not in names:
        raise ValueError(f"no column review among {', '.join(names)}")
    exported = not EXPORTED.keys().isdisjoint(names)  # its color and shape are those measured
    taken = {name: name for name in COLUMNS if not exported or name not in EXPORTED.values()}
    taken |= EXPORTED if exported else {}
    for row in rows:
        said = {own: row[name] for name, own in taken.items() if name in row}
        if exported and said.get("review") == EDITED:
            measured = row | {"code": row.get("mutcd") or row.get("vienna")}
            if all(said.get(name) == measured.get(name) for name in LOOK):
                raise ValueError(f"{said.get('sign_id')} is edited, but its final columns are not")
        if not said.keys().isdisjoint(("review", "note", *(() if exported else LOOK))):
            yield said


def _reviewed(row: Mapping[str, Any]) -> Reviewed:
    review = row.get("review")
    if review not in REVIEWS:
        raise ValueError(f"there is no review {review!r} among {', '.join(REVIEWS)}")
    for name, classes in (("color", COLORS), ("shape", SHAPES)):
        if name in row and row[name] not in (*classes, UNKNOWN):
            raise ValueError(f"there is no {name} {row[name]!r} among {', '.join(classes)}")
    numbers = {name: float(row[name]) for name in _NUMBERS if name in row}
    if not all(map(math.isfinite, numbers.values())):
        raise ValueError("its place is not finite")
    sign_id = None if review == MISSING else row.get("sign_id")
    if review == MISSING and not {"x", "y"} <= numbers.keys():
        raise ValueError("a missing sign has x and y of the world frame")
    if review != MISSING and not (sign_id and isinstance(sign_id, str)):
        raise ValueError("no sign_id")
    views = row.get("views", ())
    words = {
        n: str(row[n])
        for n in ("result", "code", "legend", "image", "note", "reviewer")
        if n in row
    }
    look = {name: row.get(name) for name in ("color", "shape")}
    seen = tuple(_view(*one) for one in (json.loads(views) if isinstance(views, str) else views))
    return Reviewed(review, sign_id, **words, **look, **numbers, views=seen)


def _view(image: str, box: Box) -> tuple[str, Box]:
    x0, y0, x1, y1 = map(float, box)
    return str(image), (x0, y0, x1, y1)
