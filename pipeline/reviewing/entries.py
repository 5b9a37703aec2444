"""The files of a review, JSON or CSV, and what each of their rows says."""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
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
_WORDS = ("result", "note", "reviewer")
COLUMNS = ("sign_id", "review", *LOOK, "x", "y", *_WORDS)
EXPORTED = {f"final_{name}": name for name in LOOK} | {"review_note": "note"}
"""Columns of an exported table, and those of a review that they are."""
Look = Mapping[str, str | None]


@dataclass(frozen=True, slots=True)
class Reviewed:
    """The review of one sign."""

    review: str
    """A key of `REVIEWS`."""
    sign_id: str | None = None
    """None: it is missing."""
    look: Look = field(default_factory=dict)
    """By the names of `LOOK`; what is None or absent is as measured, see `UNKNOWN`."""
    x: float | None = None
    """World frame of the result, metres; stated of a missing sign."""
    y: float | None = None
    """The same."""
    seen: tuple[tuple[str, float, float], ...] = ()
    """The same from images nearby, by which it is found in other results: metres to the right and ahead, level."""
    views: tuple[tuple[str, Box], ...] = ()
    """Images that show the row, and its box in each."""
    result: str = ""
    """Name of the result that has the row; empty: not stated."""
    note: str = ""
    """The reviewer's remark."""
    reviewer: str = ""
    """Who says so."""

    def final(self, measured: Look) -> dict[str, str | None]:
        """The look that counts: what was reviewed, else what was measured."""
        said = {} if self.review == REJECTED else self.look
        whole = {name: said.get(name) or measured.get(name) for name in LOOK}
        return {name: None if value == UNKNOWN else value for name, value in whole.items()}

    def to_row(self) -> dict[str, Any]:
        """As the evidence index keeps it."""
        look: dict[str, Any] = {name: self.look.get(name) for name in LOOK}
        return {name: value for name, value in asdict(self).items() if name != "look"} | look


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
    entries = []
    try:
        rows = _csv_rows(path) if path.suffix.lower() == ".csv" else _json_rows(path)
        for number, row in enumerate(list(rows), 1):
            try:
                entries.append(_reviewed(row))
            except CONTENT_FAULTS as error:
                raise InputError(f"{path}: review {number}: {error}; correct it") from error
    except (OSError, csv.Error, *CONTENT_FAULTS) as error:
        found = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        raise InputError(
            f"{path}: this is not a review as the evidence index saves it: {found[:200]}. See docs/corrections.md."
        ) from error
    return entries


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
        if exported and said.get("review") == EDITED:
            measured = row | {"code": row.get("mutcd") or row.get("vienna")}
            if all(said.get(name) == measured.get(name) for name in LOOK):
                raise ValueError(f"{said.get('sign_id')} is edited, but its final columns are not")
        if not said.keys().isdisjoint(("review", "note", *(() if exported else LOOK))):
            yield said


def _reviewed(row: Mapping[str, Any]) -> Reviewed:
    review, sign_id = row.get("review"), row.get("sign_id")
    if review not in REVIEWS:
        raise ValueError(f"there is no review {review!r} among {', '.join(REVIEWS)}")
    for name, classes in (("color", COLORS), ("shape", SHAPES)):
        if name in row and row[name] not in (*classes, UNKNOWN):
            raise ValueError(f"there is no {name} {row[name]!r} among {', '.join(classes)}")
    numbers = {axis: float(row[axis]) for axis in "xy" if axis in row}
    placed = len(numbers) == 2 and all(map(math.isfinite, numbers.values()))
    if review == MISSING and not placed:
        raise ValueError("a missing sign has x and y of the world frame")
    if review != MISSING and not (sign_id and isinstance(sign_id, str)):
        raise ValueError("no sign_id")
    look = {name: str(row[name]) for name in LOOK if name in row}
    views = tuple((str(image), (*map(float, box),)) for image, box in row.get("views", ()))
    seen = tuple(
        (str(image), float(right), float(ahead)) for image, right, ahead in row.get("seen", ())
    )
    words = {name: str(row[name]) for name in _WORDS if name in row}
    known: dict[str, Any] = numbers | words | {"views": views, "seen": seen, "look": look}
    return Reviewed(review, None if review == MISSING else sign_id, **known)
