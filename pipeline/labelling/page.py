"""The page of candidate crops that a person marks: one HTML file, which needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.evidence.crops import Crop, read_crops, read_times
from wayside.pipeline.evidence.marks import class_words
from wayside.pipeline.files.pictures import data_address, encode_webp, is_marked
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.labelling.items import Item, Questions, questions
from wayside.pipeline.pages import render_page
from wayside.pipeline.results.result import read_run
from wayside.schemas.detections import COLORS, SHAPES
from wayside.schemas.labels import BACK, NOT_A_SIGN, SIGN, UNSURE

PAGE_FILE = "index.html"
KINDS = {
    SIGN: ("S", "sign"),
    NOT_A_SIGN: ("N", "not a sign"),
    BACK: ("B", "back of a sign"),
    UNSURE: ("U", "unsure"),
}
COLOR_KEYS = {name: str(number + 1) for number, name in enumerate(COLORS)} | {None: "0"}
SHAPE_KEYS = dict(zip((*SHAPES, None), "RDOTCPFHXKZ", strict=True))
_PROPORTION, _LARGEST = 4 / 3, (400, 300)
_WEBP_QUALITY = 80
Watcher = Callable[[int, int], None]


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
    """Write the page of a result.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    folder
        Where `index.html` goes, made where it is missing.
    most
        How many single boxes are asked about at most; landmarks are all asked about.
    log
        Path of the log now; None: that at the time of the run.
    watch
        Called with the number of crops done and to do.
    overwrite
        Replace any file of that name; else only a page of this log.

    Raises
    ------
    InputError
        The result or the log cannot be used.
    OutputError
        The page cannot be written, or a file of its name is not replaced.
    """
    run = read_run(out)
    asked = questions(out, most)
    items = asked.items
    images: dict[str, dict[str, Any]] = {}
    watch(0, len(items))
    boxes = ((item.name, item.shown.frame, item.shown.box) for item in items)
    for shown, crop in read_crops(out, log, boxes, _PROPORTION):
        if crop is not None:
            images[shown] = _image(crop)
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
        "items": [_entry(item, times_ns) | images.get(item.name, {}) for item in items],
    }
    singles = sum(item.name.startswith("box ") for item in items)
    counts = {"landmarks": len(items) - singles, "singles": singles}
    page = render_page("label.html", mark, log=name, data=data, **counts)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(folder, error, "the page") from error
    path = folder / PAGE_FILE
    write_file(path, page.encode(), is_own=lambda old: is_marked(old, mark), overwrite=overwrite)
    return WrittenPage(path, asked, len(items) - len(images))


def _image(crop: Crop) -> dict[str, Any]:
    """A crop as WebP, no larger than a page needs it, and its box in percent (left, top, width, height)."""
    height, width = crop.rgb.shape[:2]
    x0, y0, x1, y1 = crop.box
    outline = (x0 / width, y0 / height, (x1 - x0) / width, (y1 - y0) / height)
    small = crop if width <= _LARGEST[0] else crop.scaled_to(*_LARGEST)
    return {
        "outline": [round(100 * value, 2) for value in outline],
        "image": data_address(encode_webp(small.rgb, _WEBP_QUALITY)),
    }


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
