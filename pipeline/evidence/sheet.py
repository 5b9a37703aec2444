"""The evidence of one sign: a page that needs no other file, and the same as an image, to print or to send."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any, NamedTuple

from wayside.pipeline.evidence.crops import Crop, draw_crop
from wayside.pipeline.evidence.figures import UNKNOWN, evidence_terms, figures_of
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView
from wayside.pipeline.evidence.maps import sign_maps
from wayside.pipeline.evidence.marks import appearance_of
from wayside.pipeline.files.webp import data_address, encode_png, encode_webp
from wayside.pipeline.pages import render, render_page
from wayside.schemas.landmarks import EVIDENCE_TERMS


class Size(NamedTuple):
    """Pixels."""

    width: int
    height: int


WIDTH, TILES = 1600, 5
BIG, TILE = Size(752, 564), Size(280, 210)
PROPORTION = TILE.width / TILE.height
"""Width over height of every crop, large or small."""


def format_sheet(
    evidence: Evidence,
    crops: Mapping[SignView, Crop],
    drive: DriveMap,
    run: Mapping[str, Any],
    mark: str,
    neighbours: Mapping[str, str],
) -> str:
    """The page of a sign.

    Parameters
    ----------
    evidence, drive
        What the tables say.
    crops
        Cut-outs of `PROPORTION` by view; a view without one is left empty and labelled so.
    run
        Content of `run.json`.
    mark
        What the page is known by.
    neighbours
        File names of other pages: `prev`, `up` and `next`, as many as there are.
    """
    values = _values(evidence, crops, drive, run)
    return render_page("sheet.html", mark, neighbours=neighbours, **values)


def draw_sheet(
    evidence: Evidence, crops: Mapping[SignView, Crop], drive: DriveMap, run: Mapping[str, Any]
) -> bytes:
    """The sheet of a sign, `WIDTH` wide, as PNG; parameters as in `format_sheet`."""
    import resvg_py

    values = _values(evidence, crops, drive, run, whole=True)
    fonts = files("font_source_sans_pro").joinpath("files")
    weights = ("Regular", "Semibold", "Bold")
    return resvg_py.svg_to_bytes(
        svg_string=render(
            "sheet.svg",
            width=WIDTH,
            tiles=TILES,
            big=BIG,
            tile=TILE,
            terms_count=len(EVIDENCE_TERMS),
            **values,
        ),
        skip_system_fonts=True,
        font_files=[str(fonts.joinpath(f"SourceSansPro-{weight}.ttf")) for weight in weights],
    )


def _values(
    evidence: Evidence,
    crops: Mapping[SignView, Crop],
    drive: DriveMap,
    run: Mapping[str, Any],
    *,
    whole: bool = False,
) -> dict[str, Any]:
    """What the templates of a sheet show; whole: crops in their full size and quality."""
    sign, count = evidence.sign, len(evidence.views)
    frame = evidence.best.frame
    name, when = drive.images.get(frame, ("", ""))
    if not name:  # imported images have their own dates or none: their log times are counted
        seconds = drive.log_times_ns[frame] // 1_000_000_000
        when = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    return {
        "name": evidence.name,
        "sign": sign,
        "look": f"{appearance_of(sign['color'], sign['shape'])}, status {sign['status']}",
        "confidence": UNKNOWN if sign["confidence"] is None else f"{sign['confidence']:.2f}",
        "log": str(run.get("log", "")),
        "when": when,
        "figures": figures_of(sign, str(run.get("world", ""))),
        "terms": [
            {"label": term.capitalize(), "value": f"{ratio:+.1f}", "ratio": ratio, "remark": ""}
            for term, ratio in evidence_terms(sign)
        ],
        "maps": sign_maps(evidence, drive),
        "views_heading": f"All {count} views" if count > 1 else "The only view",
        "best": _view(evidence.best, crops, BIG, drive, whole=whole),
        "views": [_view(view, crops, TILE, drive, whole=whole) for view in evidence.views],
    }


def _view(
    view: SignView,
    crops: Mapping[SignView, Crop],
    size: Size,
    drive: DriveMap,
    *,
    whole: bool,
) -> dict[str, Any]:
    """A view in words and, where there is a crop of it, as an image that a page can hold."""
    name, date = drive.images.get(view.frame, ("", ""))
    shown: dict[str, Any] = {
        "frame": f"frame {view.frame}",
        "name": name,
        "date": date,
        "distance": "" if view.range_m is None else f"{view.range_m:.1f} m",
        "residual": "" if view.residual_px is None else f"{view.residual_px:.2f} px",
        "source": "",
    }
    crop = crops.get(view)
    if crop is None:
        return shown
    wide = size.width
    if not whole:  # enlarging twice shows all there is
        wide = min(wide, max(2 * crop.rgb.shape[1], TILE.width))
    size = Size(wide, round(wide * size.height / size.width))
    drawn = draw_crop(crop, size)
    image = encode_png(drawn) if whole else encode_webp(drawn)
    return shown | size._asdict() | {"source": data_address(image)}
