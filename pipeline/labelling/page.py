"""The page of candidate crops that a person marks, one HTML file, and what it asks about.

Things that a classifier is unsure of teach the most (uncertainty sampling: Lewis and Gale 1994). They are sorted by the
distance of their score from the threshold. Landmarks come before single boxes: one answer labels all their images.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline import pages
from wayside.pipeline.evidence.crops import Crop, cut, read_boxes
from wayside.pipeline.evidence.marks import class_words
from wayside.pipeline.files.pictures import webp_address
from wayside.pipeline.labels.box_matching import overlap
from wayside.pipeline.results.result import read_rows, read_run, read_table, read_times
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, UNSURE, Box
from wayside.schemas.tables import OBSERVATIONS, SIGNS
from wayside.stages.geometry import box_areas

_COLUMNS = (
    *("frame", "observation_id", "box", "color", "shape", "track_id", "sign_id", "verdict"),
    *("source", "score", "color_distance", "shape_distance"),
)
_CERTAIN = 0.9999
PAGE_FILE = "index.html"
KINDS = {
    SIGN: ("S", "sign"),
    NOT_A_SIGN: ("N", "not a sign"),
    BACK: ("B", "back of a sign"),
    UNSURE: ("U", "unsure"),
}
COLOR_KEYS = dict(zip((*COLORS, None), "123456789L0", strict=True))
SHAPE_KEYS = dict(zip((*SHAPES, None), "RDOTCPFHXKZ", strict=True))
_PROPORTION, _LARGEST = 4 / 3, (400, 300)
_WEBP_QUALITY = 80
_SCENE_PX, _SCENE_QUALITY = 640, 60
"""Width of the whole image next to a crop: enough to see where on the road it is."""
Watcher = Callable[[int, int], None]


class View(NamedTuple):
    """A box x0, y0, x1, y1, half open, pixels, in the image of a frame."""

    frame: int
    box: Box


@dataclass(frozen=True, slots=True)
class Item:
    """One thing to ask about."""

    name: str
    """`sign_id` of a reported row, `landmark N` or `box N`."""
    views: tuple[View, ...]
    """Its boxes, at least one."""
    color: str | None
    """As the run named it."""
    shape: str | None
    """As the run named it."""
    margin: float
    """Score minus threshold, nan where there is neither."""

    @property
    def shown(self) -> View:
        """The largest view."""
        return self.views[int(np.argmax(box_areas(np.array([v.box for v in self.views]))))]


@dataclass(frozen=True, slots=True)
class Questions:
    """Items in the order to ask; left_out: single boxes beyond the number wanted."""

    items: tuple[Item, ...]
    left_out: int


def questions(out: Path, most: int) -> Questions:
    """What to ask about the result in folder `out`: all its landmarks, and `most` single boxes at most.

    Raises InputError if the folder is no result folder, or damaged.
    """
    table = read_table(out, OBSERVATIONS, _COLUMNS)
    names = ("sign_id", "confidence", "color", "shape", "status")
    signs = {row["sign_id"]: row for row in read_rows(out, SIGNS, names)}
    tracks: defaultdict[int, list[dict[str, Any]]] = defaultdict(list)
    single: list[dict[str, Any]] = []
    with_margin = table.append_column("margin", pa.array(margins(table)))
    for row in with_margin.to_pylist():
        if row["verdict"] != "overlap":
            (single if row["track_id"] is None else tracks[row["track_id"]]).append(row)
    landmarks = list(_landmarks(tracks, signs))
    landmarks.sort(key=lambda item: (_urgency(item.margin), item.name))
    taken: defaultdict[int, list[Box]] = defaultdict(list)
    for item in landmarks:
        for view in item.views:
            taken[view.frame].append(view.box)
    boxes: list[Item] = []
    single.sort(key=lambda row: _urgency(row["margin"]))
    for looked, row in enumerate(single):
        if len(boxes) >= most:
            return Questions((*landmarks, *boxes), len(single) - looked)
        here, box = taken[row["frame"]], row["box"]
        if not overlap(np.array(here).reshape(-1, 4), box).any():
            here.append(tuple(box))  # what overlaps it is another view of the same thing
            boxes.append(_item(f"box {row['observation_id']}", [row], row, row["margin"]))
    return Questions((*landmarks, *boxes), 0)


def margins(table: pa.Table) -> NDArray[np.float64]:
    """How far each observation (n,) is above the threshold of its gate, nan where no gate scored it.

    The gate is the classifier of boxes, else (preset `report`) the outline: the worst that it let pass tells its
    threshold. Predicted boxes are not asked.
    """
    verdict = np.array(table["verdict"].to_pylist(), object)
    asked = np.array(table["source"].to_pylist(), object) != "predicted"
    score, refusal = table["score"].to_numpy(), "score"
    gates = np.zeros(len(verdict))
    if np.isnan(score).all():
        score, refusal = -table["shape_distance"].to_numpy(), "shape"
        gates = np.array(table["shape"].to_pylist(), str)
    margin = np.full(len(verdict), np.nan)
    known = np.isfinite(score)
    for gate in np.unique(gates):
        own = known & (gates == gate)
        passed = own & asked & (verdict != refusal) & (verdict != "color")
        worst = score[passed].min() if passed.any() else score[own].max(initial=-np.inf)
        margin[own] = score[own] - worst
    return margin


def _landmarks(
    tracks: dict[int, list[dict[str, Any]]], signs: dict[str, dict[str, Any]]
) -> Iterator[Item]:
    for track, rows in tracks.items():
        known = [row["margin"] for row in rows if math.isfinite(row["margin"])]
        best, sign = max(known, default=math.nan), signs.get(rows[0]["sign_id"])
        if sign is not None and sign["confidence"] is not None:
            probability = min(max(sign["confidence"], 1 - _CERTAIN), _CERTAIN)
            best = math.log(probability / (1 - probability))
        largest = rows[int(np.argmax(box_areas(np.array([row["box"] for row in rows]))))]
        name = f"landmark {track}" if sign is None else sign["sign_id"]
        yield _item(name, rows, sign or largest, best)


def _item(name: str, rows: list[dict[str, Any]], look: dict[str, Any], margin: float) -> Item:
    views = tuple(View(row["frame"], tuple(row["box"])) for row in rows)
    return Item(name, views, look["color"], look["shape"], margin)


def _urgency(margin: float) -> float:
    return abs(margin) if math.isfinite(margin) else math.inf


@dataclass(frozen=True, slots=True)
class WrittenPage:
    """Where the page is, what it asks, and how many of these have no image."""

    path: Path
    questions: Questions
    lost: int


def write_page(
    out: Path,
    folder: Path,
    *,
    most: int,
    log: Path | None = None,
    watch: Watcher = lambda done, total: None,
    overwrite: bool = False,
) -> WrittenPage:
    """Write the page of a result that `wayside run` wrote to the folder `out`.

    `folder`: where `index.html` goes, made where it is missing. `most`: how many single boxes are asked about at most;
    landmarks are all asked about. `log`: its path now; None: that at the time of the run. `watch`: called with the
    number of crops done and to do. `overwrite`: replace any file of that name; else only a page of this log.

    Raises InputError where the result or the log cannot be used; OutputError where the page cannot be written, or a
    file of its name is not replaced.
    """
    run = read_run(out)
    asked = questions(out, most)
    items = asked.items
    images: dict[str, dict[str, Any]] = {}
    watch(0, len(items))
    boxes = ((item.name, *item.shown) for item in items)
    scenes: dict[int, str] = {}
    for shown, image, box in read_boxes(out, log, boxes):
        if image.rgb is not None:
            place = {"place": _percent(image.rgb, box)}
            images[shown] = _image(cut(image.rgb, box, _PROPORTION)) | place
            if image.frame.index not in scenes:
                scenes[image.frame.index] = _scene(image.rgb)
        watch(len(images), len(items))
    name, fingerprint = str(run.get("log", "")), run.get("log_fingerprint") or ""
    mark = f"wayside label {name} {fingerprint}".strip()
    times_ns, stem = read_times(out), Path(name).stem
    data = {
        "log": stem,
        "log_fingerprint": fingerprint,
        "file": f"{stem}.marks.json",
        "kinds": [
            {"value": kind, "key": key, "words": words} for kind, (key, words) in KINDS.items()
        ],
        "colors": _choices(COLOR_KEYS),
        "shapes": _choices(SHAPE_KEYS),
        "scenes": scenes,
        "items": [_entry(item, times_ns) | images.get(item.name, {}) for item in items],
    }
    singles = sum(item.name.startswith("box ") for item in items)
    counts = {"landmarks": len(items) - singles, "singles": singles}
    page = pages.render_page("label.html", mark, log=name, data=data, **counts)
    pages.write_page(folder / PAGE_FILE, page, mark, overwrite=overwrite)
    return WrittenPage(folder / PAGE_FILE, asked, len(items) - len(images))


def _image(crop: Crop) -> dict[str, Any]:
    """A crop as WebP, no larger than a page needs it, and its box in percent (left, top, width, height)."""
    small = crop if crop.rgb.shape[1] <= _LARGEST[0] else crop.scaled_to(*_LARGEST)
    address = webp_address(small.rgb, _WEBP_QUALITY)
    return {"outline": _percent(crop.rgb, crop.box), "image": address}


def _percent(rgb: NDArray[np.uint8], box: Box) -> list[float]:
    """Left, top, width and height of a box in percent of an image."""
    height, width = rgb.shape[:2]
    x0, y0, x1, y1 = box
    outline = (x0 / width, y0 / height, (x1 - x0) / width, (y1 - y0) / height)
    return [round(100 * value, 2) for value in outline]


def _scene(rgb: NDArray[np.uint8]) -> str:
    """The address of a whole image, no larger than a page needs it."""
    height, width = rgb.shape[:2]
    size = min(width, _SCENE_PX), min(height, round(_SCENE_PX * height / width))
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    return webp_address(small, _SCENE_QUALITY)


def _choices(keys: Mapping[str | None, str]) -> list[dict[str, str | None]]:
    return [
        {"value": value, "key": key, "words": class_words(value) if value else "none of these"}
        for value, key in keys.items()
    ]


def _entry(item: Item, times_ns: Mapping[int, int]) -> dict[str, Any]:
    views = [
        {
            "frame": view.frame,
            "log_time_ns": str(times_ns[view.frame]),  # beyond what numbers of JavaScript hold
            "box": [round(edge, 2) for edge in view.box],
        }
        for view in item.views
    ]
    shown = item.views.index(item.shown)
    about = {"name": item.name, "color": item.color, "shape": item.shape}
    return about | {"shown": shown, "views": views}
