"""Reviews of one result or of earlier ones, by one person or several, as one review of the result that there is.

A row of an earlier result is the row of this one that shows the same thing: in most images that both know, their boxes
show the same. Without such an image it is the nearest row of the same look. Each row is taken once. What agrees is
carried over; all else is left to a person.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from wayside.pipeline.results.result import read_rows, read_run, result_name
from wayside.pipeline.reviewing.entries import (
    ACCEPTED,
    EDITED,
    LOOK,
    MISSING,
    REJECTED,
    Reviewed,
)
from wayside.pipeline.reviewing.places import Places, image_key
from wayside.schemas.errors import InputError
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS
from wayside.stages.geometry import iou_matrix

_LEAST_IOU = 0.3
"""Of boxes that show the same: less than half of it may be missing, or as much beside it."""
_NEAR_M = 3.0
"""Farthest that a row without a common image may stand: between two supports, and more than a click on the map errs."""
Views = tuple[tuple[str, Any], ...]


@dataclass(frozen=True, slots=True)
class Undecided:
    """What a person has to decide, with the possible answers in words; each is what the review then says."""

    words: str
    """What is to be decided, and why."""
    options: tuple[tuple[str, Reviewed | None], ...]
    """None: nothing."""
    entries: tuple[Reviewed, ...]
    """As they were read."""


@dataclass(frozen=True, slots=True)
class Review:
    """What reviewers say of the rows of a result by `sign_id`, and of signs that are missing."""

    rows: Mapping[str, Reviewed]
    missing: tuple[Reviewed, ...]
    undecided: tuple[Undecided, ...] = ()
    carried: int = 0
    """How many of these were said of an earlier result."""
    gone: int = 0
    """How many rejected rows of an earlier result this one has no more."""

    @property
    def notes(self) -> list[str]:
        """What happened to reviews of earlier results and of several people, in words."""
        told = []
        if self.carried or self.gone:
            gone = f"; {_counted(self.gone, 'rejected row')} gone" if self.gone else ""
            told.append(f"of an earlier result, {_counted(self.carried)} carried over{gone}")
        if self.undecided:
            words = "; ".join(one.words for one in self.undecided)
            told.append(
                f"{_counted(len(self.undecided))} to be decided on the page of `wayside evidence`: {words}"
            )
        return told


def _counted(count: int, noun: str = "review") -> str:
    return f"{count} {noun} is" if count == 1 else f"{count} {noun}s are"


NO_REVIEW = Review({}, ())


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of a result as reviews know them."""

    result: str
    rows: Mapping[str, Reviewed]
    """What the acceptance of each row says, with its place and views; by `sign_id`."""
    places: Places

    @classmethod
    def of(cls, out: Path) -> Rows:
        """Those of a result; raises InputError if the folder is none, or damaged."""
        places, result = Places.of(out), result_name(read_run(out))
        frames = read_rows(out, FRAMES, ("frame", "log_time_ns", "image_name"))
        images = {row["frame"]: image_key(row) for row in frames}
        views: defaultdict[str, list[tuple[str, Any]]] = defaultdict(list)
        for row in read_rows(out, OBSERVATIONS, ("sign_id", "frame", "box"), {"verdict": "sign"}):
            box = tuple(round(edge, 1) for edge in row["box"])
            views[row["sign_id"]].append((images.get(row["frame"], ""), box))
        names = ("sign_id", "x", "y", "best_frame", "mutcd", "vienna", "legend", "color", "shape")
        rows = {
            row["sign_id"]: Reviewed(
                ACCEPTED,
                row["sign_id"],
                result,
                row["mutcd"] or row["vienna"],
                *(row[name] for name in LOOK[1:]),
                x=round(row["x"], 2),
                y=round(row["y"], 2),
                **places.anchor(row["x"], row["y"], row["best_frame"]),
                views=tuple(views[row["sign_id"]]),
            )
            for row in read_rows(out, SIGNS, names)
        }
        return cls(result, rows, places)


def settled(groups: Sequence[Sequence[Reviewed]], known: Rows, out: Path) -> Review:
    """One review of what several files say of a result, or of earlier ones.

    groups: the rows of each file. Raises InputError where a row is named that the result lacks, or nothing fits it.
    """
    found = _Settling(known, out)
    for number, entries in enumerate(groups):
        found.take(number, entries)
    return found.done()


