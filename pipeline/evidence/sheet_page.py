"""The evidence of one sign as a page: text, crops and maps in one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from string import Template
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.crops import Crop
from wayside.pipeline.evidence.figures import (
    MEASUREMENT,
    UNKNOWN,
    Figure,
    evidence_terms,
    figures_of,
)
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView
from wayside.pipeline.evidence.marks import appearance_of, ink_of, outline_of
from wayside.pipeline.evidence.sheet import BIG, TILE, draw_crop, map_images
from wayside.pipeline.file_marks import marked_head
from wayside.pipeline.webp import data_address, encode_webp

_MAP_ADDRESS = (
    "https://www.openstreetmap.org/?mlat={lat:.7f}&mlon={lon:.7f}#map=19/{lat:.7f}/{lon:.7f}"
)


def format_sheet(
    evidence: Evidence,
    crops: Mapping[SignView, Crop],
    drive: DriveMap,
    log: str,
    world: str,
    mark: str,
    neighbours: Mapping[str, str],
) -> str:
    """The page of a sign.

    Parameters
    ----------
    evidence, crops, drive, log, world
        As in `draw_sheet`.
    mark
        What the page is known by.
    neighbours
        File names of other pages: `prev`, `up` and `next`, as many as there are.
    """
    sign = evidence.sign
    figures = figures_of(sign, world)
    tables = "".join(_table(group, figures[group]) for group in figures if group != MEASUREMENT)
    weighed = [Figure(term.capitalize(), f"{ratio:+.1f}") for term, ratio in evidence_terms(sign)]
    details = "".join(
        f"<details><summary>{heading}</summary>{_table('', rows)}</details>"
        for heading, rows in (
            (MEASUREMENT, figures[MEASUREMENT]),
            ("Evidence for a sign, log-likelihood ratios", weighed),
        )
        if rows
    )
    count = len(evidence.views)
    maps = map_images(evidence, drive)
    page = Template(files(__package__).joinpath("sheet.html").read_text("utf-8"))
    return page.substitute(
        mark=marked_head(mark),
        name=escape(evidence.name),
        nav=_links(neighbours),
        glyph=glyph(sign["color"], sign["shape"]),
        look=escape(_look(evidence, drive, log)),
        best=_view(evidence.best, crops, BIG, drive),
        figures=tables + details,
        links=_map_link(evidence),
        maps="".join(_figure(rgb, heading, heading) for heading, rgb in maps),
        views_heading=f"All {count} views" if count > 1 else "The only view",
        views="".join(_view(view, crops, TILE, drive) for view in evidence.views),
    )


def glyph(color: str | None, shape: str | None) -> str:
    """A small drawing of a class of signs, SVG."""
    corners = " ".join(f"{x:.2f},{y:.2f}" for x, y in outline_of(shape))
    return (
        '<svg class="glyph" viewBox="-1.15 -1.15 2.3 2.3" aria-hidden="true">'
        f'<polygon points="{corners}" fill="{css(color)}"/></svg>'
    )


def css(color: str | None) -> str:
    """The ink of a class of colours as CSS has it."""
    return "#{:02x}{:02x}{:02x}".format(*ink_of(color))


def _links(neighbours: Mapping[str, str]) -> str:
    words = {"prev": "← previous", "up": "↑ all signs", "next": "next →"}
    return "".join(
        f'<a rel="{rel}" href="{quote(neighbours[rel])}">{words[rel]}</a>'
        for rel in words
        if rel in neighbours
    )


def _look(evidence: Evidence, drive: DriveMap, log: str) -> str:
    sign = evidence.sign
    sure = UNKNOWN if sign["confidence"] is None else f"{sign['confidence']:.2f}"
    frame = evidence.best.frame
    name, when = drive.images.get(frame, ("", ""))
    if not name:  # imported images have their own dates or none: their log times are counted
        seconds = drive.log_times_ns[frame] // 1_000_000_000
        when = datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    look = appearance_of(sign["color"], sign["shape"])
    return f"{look}, status {sign['status']}, confidence {sure}; {', '.join(filter(None, (log, when)))}"


def _table(heading: str, figures: list[Figure]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{escape(f.label)}</th>'
        + (
            f"<td>{escape(f.value)}</td><td>{escape(f.remark)}</td></tr>"
            if f.remark
            else f'<td colspan="2">{escape(f.value)}</td></tr>'
        )
        for f in figures
    )
    return (
        f"<table>{f'<caption>{heading}</caption>' if heading else ''}<tbody>{rows}</tbody></table>"
    )


def _map_link(evidence: Evidence) -> str:
    lat, lon = evidence.sign["lat_deg"], evidence.sign["lon_deg"]
    if lat is None or lon is None:
        return ""
    address = escape(_MAP_ADDRESS.format(lat=lat, lon=lon))
    return (
        f'<p><a href="{address}" rel="noreferrer external">OpenStreetMap (needs a network)</a></p>'
    )


def _view(
    view: SignView, crops: Mapping[SignView, Crop], size: tuple[int, int], drive: DriveMap
) -> str:
    name, date = drive.images.get(view.frame, ("", ""))
    parts = [f"frame {view.frame}", *filter(None, (name, date))]
    parts += [] if view.range_m is None else [f"{view.range_m:.1f} m"]
    parts += [] if view.residual_px is None else [f"residual {view.residual_px:.2f} px"]
    caption = ", ".join(parts)
    crop = crops.get(view)
    if crop is None:
        return f'<figure><div class="none">image not readable</div><figcaption>{escape(caption)}</figcaption></figure>'
    wide = min(size[0], max(2 * crop.rgb.shape[1], TILE[0]))  # enlarging twice shows all there is
    return _figure(draw_crop(crop, (wide, round(wide * size[1] / size[0]))), caption, caption)


def _figure(rgb: NDArray[np.uint8], caption: str, words: str) -> str:
    height, width = rgb.shape[:2]
    source = data_address(encode_webp(rgb))
    return (
        f'<figure><img src="{source}" width="{width}" height="{height}" loading="lazy" alt="{escape(words)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
