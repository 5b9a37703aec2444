"""Figures and the page that shows them: one HTML file that needs nothing but itself."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.file_marks import marked_head

MARK = "wayside report-figures"
_WIDEST, _QUALITY = 1100, 82
_STYLE = """
body { margin: 0 auto; max-width: 1180px; padding: 24px; font: 15px/1.5 system-ui, sans-serif; color: #161b22;
  background: #fff; }
h2 { margin: 40px 0 0; border-top: 2px solid #161b22; padding-top: 10px; }
h3 { margin: 26px 0 6px; }
table { border-collapse: collapse; margin: 8px 0; }
th, td { text-align: left; vertical-align: top; padding: 3px 14px 3px 0; border-bottom: 1px solid #d9dee4; }
dl { display: grid; grid-template-columns: 90px 1fr; gap: 2px 12px; margin: 6px 0; }
dt { color: #606a76; } dd { margin: 0; }
figure { margin: 8px 14px 8px 0; display: inline-block; vertical-align: top; max-width: 100%; }
figure img, figure svg { max-width: 100%; height: auto; display: block; }
figcaption { color: #606a76; font-size: 13px; max-width: 560px; }
.needs { color: #8a4b00; }
"""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as HTML, an `img` or an `svg`, and its words."""

    html: str
    words: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of the report.

    number, title; report: what the report shows and which number it gives; ours: the same of this drive; needs: why it
    is left out (empty: it is not).
    """

    number: str
    title: str
    report: str
    ours: str = ""
    pictures: tuple[Picture, ...] = ()
    needs: str = ""
    table: tuple[tuple[str, ...], ...] = ()


def photo(rgb: NDArray[np.uint8], words: str = "", *, scale: float = 1.0) -> Picture:
    """An image (height, width, 3) RGB or (height, width) grey as JPEG, enlarged by a factor, shrunk where too wide."""
    factor = min(scale, _WIDEST / rgb.shape[1])
    size = (max(round(rgb.shape[1] * factor), 1), max(round(rgb.shape[0] * factor), 1))
    method = cv2.INTER_CUBIC if factor > 1 else cv2.INTER_AREA
    shown = cv2.resize(rgb, size, interpolation=method)
    if shown.ndim == 3:
        shown = cv2.cvtColor(shown, cv2.COLOR_RGB2BGR)
    _, coded = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    source = base64.b64encode(coded.tobytes()).decode()
    alt = escape(words, quote=True)
    return Picture(
        f'<img src="data:image/jpeg;base64,{source}" width="{size[0]}" height="{size[1]}" alt="{alt}">',
        words,
    )


def format_page(log: str, summary: str, chapters: Sequence[tuple[str, Sequence[Figure]]]) -> str:
    """The whole page."""
    head = (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n{marked_head(MARK)}\n'
        f"<title>Figures of KS-09-9 on {escape(log)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
    )
    body = [f"<h1>Figures of KS-09-9 on {escape(log)}</h1>\n<p>{escape(summary)}</p>\n"]
    for title, figures in chapters:
        body.append(f"<h2>{escape(title)}</h2>\n")
        body.extend(part for figure in figures for part in _figure(figure))
    return head + "".join(body) + "</body>\n</html>\n"


def _figure(figure: Figure) -> Iterator[str]:
    yield f'<section id="figure-{escape(figure.number)}">'
    yield f"<h3>{escape(figure.number)} {escape(figure.title)}</h3>\n"
    yield f"<dl><dt>Report</dt><dd>{escape(figure.report)}</dd>"
    if figure.needs:
        yield f'<dt>Ours</dt><dd class="needs">left out: {escape(figure.needs)}</dd></dl></section>\n'
        return
    yield f"<dt>Ours</dt><dd>{escape(figure.ours)}</dd></dl>\n"
    for one in figure.pictures:
        caption = f"<figcaption>{escape(one.words)}</figcaption>" if one.words else ""
        yield f"<figure>{one.html}{caption}</figure>\n"
    if figure.table:
        yield "<table>"
        for i, row in enumerate(figure.table):
            tag = "th" if i == 0 else "td"
            yield "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"
        yield "</table>"
    yield "</section>\n"