@dataclass(slots=True)
class _Settling:
    """What is said so far."""

    known: Rows
    out: Path
    said: defaultdict[str, list[Reviewed]] = field(default_factory=lambda: defaultdict(list))
    missing: list[tuple[int, Reviewed]] = field(default_factory=list)
    """Each with the number of its file."""
    undecided: list[Undecided] = field(default_factory=list)
    carried: int = 0
    gone: int = 0

    def take(self, number: int, entries: Sequence[Reviewed]) -> None:
        """Add what a file says."""
        earlier = [one for one in entries if one.result not in ("", self.known.result)]
        found = _matched(earlier, self.known)
        rows = [one for one in earlier if one.sign_id]
        if rows and not found and not _same_drive(rows, self.known):
            raise InputError(
                f"{self.out}: a review is of another run, and nothing in it is found in this result: it is of another "
                "drive, or does not state places. Review the evidence of this result."
            )
        for index, one in enumerate(earlier):
            self._earlier(number, one, found.get(index))
        for one in entries:
            if one.result not in ("", self.known.result):
                continue
            if one.sign_id is None:
                self.missing.append((number, one))
            elif one.sign_id in self.known.rows:
                self.said[one.sign_id].append(one)
            else:
                raise InputError(f"a review: {self.out} has no sign {one.sign_id}; correct it")

    def _earlier(self, number: int, one: Reviewed, row: Reviewed | None) -> None:
        """Carry over what is said of an earlier result, if it is clear what it means for this one."""
        here = self.known.places.place(one)
        moved = replace(one, result=self.known.result)
        if here is not None:
            moved = replace(moved, x=round(here[0], 2), y=round(here[1], 2))
        stated = one.review != MISSING or any(one.look.values())
        alike = _agrees(one, row) if row is not None and stated else False
        if row is not None and (alike or one.review in (REJECTED, EDITED)):
            review = ACCEPTED if one.review == MISSING else one.review
            self.said[str(row.sign_id)].append(replace(_as_row(one, row), review=review))
            self.carried += 1
        elif one.review == MISSING and row is None and here is not None:
            self.missing.append((number, moved))
            self.carried += 1
        elif one.review == REJECTED:
            self.gone += 1
        else:
            self.undecided.append(_unmatched(one, moved, row))

    def done(self) -> Review:
        """What all files say together."""
        rows = {}
        for sign_id, ones in self.said.items():
            whole = [_as_row(one, self.known.rows[sign_id]) for one in ones]
            merged = self._merged(sign_id, whole, ones)
            if merged is not None:
                rows[sign_id] = merged
        missing = []
        for ones in _by_place(self.missing):
            where = f"missing at x {ones[0].x:.1f} m, y {ones[0].y:.1f} m"
            merged = self._merged(where, _completed(ones), ones)
            if merged is not None:
                missing.append(merged)
        return Review(rows, tuple(missing), tuple(self.undecided), self.carried, self.gone)

    def _merged(
        self, where: str, whole: Sequence[Reviewed], ones: Sequence[Reviewed]
    ) -> Reviewed | None:
        """What all say, with all of their remarks; None where they disagree, which is then to be decided."""
        if len({(one.review == REJECTED, *one.look.values()) for one in whole}) > 1:
            options = tuple((_opinion(one), one) for one in whole)
            self.undecided.append(Undecided(f"{where}: reviewers disagree", options, tuple(ones)))
            return None
        reviewers = ", ".join(dict.fromkeys(one.reviewer for one in ones if one.reviewer))
        notes = "; ".join(dict.fromkeys(one.note for one in ones if one.note))
        return replace(whole[0], reviewer=reviewers, note=notes)


def _as_row(one: Reviewed, row: Reviewed) -> Reviewed:
    """What is said, of this row of this result; a look that is not stated is the measured one."""
    look = {name: value or getattr(row, name) for name, value in one.look.items()}
    about = {"review": one.review, "note": one.note, "reviewer": one.reviewer}
    return replace(row, **about, **(row.look if one.review == REJECTED else look))


def _agrees(one: Reviewed, other: Reviewed) -> bool:
    """Whether no part of the look that both know differs."""
    return all(
        None in (a, b) or a == b
        for a, b in zip(one.look.values(), other.look.values(), strict=True)
    )


def _same_drive(entries: Sequence[Reviewed], known: Rows) -> bool:
    return any(image in known.places.images for one in entries for image, _ in one.views)


