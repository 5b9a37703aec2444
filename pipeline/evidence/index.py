"""The index of all evidence sheets: one HTML file that needs nothing but the sheets in its folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.figures import UNKNOWN
from wayside.pipeline.evidence.gather import DriveMap, Evidence
from wayside.pipeline.evidence.maps import FOOT_PX, MARGIN_PX, Projection, fit
from wayside.pipeline.evidence.marks import appearance_of
from wayside.pipeline.pages import render_page
from wayside.pipeline.reviewing.review import COLUMNS as REVIEW_COLUMNS
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import SIGN_STATUSES

_MAP, _MAP_POINTS = (1200, 340), 1000


def format_index(
    signs: Sequence[Evidence],
    thumbs: Mapping[str, str],
    drive: DriveMap,
    about: dict[str, Any],
    mark: str,
) -> str:
    """HTML page that lists all signs, with a map and filters, and takes a review of them.

    Parameters
    ----------
    thumbs
        Addresses of small images by sign id.
    about
        `log`: its name; `result`: what tells this result from others of the log.
    mark
        What the page is known by.
    """
    cards = [
        {
            "sign": one.sign,
            "name": one.name,
            "face": appearance_of(one.sign["color"], one.sign["shape"]),
            "code": code_of(one.sign) or UNKNOWN,
            "source": thumbs.get(one.name, ""),
        }
        for one in signs
    ]
    codes = [code_of(one.sign) for one in signs]
    looks = {name: [one.sign[name] for one in signs] for name in ("color", "shape", "status")}
    page_map, place = _map(drive)
    return render_page(
        "index.html",
        mark,
        log=about["log"],
        summary=_summary(looks["status"], drive),
        choices={
            "Colour": ("color", _counts(COLORS, looks["color"])),
            "Shape": ("shape", _counts(SHAPES, looks["shape"])),
            "Code": ("code", _counts(sorted({*filter(None, codes)}), codes)),
            "Status": ("status", _counts(SIGN_STATUSES, looks["status"])),
        },
        map=page_map,
        about=about | {"columns": REVIEW_COLUMNS} | place,
        classes={"color": COLORS, "shape": SHAPES},
        cards=cards,
    )


def _summary(statuses: Sequence[str], drive: DriveMap) -> str:
    counts = Counter(statuses)
    others = [f", {counts[s]} {s}" for s in SIGN_STATUSES if s != "sign" and counts[s]]
    length = float(np.linalg.norm(np.diff(drive.path, axis=0), axis=1).sum())
    covered = f"{length / 1000:.2f} km" if length >= 1000 else f"{length:.0f} m"
    shown = f"{_counted(counts['sign'], 'sign')}{''.join(others)} on {covered} of road"
    return f"{shown}, {_counted(len(drive.cameras), 'image')}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _counts(known: Iterable[str], found: Sequence[str | None]) -> dict[str, int]:
    """How often each class occurs that does, in their order."""
    counts = Counter(name or UNKNOWN for name in found)
    return {name: counts[name] for name in (*known, UNKNOWN) if counts[name]}


def _map(drive: DriveMap) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """The path and every sign from above, from left to right, in pixels; None where there is nothing to show.

    Also what the page needs to know to place a sign on it.
    """
    points = np.concatenate([drive.path[:, :2], drive.signs[:, :2]])
    if not len(points):
        return None, {}
    to_map: Projection = fit(points, _MAP, 1.0, _to_the_right(drive.path[:, :2]))
    left, top = to_map.middle - to_map.extent / 2 - MARGIN_PX
    width, height = to_map.extent + np.array([2 * MARGIN_PX, MARGIN_PX + FOOT_PX])
    box = left, top, width, height
    thinned = drive.path[:: max(1, len(drive.path) // _MAP_POINTS)]
    shown = {
        "box": [round(float(edge)) for edge in box],
        "path": to_map(np.concatenate([thinned, drive.path[-1:]])).tolist(),
        "signs": to_map(drive.signs).tolist(),
        "foot": to_map.foot(box, drive.north),
    }
    x, y = to_map.centre + to_map.middle * [-1, 1] / to_map.scale
    corner = {"scale": to_map.scale, "left": float(x), "top": float(y)}
    return shown, {"map": {"turn": to_map.turn.tolist()} | corner}


def _to_the_right(camera_path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (2, 2) that turns rows x, y so that the farthest point of a path lies to the right of its start."""
    away = camera_path - camera_path[:1]
    x, y = away[np.argmax(np.linalg.norm(away, axis=1))] if len(camera_path) else (0.0, 0.0)
    length = float(np.hypot(x, y))
    return np.array([[x, -y], [y, x]]) / length if length > 0 else np.eye(2)
