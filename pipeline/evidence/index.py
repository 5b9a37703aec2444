"""The index of all evidence sheets: one HTML file that needs nothing but the sheets in its folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.figures import UNKNOWN
from wayside.pipeline.evidence.gather import DriveMap
from wayside.pipeline.evidence.maps import FOOT_PX, MARGIN_PX, Projection, fit
from wayside.pipeline.evidence.marks import appearance_of
from wayside.pipeline.files.webp import data_address
from wayside.pipeline.pages import render_page
from wayside.pipeline.reviewing.review import COLUMNS as REVIEW_COLUMNS
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import SIGN_STATUSES

_MAP, _MAP_POINTS = (1200, 340), 1000


@dataclass(frozen=True, slots=True)
class Card:
    """One sign of the index: its row, the file name of its sheet, and a small image as WebP or None."""

    sign: dict[str, Any]
    sheet: str
    thumb: bytes | None

    @property
    def name(self) -> str:
        """The sign's id."""
        return str(self.sign["sign_id"])

    @property
    def face(self) -> str:
        """Colour and shape in words."""
        return appearance_of(self.sign["color"], self.sign["shape"])

    @property
    def code(self) -> str:
        """Of the sign, or that it is not known."""
        return code_of(self.sign) or UNKNOWN

    @property
    def source(self) -> str:
        """Address of the small image, or an empty text."""
        return "" if self.thumb is None else data_address(self.thumb)


def format_index(cards: Sequence[Card], drive: DriveMap, log: str, result: str, mark: str) -> str:
    """HTML page that lists all signs, with a map and filters, and takes a review of them.

    Parameters
    ----------
    cards, drive
        What it shows.
    log
        Its name.
    result
        What tells this result from others of the log.
    mark
        What the page is known by.
    """
    to_map = _projection(drive)
    about = {"log": log, "result": result, "columns": REVIEW_COLUMNS}
    signs = [card.sign for card in cards]
    codes = [code_of(sign) for sign in signs]
    return render_page(
        "index.html",
        mark,
        log=log,
        summary=_summary(cards, drive),
        choices={
            "Colour": ("color", _counts(COLORS, [sign["color"] for sign in signs])),
            "Shape": ("shape", _counts(SHAPES, [sign["shape"] for sign in signs])),
            "Code": ("code", _counts(sorted({*filter(None, codes)}), codes)),
            "Status": ("status", _counts(SIGN_STATUSES, [sign["status"] for sign in signs])),
        },
        map=None if to_map is None else _map(drive, to_map),
        about=about if to_map is None else about | {"map": _place_of_map(to_map)},
        classes={"color": COLORS, "shape": SHAPES},
        cards=cards,
    )


def _summary(cards: Sequence[Card], drive: DriveMap) -> str:
    counts = Counter(str(card.sign["status"]) for card in cards)
    others = "".join(
        f", {counts[name]} {name}" for name in SIGN_STATUSES if name != "sign" and counts[name]
    )
    length = float(np.linalg.norm(np.diff(drive.path, axis=0), axis=1).sum())
    covered = f"{length / 1000:.2f} km" if length >= 1000 else f"{length:.0f} m"
    road = f"on {covered} of road, {_counted(len(drive.cameras), 'image')}"
    return f"{_counted(counts['sign'], 'sign')}{others} {road}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _counts(known: Iterable[str], found: Sequence[str | None]) -> dict[str, int]:
    """How often each class occurs that does, in their order."""
    counts = Counter(name or UNKNOWN for name in found)
    return {name: counts[name] for name in (*known, UNKNOWN) if counts[name]}


def _projection(drive: DriveMap) -> Projection | None:
    """The map turned to run from left to right; None where there is nothing on it."""
    points = np.concatenate([drive.path[:, :2], drive.signs[:, :2]])
    return fit(points, _MAP, 1.0, _to_the_right(drive.path[:, :2])) if len(points) else None


def _map(drive: DriveMap, to_map: Projection) -> dict[str, Any]:
    """The path and every sign from above, in pixels, on a page no higher than they need."""
    left, top = to_map.middle - to_map.extent / 2 - MARGIN_PX
    width, height = to_map.extent + np.array([2 * MARGIN_PX, MARGIN_PX + FOOT_PX])
    box = left, top, width, height
    thinned = drive.path[:: max(1, len(drive.path) // _MAP_POINTS)]
    return {
        "box": [round(float(edge)) for edge in box],
        "path": to_map(np.concatenate([thinned, drive.path[-1:]])).tolist(),
        "signs": to_map(drive.signs).tolist(),
        "foot": to_map.foot(box, drive.north),
    }


def _place_of_map(to_map: Projection) -> dict[str, Any]:
    """What the page needs to know of the map to place a sign on it."""
    left, top = to_map.centre + to_map.middle * [-1, 1] / to_map.scale
    turn = to_map.turn.tolist()
    return {"turn": turn, "scale": to_map.scale, "left": float(left), "top": float(top)}


def _to_the_right(camera_path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (2, 2) that turns rows x, y so that the farthest point of a path lies to the right of its start."""
    away = camera_path - camera_path[:1]
    x, y = away[np.argmax(np.linalg.norm(away, axis=1))] if len(camera_path) else (0.0, 0.0)
    length = float(np.hypot(x, y))
    return np.array([[x, -y], [y, x]]) / length if length > 0 else np.eye(2)
