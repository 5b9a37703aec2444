"""Evidence of a result, a page a sign, made while its log is read once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wayside.pipeline.evidence.crops import Crop, draw_crop, read_crops
from wayside.pipeline.evidence.gather import DriveMap, Evidence, SignView, gather
from wayside.pipeline.evidence.index import Card, format_index
from wayside.pipeline.evidence.sheet import PROPORTION, draw_sheet, format_sheet
from wayside.pipeline.files.file_marks import is_marked, marked_png
from wayside.pipeline.files.output_folder import OutputFolder
from wayside.pipeline.files.webp import encode_webp
from wayside.pipeline.files.writing import create, not_written, refuse
from wayside.pipeline.results.result import read_run
from wayside.pipeline.reviewing.review import result_name

INDEX_FILE = "index.html"
THUMB = 240, 180
Watcher = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Written:
    """Pages in order of signs, the index (None: only one sign was asked for), how many views have no image."""

    sheets: tuple[Path, ...]
    index: Path | None
    lost_views: int


def write_evidence(
    out: Path,
    folder: Path,
    *,
    sign_id: str | None = None,
    log: Path | None = None,
    watch: Watcher = lambda done, total: None,
    png: bool = False,
    overwrite: bool = False,
) -> Written:
    """Write one page a sign and an index of all into `folder`.

    The log is read once; only images that show a sign are decoded, and only cut-outs of signs whose sheet is not
    drawn yet are kept.

    Parameters
    ----------
    out
        Folder written by `wayside run`.
    folder
        Where the sheets go, made where it is missing.
    sign_id
        Only the sheet of this sign, without index; None: all.
    log
        Path of the log now; None: that at the time of the run.
    watch
        Called with the number of sheets done and to do.
    png
        Also write each sheet as an image, to print or to send.
    overwrite
        Replace whatever stands there under the names of the sheets and the index; else only sheets of this log.

    Raises
    ------
    UsageError
        There is no such sign.
    InputError
        The result or the log cannot be used.
    OutputError
        A sheet cannot be written, or a file of its name stands there that is not replaced.
    """
    run = read_run(out)
    drive, signs = gather(out, sign_id)
    name = str(run.get("log", ""))
    mark = f"wayside {name} {run.get('log_fingerprint') or ''}".strip()
    with OutputFolder(folder) as output:
        binder = _Binder(output.part, drive, run, mark, png=png)
        names = [file for one in signs for file in binder.files(one)]
        if sign_id is None:
            names.append(INDEX_FILE)
            binder.link(signs)
        if not overwrite:
            _check_free(folder, names, mark)
        _fill(binder, signs, out, log, watch)
        if sign_id is None:
            cards = [Card(one.sign, binder.name(one), binder.thumbs.get(one.name)) for one in signs]
            index_page = format_index(cards, drive, name, result_name(run), mark)
            _write(output.part / INDEX_FILE, index_page.encode())
        output.commit([] if sign_id else _sheets_of_others(folder, mark, signs))
    sheets = tuple(folder / binder.name(one) for one in signs)
    return Written(sheets, None if sign_id else folder / INDEX_FILE, binder.lost_views)


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


class _Binder:
    """Keeps the cut-outs of every sign until its sheet can be drawn and written."""

    def __init__(
        self, folder: Path, drive: DriveMap, run: Mapping[str, Any], mark: str, *, png: bool
    ) -> None:
        self.folder, self.drive, self.run = folder, drive, run
        self.mark, self.png = mark, png
        self.neighbours: dict[str, dict[str, str]] = {}
        self.crops: defaultdict[str, dict[SignView, Crop]] = defaultdict(dict)
        self.thumbs: dict[str, bytes] = {}
        self.lost_views = 0

    def name(self, evidence: Evidence) -> str:
        """The page of a sign."""
        return f"{evidence.name}.html"

    def files(self, evidence: Evidence) -> list[str]:
        """All files of a sign."""
        return [self.name(evidence), *([f"{evidence.name}.png"] if self.png else [])]

    def link(self, signs: Sequence[Evidence]) -> None:
        """Let the pages of signs lead to each other, in this order, and to the index."""
        for number, one in enumerate(signs):
            beside = {"up": INDEX_FILE}
            if number:
                beside["prev"] = self.name(signs[number - 1])
            if number + 1 < len(signs):
                beside["next"] = self.name(signs[number + 1])
            self.neighbours[one.name] = beside

    def finish(self, evidence: Evidence) -> None:
        """Draw and write the sheet of a sign with what there is of it."""
        crops = self.crops.pop(evidence.name, {})
        self.lost_views += len(evidence.views) - len(crops)
        about = (evidence, crops, self.drive, self.run)
        page = format_sheet(*about, self.mark, self.neighbours.get(evidence.name, {}))
        _write(self.folder / self.name(evidence), page.encode())
        if self.png:
            png = marked_png(draw_sheet(*about), self.mark)
            _write(self.folder / f"{evidence.name}.png", png)
        if evidence.best in crops:
            thumb = draw_crop(crops[evidence.best], THUMB)
            self.thumbs[evidence.name] = encode_webp(thumb)


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
