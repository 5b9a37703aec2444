"""The index of all evidence sheets: one HTML file that needs nothing but itself and the sheets beside it."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.evidence.gather import DriveMap
from wayside.pipeline.evidence.marks import appearance_of, class_words, ink_of, outline_of
from wayside.pipeline.file_marks import marked_head
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import SIGN_STATUSES

_MAP_WIDTH, _MAP_HEIGHT, _MAP_MARGIN, _MAP_POINTS = 1200.0, 300.0, 16.0, 1000
_UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Card:
    """One sign of the index: its row, the file name of its sheet, a small image as WebP (None: there is none)."""

    sign: dict[str, Any]
    sheet: str
    thumb: bytes | None

    @property
    def name(self) -> str:
        """The sign's id."""
        return str(self.sign["sign_id"])


def format_index(cards: Sequence[Card], drive: DriveMap, log: str, mark: str) -> str:
    """HTML page that lists all signs, with a map and filters."""
    page = Template(files(__package__).joinpath("index.html").read_text("utf-8"))
    return page.substitute(
        log=escape(log),
        mark=marked_head(mark),
        summary=escape(_summary(cards, drive)),
        colors=_options(COLORS, [card.sign["color"] for card in cards]),
        shapes=_options(SHAPES, [card.sign["shape"] for card in cards]),
        statuses=_options(tuple(SIGN_STATUSES), [card.sign["status"] for card in cards]),
        map=_map(cards, drive),
        cards="\n".join(_card(card) for card in cards),
    )


def _summary(cards: Sequence[Card], drive: DriveMap) -> str:
    length = float(np.linalg.norm(np.diff(drive.path, axis=0), axis=1).sum())
    covered = f"{length / 1000:.2f} km" if length >= 1000 else f"{length:.0f} m"
    return f"{_counted(len(cards), 'sign')} on {covered} of road, {_counted(len(drive.cameras), 'frame')}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _options(known: Iterable[str], found: Sequence[str | None]) -> str:
    """Choices of a class, only those that occur, in the order of the class."""
    present = [name for name in known if name in found]
    if None in found:
        present.append(_UNKNOWN)
    counts = {name: found.count(None if name == _UNKNOWN else name) for name in present}
    return "".join(
        f'<option value="{name}">{escape(class_words(name))} ({count})</option>'
        for name, count in counts.items()
    )


def _card(card: Card) -> str:
    sign = card.sign
    face = appearance_of(sign["color"], sign["shape"])
    values = {
        "id": card.name.lower(),
        "color": sign["color"] or _UNKNOWN,
        "shape": sign["shape"] or _UNKNOWN,
        "status": sign["status"],
        "confidence": "" if sign["confidence"] is None else f"{sign['confidence']:.4f}",
        "station": "" if sign["station_m"] is None else f"{sign['station_m']:.3f}",
    }
    data = " ".join(f'data-{name}="{escape(value)}"' for name, value in values.items())
    image = '<span class="none">no image</span>'
    if card.thumb is not None:
        source = base64.b64encode(card.thumb).decode()
        image = (
            f'<img src="data:image/webp;base64,{source}" width="240" height="180" loading="lazy" '
            f'alt="{escape(face)}">'
        )
    status = (
        "" if sign["status"] == "sign" else f'<span class="status">{escape(sign["status"])}</span>'
    )
    facts = "".join(f"<dt>{label}</dt><dd>{escape(value)}</dd>" for label, value in _facts(sign))
    return (
        f'<li id="{escape(card.name)}" {data}><a href="{quote(card.sheet)}">{image}'
        f"<h2>{_glyph(sign)}<span>{escape(card.name)}</span></h2>"
        f'<p class="look"><span>{escape(face)}</span>{status}</p><dl>{facts}</dl></a></li>'
    )


def _facts(sign: dict[str, Any]) -> list[tuple[str, str]]:
    lateral = sign["lateral_m"]
    side = "" if lateral is None else " right" if lateral >= 0 else " left"
    confidence = sign["confidence"]
    return [
        ("Confidence", _UNKNOWN if confidence is None else f"{confidence:.2f}"),
        ("Along", _metres(_number(sign["station_m"], sign["sigma_along_m"]))),
        ("Beside", _metres(_number(None if lateral is None else abs(lateral))) + side),
        ("Size", _metres(f"{_number(sign['panel_width_m'])} x {_number(sign['panel_height_m'])}")),
        ("Views", str(sign["views"])),
        *(
            [("Image", f"{name} {sign['image_date']}".strip())]
            if (name := sign.get("image_name"))
            else []
        ),
    ]


def _number(value: float | None, sigma: float | None = None) -> str:
    if value is None:
        return _UNKNOWN
    return f"{value:.2f}" if sigma is None else f"{value:.2f} ± {sigma:.2f}"


def _metres(words: str) -> str:
    return words if _UNKNOWN in words else f"{words} m"


def _glyph(sign: dict[str, Any]) -> str:
    corners = " ".join(f"{x:.2f},{y:.2f}" for x, y in outline_of(sign["shape"]))
    return (
        '<svg class="glyph" viewBox="-1.15 -1.15 2.3 2.3" aria-hidden="true">'
        f'<polygon points="{corners}" fill="{_css(sign)}"/></svg>'
    )


def _css(sign: dict[str, Any]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*ink_of(sign["color"]))


def _map(cards: Sequence[Card], drive: DriveMap) -> str:
    """The path and every sign from above, turned to run from left to right; a sign leads to its card."""
    rotation = _to_the_right(drive.path[:, :2])
    camera_path, positions = drive.path[:, :2] @ rotation, drive.signs[:, :2] @ rotation
    points = np.concatenate([camera_path, positions])
    if not len(points):
        return ""
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    room = np.array([_MAP_WIDTH, _MAP_HEIGHT]) - 2 * _MAP_MARGIN
    scale = float(np.min(room / extent))
    width, height = extent * scale + 2 * _MAP_MARGIN

    def at(point: NDArray[np.float64]) -> tuple[str, str]:
        x, y = (point - [low[0], high[1]]) * [scale, -scale] + _MAP_MARGIN
        return f"{x:.1f}", f"{y:.1f}"

    thinned = camera_path[:: max(1, len(camera_path) // _MAP_POINTS)]
    path = " ".join(",".join(at(point)) for point in (*thinned, *camera_path[-1:]))
    dots = []
    for card, position in zip(cards, positions, strict=True):
        x, y = at(position)
        title = escape(f"{card.name}: {appearance_of(card.sign['color'], card.sign['shape'])}")
        dots.append(
            f'<a href="#{quote(card.name)}" data-for="{escape(card.name)}" aria-label="{title}">'
            f'<circle cx="{x}" cy="{y}" r="7" fill="{_css(card.sign)}"><title>{title}</title></circle></a>'
        )
    return (
        f'<svg class="map" viewBox="0 0 {width:.0f} {height:.0f}" role="group" '
        'aria-label="The drive from above, from left to right">'
        f'<polyline points="{path}"/>{"".join(dots)}</svg>'
    )


def _to_the_right(camera_path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (2, 2) that turns rows x, y so that the farthest point of a path lies to the right of its start."""
    away = camera_path - camera_path[:1]
    x, y = away[np.argmax(np.linalg.norm(away, axis=1))] if len(camera_path) else (0.0, 0.0)
    length = float(np.hypot(x, y))
    return np.array([[x, -y], [y, x]]) / length if length > 0 else np.eye(2)
