"""What to ask a person about: landmarks and single boxes of a result, those first that teach the most.

Things that a classifier is unsure of teach the most (uncertainty sampling: Lewis and Gale 1994). They are sorted by the
distance of their score from the threshold. Landmarks come before single boxes: one answer labels all their images.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from wayside.pipeline.labels.box_matching import overlap
from wayside.pipeline.results.result import read_rows, read_table
from wayside.schemas.labels import Box
from wayside.schemas.tables import OBSERVATIONS, SIGNS
from wayside.stages.geometry import box_areas

_COLUMNS = (
    *("frame", "observation_id", "box", "color", "shape", "track_id", "sign_id", "verdict"),
    *("source", "score", "color_distance", "shape_distance"),
)
_CERTAIN = 0.9999


@dataclass(frozen=True, slots=True)
class View:
    """A box (x0, y0, x1, y1, half open, pixels) in an image."""

    frame: int
    box: Box


@dataclass(frozen=True, slots=True)
class Item:
    """One thing to ask about.

    `name`: `sign_id` of a reported row, `landmark N` or `box N`. `views`: its boxes, at least one. `color`, `shape`: as
    the run named them. `margin`: score minus threshold, nan where there is neither.
    """

    name: str
    views: tuple[View, ...]
    color: str | None
    shape: str | None
    margin: float

    @property
    def shown(self) -> View:
        """The largest view."""
        return self.views[_largest(self.views)]


@dataclass(frozen=True, slots=True)
class Questions:
    """Items in the order to ask; left_out: single boxes beyond the number wanted."""

    items: tuple[Item, ...]
    left_out: int


def questions(out: Path, most: int) -> Questions:
    """What to ask about the result in a folder.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    most
        How many single boxes at most; landmarks are all asked about.

    Raises
    ------
    InputError
        The folder is no result folder, or damaged.
    """
    table = read_table(out, OBSERVATIONS, _COLUMNS)
    margin = margins(table)
    names = ("sign_id", "confidence", "color", "shape", "status")
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, names)}
    landmarks = sorted(_landmarks(table, margin, signs), key=_urgency)
    taken: defaultdict[int, list[Box]] = defaultdict(list)
    for item in landmarks:
        for view in item.views:
            taken[view.frame].append(view.box)
    boxes, left_out = _single_boxes(table, margin, taken, most)
    return Questions((*landmarks, *boxes), left_out)


def margins(table: pa.Table) -> NDArray[np.float64]:
    """How far each observation (n,) is above the threshold that its gate has, nan where none has judged it.

    The gate is the classifier of boxes, else (preset `report`) the outline: the worst that it let pass tells its
    threshold. Predicted boxes are not asked.
    """
    verdict = np.array(table["verdict"].to_pylist(), object)
    asked = np.array(table["source"].to_pylist(), object) != "predicted"
    score = table["score"].to_numpy()
    refusal = "score"
    if np.isnan(score).all():
        score, refusal = -table["shape_distance"].to_numpy(), "shape"
    margin = np.full(len(verdict), np.nan)
    known = np.isfinite(score)
    classes = (
        [np.ones(len(verdict), np.bool_)]
        if refusal == "score"
        else [
            np.array(table["shape"].to_pylist(), object) == name
            for name in table["shape"].unique().to_pylist()
        ]
    )
    for own in classes:
        passed = own & known & asked & (verdict != refusal) & (verdict != "color")
        worst = score[passed].min() if passed.any() else score[own & known].max(initial=-np.inf)
        margin[own & known] = score[own & known] - worst
    return margin


def _landmarks(
    table: pa.Table, margin: NDArray[np.float64], signs: dict[str, dict[str, object]]
) -> Iterator[Item]:
    kinds = np.array(table["verdict"].to_pylist(), object)
    own = table["track_id"].is_valid().to_numpy() & (kinds != "overlap")
    tracked = table.append_column("margin", pa.array(margin)).filter(pa.array(own))
    tracks = defaultdict(list)
    for row in tracked.to_pylist():
        tracks[row["track_id"]].append(row)
    for track, rows in tracks.items():
        views = tuple(View(row["frame"], tuple(row["box"])) for row in rows)
        sign = signs.get(rows[0]["sign_id"])
        known = [row["margin"] for row in rows if math.isfinite(row["margin"])]
        largest = rows[_largest(views)]
        color, shape, best = largest["color"], largest["shape"], max(known, default=math.nan)
        name = f"landmark {track}"
        if sign is not None:
            color, shape = sign["color"], sign["shape"]
            name = rows[0]["sign_id"]
            if isinstance(sign["confidence"], float):
                probability = min(max(sign["confidence"], 1 - _CERTAIN), _CERTAIN)
                best = math.log(probability / (1 - probability))
        yield Item(name, views, color, shape, best)


def _single_boxes(
    table: pa.Table, margin: NDArray[np.float64], taken: dict[int, list[Box]], most: int
) -> tuple[list[Item], int]:
    """The boxes nearest to the threshold that overlap neither each other nor what is `taken` in their image."""
    verdict = np.array(table["verdict"].to_pylist(), object)
    single = table["track_id"].is_null().to_numpy() & (verdict != "overlap")
    rows = np.flatnonzero(single)
    distance = np.where(np.isfinite(margin[rows]), np.abs(margin[rows]), np.inf)
    rows = rows[np.argsort(distance, kind="stable")]
    frame = table["frame"].to_numpy()
    box = np.asarray(pc.list_flatten(table["box"]), np.float64).reshape(-1, 4)
    chosen: list[Item] = []
    for looked, row in enumerate(rows.tolist()):
        if len(chosen) >= most:
            return chosen, len(rows) - looked
        here = taken.setdefault(int(frame[row]), [])
        own = box[row]
        if overlap(np.array(here).reshape(-1, 4), own).any():
            continue  # another view of what is asked about
        x0, y0, x1, y1 = own.tolist()
        here.append((x0, y0, x1, y1))
        values = table.slice(row, 1).to_pylist()[0]
        chosen.append(
            Item(
                f"box {values['observation_id']}",
                (View(int(frame[row]), (x0, y0, x1, y1)),),
                values["color"],
                values["shape"],
                float(margin[row]),
            )
        )
    return chosen, 0


def _largest(views: Sequence[View]) -> int:
    return int(np.argmax(box_areas(np.array([view.box for view in views], np.float64))))


def _urgency(item: Item) -> tuple[float, str]:
    return (abs(item.margin) if math.isfinite(item.margin) else math.inf, item.name)
