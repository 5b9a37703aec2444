"""The index of all evidence sheets: one HTML file that needs nothing but itself and the sheets beside it."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.code_words import code_of
from wayside.pipeline.evidence.gather import DriveMap
from wayside.pipeline.evidence.maps import length_words, round_length
from wayside.pipeline.evidence.marks import appearance_of, class_words
from wayside.pipeline.evidence.sheet_page import css, glyph
from wayside.pipeline.file_marks import marked_head
from wayside.pipeline.reviewing.review import COLUMNS as REVIEW_COLUMNS
from wayside.pipeline.webp import data_address
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.tables import SIGN_STATUSES

_MAP_WIDTH, _MAP_HEIGHT, _MAP_MARGIN, _MAP_POINTS = 1200.0, 300.0, 16.0, 1000
_FOOT = 40.0
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
    view = _map_view(drive)
    about: dict[str, Any] = {"log": log, "result": result, "columns": REVIEW_COLUMNS}
    if view is not None:
        about["map"] = {
            "turn": view.rotation.tolist(),
            "scale": view.scale,
            "left": float(view.low[0]),
            "top": float(view.high[1]),
            "margin": _MAP_MARGIN,
        }
    page = Template(files(__package__).joinpath("index.html").read_text("utf-8"))
    return page.substitute(
        log=escape(log),
        mark=marked_head(mark),
        summary=escape(_summary(cards, drive)),
        colors=_options(COLORS, [card.sign["color"] for card in cards]),
        shapes=_options(SHAPES, [card.sign["shape"] for card in cards]),
        codes=_code_options([code_of(card.sign) for card in cards]),
        statuses=_options(tuple(SIGN_STATUSES), [card.sign["status"] for card in cards]),
        map="" if view is None else _map(cards, drive, view),
        script=files(__package__).joinpath("index.js").read_text("utf-8"),
        about=json.dumps(about).replace("<", "\\u003c"),
        allcolors=_choices(COLORS),
        allshapes=_choices(SHAPES),
        cards="\n".join(_card(card) for card in cards),
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


def _code_options(found: Sequence[str | None]) -> str:
    """Codes that occur, in order, and how often."""
    counts = Counter(name or _UNKNOWN for name in found)
    return "".join(
        f'<option value="{escape(name)}">{escape(name)} ({counts[name]})</option>'
        for name in sorted(counts, key=lambda name: (name == _UNKNOWN, name))
    )


def _choices(known: Iterable[str]) -> str:
    return "".join(f'<option value="{name}">{escape(class_words(name))}</option>' for name in known)


def _card(card: Card) -> str:
    sign = card.sign
    face = appearance_of(sign["color"], sign["shape"])
    values = {
        "id": card.name.lower(),
        "color": sign["color"] or _UNKNOWN,
        "shape": sign["shape"] or _UNKNOWN,
        "code": code_of(sign) or _UNKNOWN,
        "status": sign["status"],
        "confidence": "" if sign["confidence"] is None else f"{sign['confidence']:.4f}",
        "station": "" if sign["station_m"] is None else f"{sign['station_m']:.3f}",
    }
    data = " ".join(f'data-{name}="{escape(value)}"' for name, value in values.items())
    image = '<span class="none">no image</span>'
    if card.thumb is not None:
        image = (
            f'<img src="{data_address(card.thumb)}" width="240" height="180" loading="lazy" '
            f'alt="{escape(face)}">'
        )
    status = (
        "" if sign["status"] == "sign" else f'<span class="status">{escape(sign["status"])}</span>'
    )
    facts = "".join(f"<dt>{label}</dt><dd>{escape(value)}</dd>" for label, value in _facts(sign))
    return (
        f'<li id="{escape(card.name)}" {data}><a href="{quote(card.sheet)}">{image}'
        f"<h2>{glyph(sign['color'], sign['shape'])}<span>{escape(card.name)}</span></h2>"
        f'<p class="look"><span>{escape(face)}</span>{status}</p><dl>{facts}</dl></a></li>'
    )


def _facts(sign: dict[str, Any]) -> list[tuple[str, str]]:
    lateral = sign["lateral_m"]
    side = "" if lateral is None else " right" if lateral >= 0 else " left"
    confidence = sign["confidence"]
    return [
        ("Code", code_of(sign) or _UNKNOWN),
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


@dataclass(frozen=True, slots=True)
class _MapView:
    """How world x, y lie on the map.

    rotation (2, 2): turns rows x, y; low, high (2,): extent of what is turned, metres; scale: pixels a metre.
    """

    rotation: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    scale: float

    def at(self, turned: NDArray[np.float64]) -> tuple[str, str]:
        """Pixels of a turned point."""
        x, y = (turned - [self.low[0], self.high[1]]) * [self.scale, -self.scale] + _MAP_MARGIN
        return f"{x:.1f}", f"{y:.1f}"


def _map_view(drive: DriveMap) -> _MapView | None:
    """The map turned to run from left to right; None where there is nothing on it."""
    rotation = _to_the_right(drive.path[:, :2])
    points = np.concatenate([drive.path[:, :2], drive.signs[:, :2]]) @ rotation
    if not len(points):
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([_MAP_WIDTH, _MAP_HEIGHT]) - 2 * _MAP_MARGIN
    return _MapView(rotation, low, high, float(np.min(room / np.maximum(high - low, 1.0))))


def _map(cards: Sequence[Card], drive: DriveMap, view: _MapView) -> str:
    """The path and every sign from above; a sign leads to its card. Below: scale, and where north is if known."""
    camera_path, positions = (points[:, :2] @ view.rotation for points in (drive.path, drive.signs))
    width, height = np.maximum(view.high - view.low, 1.0) * view.scale + 2 * _MAP_MARGIN
    thinned = camera_path[:: max(1, len(camera_path) // _MAP_POINTS)]
    path = " ".join(",".join(view.at(point)) for point in (*thinned, *camera_path[-1:]))
    dots = []
    for card, position in zip(cards, positions, strict=True):
        x, y = view.at(position)
        title = escape(f"{card.name}: {appearance_of(card.sign['color'], card.sign['shape'])}")
        dots.append(
            f'<a href="#{quote(card.name)}" data-for="{escape(card.name)}" aria-label="{title}" tabindex="-1">'
            f'<circle cx="{x}" cy="{y}" r="7" fill="{css(card.sign["color"])}"><title>{title}</title></circle></a>'
        )
    return (
        f'<svg class="map" viewBox="0 0 {width:.0f} {height + _FOOT:.0f}" role="group" '
        'aria-label="The drive from above, from left to right">'
        f'<polyline points="{path}"/>{"".join(dots)}{_foot(view, float(width), float(height), drive.north)}</svg>'
    )


def _foot(view: _MapView, width: float, height: float, north: NDArray[np.float64] | None) -> str:
    """Scale bar below the map, and an arrow to the north where that is known."""
    metres = round_length(0.2 * width / view.scale)
    left, right, base = _MAP_MARGIN, _MAP_MARGIN + metres * view.scale, height + _FOOT - 12
    bar = (
        f'<path class="rule" d="M{left:.1f},{base - 6:.1f}v6H{right:.1f}v-6"/>'
        f'<text x="{right + 8:.1f}" y="{base:.1f}">{length_words(metres)}</text>'
    )
    if north is None:
        return bar
    x, y = (north @ view.rotation) * [1, -1]
    turn = math.degrees(math.atan2(x, -y))
    middle = f"{width - 2 * _MAP_MARGIN:.1f},{base - 4:.1f}"
    return (
        f'{bar}<g transform="translate({middle}) rotate({turn:.1f})"><title>north</title>'
        '<path class="rule needle" d="M0,12V-12M-5,-5L0,-12L5,-5"/></g>'
        f'<text x="{width - 3.5 * _MAP_MARGIN:.1f}" y="{base:.1f}" text-anchor="end">north</text>'
    )


def _to_the_right(camera_path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix (2, 2) that turns rows x, y so that the farthest point of a path lies to the right of its start."""
    away = camera_path - camera_path[:1]
    x, y = away[np.argmax(np.linalg.norm(away, axis=1))] if len(camera_path) else (0.0, 0.0)
    length = float(np.hypot(x, y))
    return np.array([[x, -y], [y, x]]) / length if length > 0 else np.eye(2)
