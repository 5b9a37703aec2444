"""Evidence of a result, a page a sign, made while its log is read once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wayside.pipeline.evidence.crops import Crop, draw_crop, read_crops
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView, gather
from wayside.pipeline.evidence.marks import METRIC, Units
from wayside.pipeline.evidence.sheet import PROPORTION, draw_sheet, format_index, format_sheet
from wayside.pipeline.files.output_folder import OutputFolder
from wayside.pipeline.files.pictures import data_address, encode_webp, is_marked, marked_png
from wayside.pipeline.files.writing import create, not_written, refuse
from wayside.pipeline.results.result import read_run
from wayside.pipeline.reviewing.review import result_name
from wayside.schemas.settings import RouteSettings

INDEX_FILE = "index.html"
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


def write_evidence(  # noqa: PLR0913 - one for each option
    out: Path,
    folder: Path,
    *,
    sign_id: str | None = None,
    log: Path | None = None,
    watch: Watcher = lambda done, total: None,
    png: bool = False,
    units: Units = METRIC,
    route: RouteSettings | None = None,
    overwrite: bool = False,
) -> Written:
    """Write one page a sign and an index of all into `folder`, which is made where it is missing.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    sign_id, log
        Only the sheet of this sign, without index, None: all; path of the log now, None: that at the time of the run.
    watch, png
        Called with the number of sheets done and to do; whether to write each as an image, too.
    units, route
        Of lengths on the pages; with a milepost, instead of that of the run.
    overwrite
        Replace any file of the names of the sheets and the index; else only sheets of this log.

    Raises
    ------
    UsageError
        There is no such sign.
    InputError
        The result or the log cannot be used.
    OutputError
        A sheet cannot be written, or a file of its name is not replaced.
    """
    run = read_run(out)
    drive, signs = gather(out, sign_id, route)
    name = str(run.get("log", ""))
    mark = f"wayside {name} {run.get('log_fingerprint') or ''}".strip()
    names = [f"{one.name}.html" for one in signs]
    images = [f"{one.name}.png" for one in signs] if png else []
    index = [INDEX_FILE] if sign_id is None else []
    around = zip(signs, ["", *names], [*names[1:], ""], strict=False) if index else ()
    beside = {one.name: _beside(before, after) for one, before, after in around}
    with OutputFolder(folder) as output:
        if not overwrite:
            _check_free(folder, [*names, *images, *index], mark)
        binder = _Binder(output.part, drive, run, mark, png, units, beside)
        _fill(binder, signs, out, log, watch)
        if index:
            about = {"log": name, "result": result_name(run)}
            page = format_index(signs, binder.thumbs, drive, about, mark, units)
            _write(output.part / INDEX_FILE, page.encode())
        output.commit(_sheets_of_others(folder, mark, signs) if index else [])
    return Written(
        tuple(folder / page for page in names),
        folder / INDEX_FILE if index else None,
        binder.lost_views,
    )


def _beside(before: str, after: str) -> dict[str, str]:
    """Pages that a sheet leads to, by how."""
    pages = {"prev": before, "up": INDEX_FILE, "next": after}
    return {rel: page for rel, page in pages.items() if page}


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
    drive: DriveMap
    run: Mapping[str, Any]
    mark: str
    png: bool
    units: Units
    neighbours: Mapping[str, dict[str, str]]
    crops: defaultdict[str, dict[SignView, Crop]] = field(default_factory=lambda: defaultdict(dict))
    thumbs: dict[str, str] = field(default_factory=dict)
    lost_views: int = 0

    def finish(self, evidence: Evidence) -> None:
        """Draw and write the sheet of a sign with what there is of it."""
        crops = self.crops.pop(evidence.name, {})
        self.lost_views += len(evidence.views) - len(crops)
        about = (evidence, crops, self.drive, self.run)
        beside = self.neighbours.get(evidence.name, {})
        page = format_sheet(*about, self.mark, beside, self.units)
        _write(self.folder / f"{evidence.name}.html", page.encode())
        if self.png:
            png = marked_png(draw_sheet(*about, self.units), self.mark)
            _write(self.folder / f"{evidence.name}.png", png)
        if evidence.best in crops:
            thumb = encode_webp(draw_crop(crops[evidence.best], THUMB))
            self.thumbs[evidence.name] = data_address(thumb)


def _fill(
    binder: _Binder, signs: list[Evidence], out: Path, log: Path | None, watch: Watcher
) -> None:
    """Take the crops of all views from the log and finish every sign with its last one."""
    boxes = (((one, view), view.frame, view.box) for one in signs for view in one.views)
    open_signs = {one.name: one for one in signs}
    watch(0, len(signs))
    for (one, view), crop in read_crops(out, log, boxes, PROPORTION):
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
