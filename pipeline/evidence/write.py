"""Evidence of a result, a page a sign, made while its log is read once."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wayside.pipeline.evidence.crops import Crop, draw_crop, read_crops, read_images
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView, gather
from wayside.pipeline.evidence.marks import METRIC, Units
from wayside.pipeline.evidence.sheet import PROPORTION, draw_sheet, format_index, format_sheet
from wayside.pipeline.files.output_folder import OutputFolder
from wayside.pipeline.files.pictures import (
    blurred,
    is_marked,
    marked_head,
    marked_png,
    webp_address,
)
from wayside.pipeline.files.writing import create, not_written, refuse
from wayside.pipeline.results.result import read_run, read_settings
from wayside.pipeline.reviewing.known import KnownResult
from wayside.pipeline.reviewing.matching import Review
from wayside.pipeline.reviewing.review import find_review
from wayside.schemas.errors import InputError
from wayside.schemas.labels import Box
from wayside.schemas.settings import RouteSettings

INDEX_FILE, IMAGES_FILE = "index.html", "images.js"
_IMAGE_WIDTH, _IMAGE_QUALITY = 1280, 60
"""Of images to click in: a panel at 40 m is 20 px wide, and an image takes 60 kB."""
THUMB = 240, 180
Watcher = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Written:
    """What was written."""

    sheets: tuple[Path, ...]
    """Pages in order of signs."""
    index: Path | None
    """None: only one sign was asked for."""
    lost_views: int
    """How many views have no image."""
    notes: tuple[str, ...] = ()
    """What became of reviews of earlier results."""


def write_evidence(  # noqa: PLR0913 - one for each option
    out: Path,
    folder: Path,
    *,
    sign_id: str | None = None,
    log: Path | None = None,
    watch: Watcher = lambda done, total: None,
    png: bool = False,
    blur: bool = False,
    images: bool = False,
    reviews: Sequence[Path] = (),
    units: Units = METRIC,
    route: RouteSettings | None = None,
    overwrite: bool = False,
) -> Written:
    """Write one page a sign and an index of all into `folder`, which is made where it is missing.

    `out`: folder written by `wayside run`. `sign_id`: only the sheet of this sign, without an index; None: all. `log`:
    where it lies now; None: where it lay at the time of the run. `watch`: called with the number of sheets done and to
    do. `png`: also write each sheet as an image. `images`: also all images of the drive, to click missing signs in.
    `blur`: what lies off the panels in all images. `reviews`: files that the index begins with; empty: those in `out`.
    `units`: of lengths. `route`: instead of that of the run. `overwrite`: replace any file of the names of the sheets
    and the index; else only sheets of this log.

    Raises UsageError if there is no such sign. Raises InputError if the result or the log cannot be used. Raises
    OutputError if a sheet cannot be written, or a file of its name is not replaced.
    """
    run = read_run(out)
    drive, signs = gather(out, sign_id, route)
    name = str(run.get("log", ""))
    mark = f"wayside {name} {run.get('log_fingerprint') or ''}".strip()
    names = [f"{one.name}.html" for one in signs]
    pngs = [f"{one.name}.png" for one in signs] if png else []
    index = [INDEX_FILE, IMAGES_FILE] if sign_id is None else []
    around = zip(signs, ["", *names], [*names[1:], ""], strict=False) if index else ()
    beside = {one.name: {"prev": a, "up": INDEX_FILE, "next": b} for one, a, b in around}
    with OutputFolder(folder) as output:
        if not overwrite:
            _check_free(folder, [*names, *pngs, *index], mark)
        binder = _Binder(output.part, out, log, drive, run, mark, png, blur, units, beside, route)
        _fill(binder, signs, watch)
        notes = binder.write_index(signs, reviews, images=images) if index else []
        output.commit([*_sheets_of_others(folder, mark, signs), IMAGES_FILE] if index else [])
    sheets = tuple(folder / page for page in names)
    return Written(sheets, folder / INDEX_FILE if index else None, binder.lost_views, tuple(notes))


def _check_free(folder: Path, names: Sequence[str], mark: str) -> None:
    """Make sure that no file is replaced that is not a sheet or an index of the same log."""
    for name in names:
        path = folder / name
        if path.is_symlink() or path.exists():
            try:
                own = path.is_file() and is_marked(path, mark)
            except OSError as error:
                raise not_written(folder, error) from error
            if not own:
                raise refuse(path, "a file that is not evidence of this log")


def _sheets_of_others(folder: Path, mark: str, signs: Sequence[Evidence]) -> list[str]:
    """Earlier sheets of the same log, of signs that it has no more."""
    kept, others = {one.name for one in signs} | {Path(INDEX_FILE).stem}, []
    for path in (*folder.glob("*.html"), *folder.glob("*.png")):
        with suppress(OSError):  # what cannot be read is none of ours
            if path.stem not in kept and not path.is_symlink() and is_marked(path, mark):
                others.append(path.name)
    return others


@dataclass(slots=True)
class _Binder:
    """Keeps the cut-outs of every sign until its sheet can be drawn and written."""

    folder: Path
    out: Path
    log: Path | None
    drive: DriveMap
    run: dict[str, Any]
    mark: str
    png: bool
    blur: bool
    units: Units
    neighbours: Mapping[str, dict[str, str]]
    route: RouteSettings | None
    crops: defaultdict[str, dict[SignView, Crop]] = field(default_factory=lambda: defaultdict(dict))
    thumbs: dict[str, str] = field(default_factory=dict)
    lost_views: int = 0

    def finish(self, evidence: Evidence) -> None:
        """Draw and write the sheet of a sign with what there is of it."""
        crops = self.crops.pop(evidence.name, {})
        self.lost_views += len(evidence.views) - len(crops)
        about = (evidence, crops, self.drive, self.run)
        page = format_sheet(*about, self.mark, self.neighbours.get(evidence.name, {}), self.units)
        _write(self.folder / f"{evidence.name}.html", page.encode())
        if self.png:
            png = marked_png(draw_sheet(*about, self.units), self.mark)
            _write(self.folder / f"{evidence.name}.png", png)
        if evidence.best in crops:
            self.thumbs[evidence.name] = webp_address(draw_crop(crops[evidence.best], THUMB))

    def write_index(
        self, signs: Sequence[Evidence], reviews: Sequence[Path], *, images: bool
    ) -> list[str]:
        """Write the index, and all images where they are asked for; what became of reviews of earlier results."""
        known = KnownResult.of(self.out, self.route)
        review = find_review(self.out, reviews, known)
        pictures, lens = self._pictures(known, review), self.run.get("camera") if images else None
        if images and lens is None:
            raise InputError(f"--images: {self.out} does not state its camera. Run the log again.")
        about = {"log": str(self.run.get("log", ""))} | _about(known, review, pictures, lens)
        if images:
            _write(self.folder / IMAGES_FILE, self._images(known, signs))
        page = format_index(signs, self.thumbs, self.drive, about, self.mark, self.units)
        _write(self.folder / INDEX_FILE, page.encode())
        return review.notes

    def _pictures(self, known: KnownResult, review: Review) -> dict[int, str]:
        """What is to be decided as an earlier result saw it, by its number; where the log still has such an image."""
        boxes = {}
        for number, one in enumerate(review.undecided):
            for image, box in (view for entry in one.entries for view in entry.views):
                if image in known.cameras:
                    boxes[number] = (number, known.cameras[image]["frame"], box)
        crops = read_crops(self.out, self.log, boxes.values(), PROPORTION, blur=self.blur)
        found = {number: crop for number, crop in crops if crop is not None}
        return {n: webp_address(draw_crop(c, THUMB)) for n, c in found.items()}

    def _images(self, known: KnownResult, signs: Sequence[Evidence]) -> bytes:
        """A script with the undistorted image of each camera, in their order; empty where it does not decode."""
        lens = self.run["camera"]
        shown = dict.fromkeys((one["frame"] for one in known.cameras.values()), "")
        matrix = np.array([[lens["fx"], 0, lens["cx"]], [0, lens["fy"], lens["cy"]], [0, 0, 1]])
        blur = self.blur or read_settings(self.out, self.run).blur
        panels = defaultdict[int, list[Box]](list)
        for view in (view for one in signs for view in one.views):
            panels[view.frame].append(view.box)
        for image in read_images(self.out, self.log, shown.keys()):
            if (rgb := image.rgb) is not None:
                if blur:
                    rgb = blurred(rgb, panels[image.frame.index])
                plain = cv2.undistort(rgb, matrix, np.array(lens["distortion"], np.float64))
                size = (_IMAGE_WIDTH, round(_IMAGE_WIDTH * plain.shape[0] / plain.shape[1]))
                small = np.asarray(cv2.resize(plain, size, interpolation=cv2.INTER_AREA), np.uint8)
                shown[image.frame.index] = webp_address(small, _IMAGE_QUALITY)
        head, addresses = marked_head(self.mark).replace("*/", "* /"), json.dumps([*shown.values()])
        return f"/* {head} */\nconst waysideImages = {addresses};\n".encode()


def _about(
    known: KnownResult, review: Review, pictures: Mapping[int, str], lens: Mapping[str, Any] | None
) -> dict[str, Any]:
    """What the script of the index knows, so that a person can correct the result and place missing signs.

    `pictures`: addresses of images of what is to be decided, by number. `lens`: `camera` of `run.json`, without whose
    distortion the images are shown; None: there are no images.
    """
    cameras = [
        {"image": image, "x": one["x"], "y": one["y"], **known.measure(one["station_m"] or 0.0)}
        | {"turn": [round(value, 6) for value in one["turn"]]}
        for image, one in known.cameras.items()
    ]
    reviewed = [one.to_row() for one in (*review.rows.values(), *review.missing)]
    undecided = [
        {
            "words": one.words,
            "picture": pictures.get(number, ""),
            "options": [
                {"words": words, "row": row and row.to_row()} for words, row in one.options
            ],
            "entries": [entry.to_row() for entry in one.entries],
        }
        for number, one in enumerate(review.undecided)
    ]
    told = json.dumps([reviewed, undecided])
    return {
        "result": known.name,
        "rows": {sign_id: row.to_row() for sign_id, row in known.rows.items()},
        "reviews": reviewed,
        "seed": hashlib.sha256(told.encode()).hexdigest()[:8] if reviewed or undecided else "",
        "undecided": undecided,
        "cameras": cameras,
        "unit": next((one["measure_unit"] for one in known.measured), None),
        "lens": lens,
    }


def _fill(binder: _Binder, signs: list[Evidence], watch: Watcher) -> None:
    """Take the crops of all views from the log and finish every sign with its last one."""
    boxes = (((one, view), view.frame, view.box) for one in signs for view in one.views)
    open_signs = {one.name: one for one in signs}
    watch(0, len(signs))
    crops = read_crops(binder.out, binder.log, boxes, PROPORTION, blur=binder.blur)
    for (one, view), crop in crops:
        if crop is not None:
            binder.crops[one.name][view] = crop
        if view is one.views[-1]:
            binder.finish(open_signs.pop(one.name))
            watch(len(signs) - len(open_signs), len(signs))
    for one in open_signs.values():  # the log has become shorter since the run
        binder.finish(one)


def _write(path: Path, content: bytes) -> None:
    try:
        with create(path) as stream:
            stream.write(content)
    except OSError as error:
        raise not_written(path.parent, error, "the evidence") from error
