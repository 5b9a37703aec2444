"""The page of one sign, the same as an image, and the index of all; no page needs another file but the sheets."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any, NamedTuple

import cv2
import numpy as np

from wayside.pipeline.code_words import SYSTEM_WORDS, code_of
from wayside.pipeline.evidence.crops import Crop, draw_crop
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView
from wayside.pipeline.evidence.maps import MAP_SIZE, overview, sign_maps
from wayside.pipeline.evidence.marks import (
    METRIC,
    UNKNOWN,
    Figure,
    Units,
    appearance_of,
    css,
    figures_of,
    route_words,
)
from wayside.pipeline.files.pictures import encoded, webp_address
from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.pages import render, render_page
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.landmarks import EVIDENCE_TERMS
from wayside.schemas.routes import MEASURE_UNITS
from wayside.schemas.sign_catalogue import CATALOGUE
from wayside.schemas.tables import SIGN_STATUSES


class Size(NamedTuple):
    """Pixels."""

    width: int
    height: int


WIDTH, TILES = 1600, 5
_MOST_IN_NOTEBOOK = 100
BIG, TILE = Size(752, 564), Size(280, 210)
PROPORTION = TILE.width / TILE.height
"""Width over height of every crop, large or small."""
LEFT, TOP = 48, 150
"""Of the large image on the sheet, pixels."""
_BELOW_BIG, _TERM, _BELOW_TERMS, _BELOW_MAPS = 106, 26, 70, 60
_BESIDE_TILE, _BELOW_TILE = 26, 48
_PNG_LEVEL = 1
Crops = Mapping[SignView, Crop]
"""Cut-outs of `PROPORTION`; a view without one is left empty and labelled so."""


def format_sheet(
    evidence: Evidence,
    crops: Crops,
    drive: DriveMap,
    run: Mapping[str, Any],
    mark: str,
    neighbours: Mapping[str, str],
    units: Units = METRIC,
) -> str:
    """The page of a sign, by which `is_marked` knows it again.

    `run`: content of `run.json`. `neighbours`: file names of other pages: `prev`, `up` and `next`; "" or absent: none.
    """

    def image(number: int | None, view: SignView) -> dict[str, Any]:
        if view not in crops:
            return {"source": ""}
        # enlarging twice shows all there is; the page shows a view small until it is clicked
        wide = min(BIG.width, max(2 * crops[view].rgb.shape[1], TILE.width))
        size = Size(wide, round(wide * BIG.height / BIG.width))
        return size._asdict() | {"source": webp_address(draw_crop(crops[view], size))}

    values = _values(evidence, drive, run, image, units)
    return render_page("sheet.html", mark, neighbours=neighbours, **values)


def draw_sheet(
    evidence: Evidence, crops: Crops, drive: DriveMap, run: Mapping[str, Any], units: Units = METRIC
) -> bytes:
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

    values = _values(evidence, drive, run, place, units)
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
    return encoded(rgb, ".png", cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL)


def _values(
    evidence: Evidence,
    drive: DriveMap,
    run: Mapping[str, Any],
    image: Callable[[int | None, SignView], dict[str, Any]],
    units: Units,
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
        "figures": figures_of(sign, str(run.get("world", "")), units),
        "terms": [(Figure(term.capitalize(), f"{ratio:+.1f}"), ratio) for term, ratio in weighed],
        "maps": sign_maps(evidence, drive, units),
        "views_heading": f"All {count} views" if count > 1 else "The only view",
        "best": _words(evidence.best, drive, units) | image(None, evidence.best),
        "views": [_words(v, drive, units) | image(i, v) for i, v in enumerate(evidence.views)],
    }


def _words(view: SignView, drive: DriveMap, units: Units) -> dict[str, str]:
    name, date = drive.images.get(view.frame, ("", ""))
    return {
        "frame": f"frame {view.frame}",
        "name": name,
        "date": date,
        "distance": "" if view.range_m is None else units.length(view.range_m),
        "residual": "" if view.residual_px is None else f"{view.residual_px:.2f} px",
    }


def format_index(
    signs: Sequence[Evidence],
    thumbs: Mapping[str, str],
    drive: DriveMap,
    about: dict[str, Any],
    mark: str,
    units: Units = METRIC,
) -> str:
    """HTML page that lists all signs, with a map and filters, and takes a review of them.

    `thumbs`: addresses of small images by sign id. `about`: what the script of the page knows: `log`, its name, the
    rows, the review and the cameras. `mark`: what the page is known by.
    """
    cards = _cards([one.sign for one in signs], thumbs)
    codes = [code_of(one.sign) for one in signs]
    looks = {name: [one.sign[name] for one in signs] for name in ("color", "shape", "status")}
    page_map, place = overview(drive, units) or (None, {})
    return render_page(
        "index.html",
        mark,
        log=about["log"],
        summary=_summary(looks["status"], drive, units),
        units=units,
        choices={
            "Colour": ("color", _counts(COLORS, looks["color"])),
            "Shape": ("shape", _counts(SHAPES, looks["shape"])),
            "Code": ("code", _counts(sorted({*filter(None, codes)}), codes)),
            "Status": ("status", _counts(SIGN_STATUSES, looks["status"])),
        },
        map=page_map,
        dots=_dots(cards),
        about=about | {"map": place},
        classes={"color": COLORS, "shape": SHAPES},
        catalogue=CATALOGUE,
        systems=SYSTEM_WORDS,
        cards=cards,
    )


def format_notebook(log: str, signs: Sequence[dict[str, Any]], drive: DriveMap) -> str:
    """HTML of the signs, rows of `signs.parquet`, for a notebook: a map and a table."""
    cards, (shown, _) = _cards(signs, {}), overview(drive) or (None, {})
    return render(
        "notebook.html",
        log=log,
        summary=_summary([sign["status"] for sign in signs], drive, METRIC),
        cards=cards,
        most=_MOST_IN_NOTEBOOK,
        map=shown,
        dots=_dots(cards),
    )


def _cards(signs: Sequence[dict[str, Any]], thumbs: Mapping[str, str]) -> list[dict[str, Any]]:
    return [
        {
            "sign": sign,
            "name": sign["sign_id"],
            "face": appearance_of(sign["color"], sign["shape"]),
            "code": code_of(sign) or UNKNOWN,
            "route": route_words(sign),
            "source": thumbs.get(sign["sign_id"], ""),
        }
        for sign in signs
    ]


def _dots(cards: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Name, title and ink of the signs on a map."""
    return [(c["name"], f"{c['name']}: {c['face']}", css(c["sign"]["color"])) for c in cards]


def _summary(statuses: Sequence[str], drive: DriveMap, units: Units) -> str:
    counts = Counter(statuses)
    others = [f", {counts[s]} {s}" for s in SIGN_STATUSES if s != "sign" and counts[s]]
    length = float(np.linalg.norm(np.diff(drive.path, axis=0), axis=1).sum())
    covered = f"{length / 1000:.2f} km" if length >= 1000 else f"{length:.0f} m"
    covered = covered if units is METRIC else f"{length / MEASURE_UNITS['mi']:.2f} mi"
    shown = f"{counted(counts['sign'], 'sign')}{''.join(others)} on {covered} of road"
    return f"{shown}, {counted(len(drive.cameras), 'image')}"


def _counts(known: Iterable[str], found: Sequence[str | None]) -> dict[str, int]:
    """How often each class occurs that does, in their order."""
    counts = Counter(name or UNKNOWN for name in found)
    return {name: counts[name] for name in (*known, UNKNOWN) if counts[name]}
