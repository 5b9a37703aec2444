"""What belongs to an exported row besides its figures: name of its best image, its sheet and its picture."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pyarrow as pa

from wayside.pipeline.evidence.crops import draw_crop, read_crops
from wayside.pipeline.exporting.table import Row, Source
from wayside.pipeline.files.pictures import encoded
from wayside.pipeline.fleet.manifest import DRIVES
from wayside.pipeline.results.result import read_rows
from wayside.schemas.labels import Box
from wayside.schemas.tables import FRAMES, SIGNS, Column

PICTURE = "picture"
_SIZE = 320, 240
_Key = tuple[Path, str]
_DRIVES_IN_MEMORY = 8
_COLUMNS = (
    Column("image_name", pa.string(), "", "file of its best image; null: none was imported"),
    Column("evidence", pa.string(), "", "its sheet, as seen from the file; null: not written"),
)
_PICTURE = Column(PICTURE, pa.binary(), "", "its best image, JPEG; null: the log does not give it")


def linked(source: Source, file: Path, *, pictures: bool, log: Path | None) -> Source:
    """The rows of signs or panels with links to files of the result; rows of other tables as they are.

    `pictures`: cut them out of the logs, which lie where they lay at the time of the run, or at `log`.
    """
    names = {column.name for column in source.columns}
    if not {"sign_id", "best_sign_id"} & names:
        return source

    links = lru_cache(maxsize=_DRIVES_IN_MEMORY)(_links)

    def chunks() -> Iterator[Sequence[Row]]:
        for rows in source.chunks():
            of = [_drive(source.folder, row) for row in rows]
            shown: dict[_Key, bytes] = {}
            for drive in dict.fromkeys(drive for drive, _ in of) if pictures else ():
                known = links(drive, file.parent)
                own = [key for key in of if key[0] == drive and key[1] in known]
                boxes: list[tuple[_Key, int, Box]] = [(k, *known[k[1]]["seen"]) for k in own]
                for key, crop in read_crops(drive, log, boxes, _SIZE[0] / _SIZE[1]):
                    if crop is not None:
                        shown[key] = encoded(draw_crop(crop, _SIZE), ".jpg")
            yield [
                row | links(key[0], file.parent).get(key[1], {}) | {PICTURE: shown.get(key)}
                for row, key in zip(rows, of, strict=True)
            ]

    return replace(
        source,
        columns=(*source.columns, *_COLUMNS, *([_PICTURE] if pictures else [])),
        chunks=chunks,
    )


def _links(folder: Path, beside: Path) -> dict[str, Row]:
    """Image name, address of the sheet, and frame and box of the best image, of each sign of a drive."""
    frames = read_rows(folder, FRAMES, ("frame", "image_name"))
    names, found = {one["frame"]: one["image_name"] for one in frames}, {}
    for row in read_rows(folder, SIGNS, ("sign_id", "best_frame", "best_box")):
        sheet = folder / "evidence" / f"{row['sign_id']}.html"
        address = Path(os.path.relpath(sheet, beside)).as_posix() if sheet.is_file() else None
        found[row["sign_id"]] = {
            "image_name": names.get(row["best_frame"]),
            "evidence": address,
            "seen": (row["best_frame"], tuple(row["best_box"])),
        }
    return found


def _drive(folder: Path, row: Row) -> _Key:
    """The result that shows a sign or panel best, and its sign."""
    drive = row.get("best_drive")
    return (folder / DRIVES / drive, row["best_sign_id"]) if drive else (folder, row["sign_id"])