def _matched(entries: Sequence[Reviewed], known: Rows) -> dict[int, Reviewed]:
    """The row of this result that each entry of an earlier one is, by its index, one to one where the total is best."""
    listed = list(known.rows.values())
    if not entries or not listed:
        return {}
    by_image: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    for number, row in enumerate(listed):
        for image, box in row.views:
            by_image[image].append((number, box))
    same_drive = _same_drive(entries, known)
    score = np.array([_scores(one, listed, by_image, known, same_drive) for one in entries])
    pairs = zip(*linear_sum_assignment(score, maximize=True), strict=True)
    return {int(index): listed[number] for index, number in pairs if score[index, number] > 0}


def _scores(
    one: Reviewed,
    listed: Sequence[Reviewed],
    by_image: Mapping[str, list[tuple[int, Any]]],
    known: Rows,
    same_drive: bool,
) -> NDArray[np.float64]:
    """How well each row fits an entry: 1 to 2 by images, below 1 by its place, 0: not at all."""
    shared, alike = np.zeros(len(listed)), np.zeros(len(listed))
    for image, box in one.views:
        for number, other in by_image.get(image, ()):
            iou = float(iou_matrix(np.array([box]), np.array([other]))[0, 0])
            shared[number] += 1
            alike[number] += (1 + iou) * (iou >= _LEAST_IOU)
    score = alike / np.maximum(shared, 1)  # at least a half of the images show the same
    score = np.where(score >= 1.0, score, 0.0)
    seen = any(image in known.places.images for image, _ in one.views)
    if seen or (one.views and not same_drive) or one.x is None or one.y is None:
        return score
    place = known.places.place(one) or (one.x, one.y)
    away = np.array([np.hypot(row.x - place[0], row.y - place[1]) for row in listed])  # type: ignore[operator]
    near = np.array([_agrees(one, row) for row in listed]) & (away < _NEAR_M)
    return np.where(near, 1.0 - away / _NEAR_M, score)


def _unmatched(one: Reviewed, moved: Reviewed, row: Reviewed | None) -> Undecided:
    """What to ask about a sign that this result measured as another one, or did not find."""
    name = one.sign_id or "a missing sign"
    if row is not None and one.review == MISSING:
        words = f"a missing sign, {_words(one)}, is near {row.sign_id}, {_words(row)}, now"
        return Undecided(words, (("it is this one", row), ("it is still missing", moved)), (one,))
    if row is not None:
        words = f"{name} was {_words(one)} and is {row.sign_id}, {_words(row)}, now"
        kept = replace(_as_row(one, row), review=EDITED)
        options = ((f"it is {_words(one)}", kept), (f"it is {_words(row)}", row))
        return Undecided(words, options, (one,))
    words = f"{name}, {_words(one)}, is not in this result"
    as_missing = replace(moved, review=MISSING, sign_id=None, views=())
    return Undecided(words, (("it is missing", as_missing), ("leave it out", None)), (one,))


def _words(one: Reviewed) -> str:
    named = filter(None, (one.color, one.shape, one.code, one.legend))
    return " ".join(named).replace("_", " ") or "of unknown look"


def _opinion(one: Reviewed) -> str:
    look = "" if one.review == REJECTED else f" {_words(one)}"
    return f"{one.reviewer or 'somebody'}: {one.review}{look}"


def _by_place(found: Sequence[tuple[int, Reviewed]]) -> list[list[Reviewed]]:
    """Missing signs; those that several files have at one place together."""
    kept: list[dict[int, Reviewed]] = []
    for number, one in found:
        near = (
            ones
            for ones in kept
            if number not in ones and _apart(next(iter(ones.values())), one) < _NEAR_M
        )
        ones = next(near, None)
        if ones is None:
            kept.append({number: one})
        else:
            ones[number] = one
    return [list(ones.values()) for ones in kept]


def _apart(a: Reviewed, b: Reviewed) -> float:
    return math.hypot((a.x or 0.0) - (b.x or 0.0), (a.y or 0.0) - (b.y or 0.0))


def _completed(ones: Sequence[Reviewed]) -> list[Reviewed]:
    """Each with what the others state of the look and it does not."""
    stated = {name: next(filter(None, (getattr(o, name) for o in ones)), None) for name in LOOK}
    return [replace(o, **{n: v or stated[n] for n, v in o.look.items()}) for o in ones]
