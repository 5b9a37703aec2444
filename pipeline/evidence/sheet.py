"""The page of one sign, the same as an image, and the index of all; no page needs another file but the sheets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.crops import Crop, draw_crop
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView
from wayside.pipeline.evidence.maps import FOOT_PX, MAP_SIZE, MARGIN_PX, Projection, fit, sign_maps
from wayside.pipeline.evidence.marks import UNKNOWN, Figure, appearance_of, figures_of
from wayside.pipeline.files.pictures import data_address, encode_png, encode_webp
from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.pages import render, render_page
from wayside.pipeline.reviewing.review import COLUMNS as REVIEW_COLUMNS
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.tables import SIGN_STATUSES

_MAP, _MAP_POINTS = (1200, 340), 1000


class Size(NamedTuple):
    """Pixels."""

    width: int
    height: int


WIDTH, TILES = 1600, 5
BIG, TILE = Size(752, 564), Size(280, 210)
PROPORTION = TILE.width / TILE.height
"""Width over height of every crop, large or small."""
LEFT, TOP = 48, 150
"""Of the large image on the sheet, pixels."""
_BELOW_BIG, _TERM, _BELOW_TERMS, _BELOW_MAPS = 106, 26, 70, 60
_BESIDE_TILE, _BELOW_TILE = 26, 48
Crops = Mapping[SignView, Crop]
"""Cut-outs of `PROPORTION`; a view without one is left empty and labelled so."""


def format_sheet(
    evidence: Evidence,
    crops: Crops,
    drive: DriveMap,
    run: Mapping[str, Any],
    mark: str,
    neighbours: Mapping[str, str],
) -> str:
    """The page of a sign, by which `is_marked` knows it again.

    `run`: content of `run.json`. `neighbours`: file names of other pages: `prev`, `up` and `next`, where there are any.
    """

    def image(number: int | None, view: SignView) -> dict[str, Any]:
        if view not in crops:
            return {"source": ""}
        size = BIG if number is None else TILE
        # enlarging twice shows all there is
        wide = min(size.width, max(2 * crops[view].rgb.shape[1], TILE.width))
        size = Size(wide, round(wide * size.height / size.width))
        return size._asdict() | {"source": data_address(encode_webp(draw_crop(crops[view], size)))}

    values = _values(evidence, drive, run, image)
    return render_page("sheet.html", mark, neighbours=neighbours, **values)


def draw_sheet(evidence: Evidence, crops: Crops, drive: DriveMap, run: Mapping[str, Any]) -> bytes:
    """The sheet of a sign, `WIDTH` wide, as PNG; parameters as in `format_sheet`.

    The images are put in afterwards: drawing and compressing them as a part of the SVG takes twice as long as all else.
    """
    import resvg_py

    middle = TOP + BIG.height + _BELOW_BIG + _TERM * len(EVIDENCE_TERMS) + _BELOW_TERMS
    bottom = middle + MAP_SIZE[1] + _BELOW_MAPS
    images = []

    def place(number: int | None, view: SignView) -> dict[str, Any]:
        size, x, y = BIG, LEFT, TOP
        if number is not None:
            size = TILE
            x += number % TILES * (size.width + _BESIDE_TILE)
            y = bottom + number // TILES * (size.height + _BELOW_TILE)
        if view in crops:
            images.append((x, y, draw_crop(crops[view], size)))
        return {"x": x, "y": y, "size": size, "source": view in crops}

    values = _values(evidence, drive, run, place)
    fonts = files("font_source_sans_pro").joinpath("files")
    weights = ("Regular", "Semibold", "Bold")
    drawn = resvg_py.svg_to_bytes(
        svg_string=render(
            "sheet.svg", width=WIDTH, left=LEFT, middle=middle, bottom=bottom, **values
        ),
        skip_system_fonts=True,
        font_files=[str(fonts.joinpath(f"SourceSansPro-{weight}.ttf")) for weight in weights],
    )
    rgb = np.asarray(cv2.imdecode(np.frombuffer(drawn, np.uint8), cv2.IMREAD_COLOR_RGB), np.uint8)
    for x, y, image in images:
        rgb[y : y + image.shape[0], x : x + image.shape[1]] = image
    return encode_png(rgb)


def _values(
    evidence: Evidence,
    drive: DriveMap,
    run: Mapping[str, Any],
    image: Callable[[int | None, SignView], dict[str, Any]],
) -> dict[str, Any]:
    """What both templates of a sheet show; `image`: how the best view (None) or that of a number is shown."""
    sign, count = evidence.sign, len(evidence.views)
    frame = evidence.best.frame
    name, when = drive.images.get(frame, ("", ""))
    if not name:  # imported images have their own dates or none: their log times are counted
        seconds = drive.log_times_ns[frame] // 1_000_000_000
        when = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    ratios = [(term, sign.get(f"evidence_{term}")) for term in EVIDENCE_TERMS]
    weighed = [(term, ratio) for term, ratio in ratios if ratio is not None]
    return {
        "name": evidence.name,
        "sign": sign,
        "look": f"{appearance_of(sign['color'], sign['shape'])}, status {sign['status']}",
        "confidence": UNKNOWN if sign["confidence"] is None else f"{sign['confidence']:.2f}",
        "log": str(run.get("log", "")),
        "when": when,
        "figures": figures_of(sign, str(run.get("world", ""))),
        "terms": [(Figure(term.capitalize(), f"{ratio:+.1f}"), ratio) for term, ratio in weighed],
        "maps": sign_maps(evidence, drive),
        "views_heading": f"All {count} views" if count > 1 else "The only view",
        "best": _words(evidence.best, drive) | image(None, evidence.best),
        "views": [_words(v, drive) | image(i, v) for i, v in enumerate(evidence.views)],
    }


def _words(view: SignView, drive: DriveMap) -> dict[str, str]:
    name, date = drive.images.get(view.frame, ("", ""))
    return {
        "frame": f"frame {view.frame}",
        "name": name,
        "date": date,
        "distance": "" if view.range_m is None else f"{view.range_m:.1f} m",
        "residual": "" if view.residual_px is None else f"{view.residual_px:.2f} px",
    }


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
    shown = f"{counted(counts['sign'], 'sign')}{''.join(others)} on {covered} of road"
    return f"{shown}, {counted(len(drive.cameras), 'image')}"


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
