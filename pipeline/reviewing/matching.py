"""Reviews of a result or of earlier ones, by one person or several, as one review of the result that there is.

A row of an earlier result is the row of this one that shows the same thing: in most images that both know, their boxes
show the same. Without such an image it is the nearest row of the same look. Each row is taken once. What agrees is
carried over; all else is left to a person.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from wayside.pipeline.reviewing.entries import (
    ACCEPTED,
    EDITED,
    LOOK,
    MISSING,
    REJECTED,
    UNKNOWN,
    Reviewed,
)
from wayside.pipeline.reviewing.known import KnownResult
from wayside.schemas.errors import InputError
from wayside.schemas.sign_catalogue import SERIES
from wayside.stages.geometry import iou_matrix
from wayside.stages.kernels import Array

_LEAST_IOU = 0.3
"""Of boxes that show the same: less than half of it may be missing, or as much beside it."""
_NEAR_M = 3.0
"""Farthest that a row without a common image may stand: nearer than most supports, farther than a click errs."""
_LISTED = 5
"""Of what is to be decided in a note; the page has all."""
_SERIES = {code for system in SERIES.values() for code in system}
Option = tuple[str, Reviewed | None]


@dataclass(frozen=True, slots=True)
class Undecided:
    """What a person has to decide."""

    words: str
    """What it is about, and why."""
    options: tuple[Option, ...]
    """Answers in words, and what the review then says; None: nothing."""
    entries: tuple[Reviewed, ...]
    """As they were read."""


@dataclass(frozen=True, slots=True)
class Review:
    """What reviewers say of the rows of a result by `sign_id`, and of signs that are missing."""

    rows: Mapping[str, Reviewed]
    missing: tuple[Reviewed, ...]
    undecided: tuple[Undecided, ...] = ()
    carried: int = 0
    """How many were said of an earlier result."""
    gone: int = 0
    """How many rejected rows of an earlier result this one does not have."""

    @property
    def notes(self) -> list[str]:
        """What became of reviews of earlier results and of several people, in words."""
        carried = f"{self.carried} carried over from an earlier result"
        if self.gone:
            carried += f"; {self.gone} rejected there no longer exist here"
        words = "; ".join(one.words for one in self.undecided[:_LISTED])
        words += "; ..." if len(self.undecided) > _LISTED else ""
        waiting = f"{len(self.undecided)} to decide on the page of `wayside evidence`: {words}"
        told = {carried: self.carried or self.gone, waiting: self.undecided}
        return [f"reviews: {words}" for words, counted in told.items() if counted]


NO_REVIEW = Review({}, ())


def settled(groups: Sequence[Sequence[Reviewed]], known: KnownResult) -> Review:
    """One review of what several files say; raises InputError where a row is named that the result does not have.

    `groups`: the rows of each file.
    """
    found = _Settling(known)
    for number, entries in enumerate(groups):
        found.take(number, entries)
    rows: dict[str, Reviewed] = {}
    missing: list[Reviewed] = []
    for sign_id, said in found.said.items():
        merged = found.merged(sign_id, [_of_row(one, known.rows[sign_id]) for one in said], said)
        rows |= {sign_id: merged} if merged else {}
    for said in _by_place(found.missing):
        where = f"missing at x {said[0].x:.1f} m, y {said[0].y:.1f} m"
        merged = found.merged(where, said, said)
        missing += [merged] if merged else []
    asked: dict[str, Undecided] = {}
    for one in found.undecided:  # the same question of several people once
        before = asked[one.words].entries if one.words in asked else ()
        asked[one.words] = replace(one, entries=(*before, *one.entries))
    return Review(rows, tuple(missing), tuple(asked.values()), found.carried, found.gone)


@dataclass(slots=True)
class _Settling:
    """The reviews so far."""

    known: KnownResult
    said: defaultdict[str, list[Reviewed]] = field(default_factory=lambda: defaultdict(list))
    missing: list[tuple[int, Reviewed]] = field(default_factory=list)
    """Each with the number of its file."""
    undecided: list[Undecided] = field(default_factory=list)
    carried: int = 0
    gone: int = 0

    def take(self, number: int, entries: Sequence[Reviewed]) -> None:
        """Add what a file says, of this result and of earlier ones."""
        for result in dict.fromkeys(one.result for one in entries):
            some = [one for one in entries if one.result == result]
            if result in ("", self.known.name):
                unknown = {one.sign_id for one in some} - {None, *self.known.rows}
                if unknown:
                    raise InputError(f"a review: there is no sign {min(map(str, unknown))}")
                for one in some:
                    self._add(number, one)
                continue
            # two people may have said something of one row
            of_row = {one.sign_id or (one.x, one.y): one for one in some}
            found = dict(zip(of_row, _matched(list(of_row.values()), self.known), strict=True))
            known = any(found[one.sign_id] for one in some if one.sign_id)
            if not known and any(one.sign_id for one in some) and not _same_drive(some, self.known):
                raise InputError(
                    "the review is of another run, and nothing in it is found in this result: it is from "
                    "another drive, or has no positions. Review the evidence of this result."
                )
            for one in some:
                self._carry(number, one, found[one.sign_id or (one.x, one.y)])

    def _add(self, number: int, one: Reviewed) -> None:
        if one.sign_id is None:
            self.missing.append((number, one))
        else:
            self.said[one.sign_id].append(one)

    def _carry(self, number: int, one: Reviewed, row: Reviewed | None) -> None:
        """Take over a review of an earlier result, if its meaning for this one is clear."""
        here, moved = self.known.place(one), replace(one, result=self.known.name)
        if here is not None:
            moved = replace(moved, x=here[0], y=here[1])
        again = None
        stated = one.review != MISSING or any(one.look.values())
        alike = row is not None and _agrees(one, row) and stated
        if row is not None and (alike or one.review in (REJECTED, EDITED)):
            again = _of_row(one, row)
        elif row is None and one.review == MISSING and here is not None:
            again = moved
        if again is not None:
            self._add(number, again)
            self.carried += 1
        elif row is None and one.review == REJECTED:
            self.gone += 1
        else:
            self.undecided.append(_question(one, moved, row))

    def merged(
        self, where: str, whole: Sequence[Reviewed], said: Sequence[Reviewed]
    ) -> Reviewed | None:
        """What all say, with all of their remarks; None where they disagree, which is then to be decided."""
        stated = [{one.look.get(name) for one in whole} - {None} for name in LOOK]
        if len({one.review == REJECTED for one in whole}) > 1 or max(map(len, stated)) > 1:
            options = tuple(
                (f"{one.reviewer or 'somebody'}: {one.review}, {_words(one)}", one) for one in whole
            )
            self.undecided.append(Undecided(f"{where}: reviewers disagree", options, tuple(said)))
            return None
        look = {name: next(iter(values), None) for name, values in zip(LOOK, stated, strict=True)}
        reviewers = ", ".join(dict.fromkeys(one.reviewer for one in said if one.reviewer))
        notes = "; ".join(dict.fromkeys(one.note for one in said if one.note))
        return replace(whole[0], look=look, reviewer=reviewers, note=notes)


def _of_row(one: Reviewed, row: Reviewed) -> Reviewed:
    """The review of this row of this result; a look that is not stated is the measured one."""
    look = row.look
    if one.review != REJECTED:
        look = {name: one.look.get(name) or row.look[name] for name in LOOK}
    review = ACCEPTED if one.review == MISSING else one.review
    return replace(row, review=review, look=look, note=one.note, reviewer=one.reviewer)


def _agrees(one: Reviewed, row: Reviewed) -> bool:
    """Whether the look that is stated is the measured one, as far as both are known."""
    pairs = [(one.look.get(name), row.look[name]) for name in LOOK]
    known = [(a, b) for a, b in pairs if a and b and a != UNKNOWN]
    return all(_same(a, b) or _same(b, a) for a, b in known)


def _same(part: str, whole: str) -> bool:
    """Whether two words are one, or the second is a series of codes and the first a code of it."""
    series = whole.split("/") if whole in _SERIES else ()
    return part == whole or part.startswith(tuple(series))


def _same_drive(entries: Sequence[Reviewed], known: KnownResult) -> bool:
    return any(image in known.cameras for one in entries for image, _ in one.views)


def _matched(entries: Sequence[Reviewed], known: KnownResult) -> list[Reviewed | None]:
    """The row of this result that each row of an earlier one is, one to one where the total is best."""
    rows = list(known.rows.values())
    found: list[Reviewed | None] = [None] * len(entries)
    by_image: defaultdict[str, list[tuple[int, Any]]] = defaultdict(list)
    for number, row in enumerate(rows):
        for image, box in row.views:
            by_image[image].append((number, box))
    score = np.stack([_by_image(one, by_image, len(rows)) for one in entries])
    by_place = _same_drive(entries, known) or not any(one.views for one in entries)
    for index, one in enumerate(entries):
        if by_place and not any(image in known.cameras for image, _ in one.views):
            x, y = known.place(one) or (math.nan if z is None else z for z in (one.x, one.y))
            for number, row in enumerate(rows):
                away = math.hypot((row.x or 0.0) - x, (row.y or 0.0) - y)
                if away < _NEAR_M and _agrees(one, row):
                    score[index, number] = 1 - away / _NEAR_M
    for which, row_number in zip(*linear_sum_assignment(score, maximize=True), strict=True):
        found[which] = rows[row_number] if score[which, row_number] > 0 else None
    return found


def _by_image(one: Reviewed, by_image: Mapping[str, list[tuple[int, Any]]], rows: int) -> Array:
    """How well each row fits: 1 to 2 where at least half of the images that both have show the same, else 0."""
    shared, alike = np.zeros(rows), np.zeros(rows)
    for image, box in one.views:
        for number, other in by_image.get(image, ()):
            iou = float(iou_matrix(np.array([box]), np.array([other]))[0, 0])
            shared[number] += 1
            alike[number] += (1 + iou) * (iou >= _LEAST_IOU)
    score = alike / np.maximum(shared, 1)
    return np.where(score >= 1, score, 0.0)


def _question(one: Reviewed, moved: Reviewed, row: Reviewed | None) -> Undecided:
    """What to ask about a sign that this result measured as another one, did not find, or may have found."""
    name = f"{one.sign_id or 'a missing sign'} ({_words(one)})"
    still: Option = ("it is missing", replace(moved, review=MISSING, sign_id=None, views=()))
    if row is None:
        return Undecided(f"{name} is not in this result", (still, ("leave it out", None)), (one,))
    if one.sign_id is not None:
        still = (f"it is {_words(one)}", replace(_of_row(one, row), review=EDITED))
    taken = (f"it is {row.sign_id} as measured", row)
    return Undecided(f"{name} may be {row.sign_id} ({_words(row)})", (taken, still), (one,))


def _words(one: Reviewed) -> str:
    named = filter(None, (one.look.get(name) for name in ("color", "shape", "code", "legend")))
    return " ".join(named).replace("_", " ") or "of unknown look"


def _by_place(found: Sequence[tuple[int, Reviewed]]) -> list[list[Reviewed]]:
    """Missing signs; those that several files have at one place together."""
    kept: list[dict[int, Reviewed]] = []
    for number, one in found:
        for ones in kept:
            first = next(iter(ones.values()))
            away = math.hypot((one.x or 0) - (first.x or 0), (one.y or 0) - (first.y or 0))
            if number not in ones and away < _NEAR_M:
                ones[number] = one
                break
        else:
            kept.append({number: one})
    return [list(ones.values()) for ones in kept]
