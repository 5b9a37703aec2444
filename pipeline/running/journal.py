"""What was found in each image, kept on disk, so that a run that was killed can go on.

The stages that need one image alone take most of the time of a run. A resumed run decodes the images again, takes these
results from the journal, and measures motion and tracks again. The later stages get the same arrays, and the tables
have the same bytes.

A journal is an entry for each frame, in order: length and CRC-32 of the content, then the content. The content is an
Arrow IPC stream of one row, whose schema names the columns and the run of the journal. What follows an entry that is
torn or altered is cut off; values that no run finds make all of it void. The checks are against damage, and against
values that would crash later stages. A signature would protect nothing, because whoever can write a journal can write
the tables as well.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline.files.settings_file import settings_digest
from wayside.pipeline.files.writing import create, not_written
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.results.earlier_result import file_digest, log_fingerprint
from wayside.schemas.detections import (
    COLORS,
    NONE,
    SHAPES,
    SOURCES,
    VERDICTS,
    Candidates,
    Detections,
    Dropped,
    Features,
    Regions,
    Segmentation,
)
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Image
from wayside.schemas.settings import Settings
from wayside.stages.geometry import ideal_points

JOURNAL = ".wayside-journal"
_HEAD = struct.Struct("<II")
_SYNC_S = 2.0
T = TypeVar("T", Candidates, Features, Regions)
_PACKAGES = (
    "lz4",
    "numba",
    "numpy",
    "onnxruntime",
    "opencv-python-headless",
    "pyproj",
    "scipy",
    "simplejpeg",
)


def journal_key(log: Path, settings: Settings, models: Models) -> dict[str, Any]:
    """All that the results of an image depend on: the log, settings, models, files, code, packages and processor.

    Raises
    ------
    UsageError
        The log is no file that can be read again.
    """
    fingerprint = log_fingerprint(log)
    if fingerprint is None:
        raise UsageError(f"--resume: there is no log at {log} that can be read again")
    return _key(fingerprint, settings, models.digests()) | {
        "machine": [platform.machine(), platform.processor(), platform.python_version()],
    }


def result_key(
    log: Path, settings: Settings, digests: dict[str, str], *, every_region: bool
) -> str | None:
    """Digest of all that the tables of a run depend on, models by their `digests`; None for what is no file."""
    fingerprint = log_fingerprint(log)
    if fingerprint is None:
        return None
    return result_keys(settings, digests, every_region=every_region)(fingerprint)


def result_keys(
    settings: Settings, digests: dict[str, str], *, every_region: bool
) -> Callable[[str], str]:
    """The same for many logs: a function of the fingerprint of each."""
    rest = _key("", settings, digests) | {"every_region": every_region}

    def of(fingerprint: str) -> str:
        return hashlib.sha256(
            json.dumps(rest | {"log": fingerprint}, sort_keys=True).encode()
        ).hexdigest()

    return of


def _key(fingerprint: str, settings: Settings, digests: dict[str, str]) -> dict[str, Any]:
    return {
        "log": fingerprint,
        "settings": settings_digest(settings),
        "models": digests,
        "files": [
            file_digest(Path(name)) if name and Path(name).is_file() else name
            for name in (settings.read.calibration, settings.models.classes, settings.route.file)
        ],
        "code": _code_digest(),
        "packages": {name: version(name) for name in _PACKAGES},
    }


class Journal:
    """The results of the first frames of a log, by frame; more are appended in order.

    note: why an earlier journal is not used, or not all of it; empty else. replayed: images in it.

    Parameters
    ----------
    folder
        The output folder, locked by the caller.
    key
        What the results depend on; a journal of another key is begun anew.

    Raises
    ------
    OutputError
        The journal cannot be read or written.
    """

    def __init__(self, folder: Path, key: dict[str, Any]) -> None:
        self._path = folder / JOURNAL
        self._schema = _COLUMNS.with_metadata({"key": json.dumps(key, sort_keys=True)})
        self._entries: dict[int, tuple[int, int]] = {}
        self.note = ""
        self._reading = threading.Lock()
        try:
            self._stream = self._open()
        except OSError as error:
            raise not_written(folder, error, "the journal") from error
        self.replayed = len(self._entries)
        self._synced = time.monotonic()

    def __contains__(self, frame: int) -> bool:
        return frame in self._entries

    def replay(self, image: Image) -> Detections | None:
        """What was found in an image, which has been decoded again; from any thread. None: it was of another size."""
        at, length = self._entries[image.frame.index]
        with self._reading:
            self._stream.seek(at)
            content = self._stream.read(length)
        counts, candidates, features = _read(content, self._schema)
        if (counts["width"], counts["height"]) != _size(image):
            return None
        if image.frame.camera is not None:
            ideal = ideal_points(image.frame.camera, candidates.center)
            candidates = replace(candidates, ideal=ideal)
        seen = Segmentation(
            image,
            Regions.empty(),
            counts["region_count"],
            np.zeros((0, 3), np.float32),
            np.zeros(0, np.float32),
            (0, 0),
            dropped=Dropped(*(counts[reason] for reason in Dropped._fields)),
        )
        return Detections(seen, candidates, features)

    def record(self, found: Iterator[Detections]) -> Iterator[Detections]:
        """Pass results on, in order, and append those that are new.

        Raises
        ------
        OutputError
            The disk took no more.
        """
        for one in found:
            if one.frame.index not in self:
                self._append(_written(one, self._schema))
            yield one

    def close(self) -> None:
        """Leave the journal for the run that goes on."""
        with suppress(OSError):
            self._stream.close()

    def _open(self) -> BinaryIO:
        with suppress(FileNotFoundError):
            opened = os.open(self._path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            stream = os.fdopen(opened, "r+b")
            try:
                end = self._scan(stream)
            except ValueError:
                stream.close()
                self._path.unlink()
                self._entries.clear()
                self.note = (
                    "--resume: the journal there is of another version, log, settings or models, "
                    "or was altered, and is not used"
                )
            else:
                if surplus := stream.seek(0, os.SEEK_END) - end:
                    self.note = (
                        f"--resume: {surplus} bytes of the journal are cut or altered and not used"
                    )
                stream.truncate(end)
                return stream
        create(self._path).close()
        return self._path.open("r+b")

    def _scan(self, stream: BinaryIO) -> int:
        """Find the whole entries and the end of the last one; ValueError for an entry that no such run writes."""
        end, last = 0, -1
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            length, crc = _HEAD.unpack(head)
            content = stream.read(length)
            if len(content) < length or zlib.crc32(content) != crc:
                break
            frame = _read(content, self._schema)[0]["frame"]
            if frame <= last:
                raise ValueError("images out of order")
            self._entries[frame] = (end + _HEAD.size, length)
            end, last = stream.tell(), frame
        return end

    def _append(self, content: bytes) -> None:
        try:
            with self._reading:
                self._stream.seek(0, os.SEEK_END)
                self._stream.write(_HEAD.pack(len(content), zlib.crc32(content)) + content)
                self._stream.flush()
            if time.monotonic() > self._synced + _SYNC_S:
                os.fsync(self._stream.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise not_written(self._path.parent, error, "the journal") from error


def remove_journal(folder: Path) -> None:
    """Remove the journal in a folder whose result stands: there is nothing left to resume."""
    with suppress(OSError):
        (folder / JOURNAL).unlink()


def _written(found: Detections, schema: pa.Schema) -> bytes:
    """What was found in one image, as the content of an entry."""
    seen, size = found.segmentation, _size(found.image)
    counts = dict(
        zip(_COUNTS, (found.frame.index, *size, seen.region_count, *seen.dropped), strict=True)
    )
    arrays = _arrays(found.candidates.regions, found.candidates, found.features)
    columns: list[Any] = [pa.array([count], pa.int32()) for count in counts.values()]
    for field in schema:
        if field.name not in counts:
            values = arrays.get(field.name)
            columns.append(pa.array([None if values is None else values.reshape(-1)], field.type))
    sink, options = pa.BufferOutputStream(), pa.ipc.IpcWriteOptions(compression="lz4")
    with pa.ipc.new_stream(sink, schema, options=options) as stream:
        stream.write_batch(pa.record_batch(columns, schema=schema))
    return bytes(sink.getvalue())


def _read(content: bytes, schema: pa.Schema) -> tuple[dict[str, int], Candidates, Features]:
    """Counts, candidates and key points of an entry; raises ValueError for what no run with this schema finds."""
    try:
        with pa.ipc.open_stream(content) as stream:
            row = stream.read_next_batch()
        row.validate(full=True)
    except (pa.ArrowException, OSError, StopIteration) as error:
        raise ValueError("no table") from error
    if row.num_rows != 1 or not row.schema.equals(schema, check_metadata=True):
        raise ValueError("another table")
    columns: dict[str, Any] = dict(zip(schema.names, row.columns, strict=True))
    counts = {name: int(columns[name].to_numpy()[0]) for name in _COUNTS}
    arrays: dict[str, Any] = {
        name: columns[name].flatten().to_numpy().reshape(-1, *empty.shape[1:]).copy()
        for name, empty in _EMPTY.items()
        if not (name in _OPTIONAL and columns[name].null_count)
    }
    _check(counts, arrays)
    arrays |= {"regions": _table(Regions, arrays), "ideal": arrays["center"].copy()}
    return counts, _table(Candidates, arrays), _table(Features, arrays)


def _check(counts: dict[str, int], arrays: dict[str, NDArray[Any]]) -> None:
    """Raise ValueError for numbers that cannot be: outside of the image, no such class, or not finite."""
    size, most, box = (counts["width"], counts["height"]), np.finfo(np.float32).max, arrays["box"]
    bounds: dict[str, tuple[Any, Any]] = {
        "box": (0, size * 2),
        "area_px": (0, most),
        "rgb": (0, 255),
        "source": (0, len(SOURCES) - 1),
        "center": (-1, size),
        "color": (NONE, len(COLORS) - 1),
        "shape": (NONE, len(SHAPES) - 1),
        "verdict": (0, len(VERDICTS) - 1),
        "corners": (-1, size),
        "sign_points": (-1, size),
        "sign_descriptors": (0, most),
        "sign_rows": (0, len(box) - 1),
    }
    for name, array in arrays.items():
        low, high = bounds.get(name, (-most, most))
        inside = (array >= low) & (array <= high)
        if name not in bounds:  # nan where not known
            inside |= array != array
        if not inside.all():
            raise ValueError(f"{name} out of bounds")
    points, signs = ("corners", "descriptors"), ("sign_points", "sign_descriptors", "sign_rows")
    same = all(len({len(arrays[name]) for name in names}) == 1 for names in (points, signs))
    if not (same and min(counts.values()) >= 0 and (box[:, :2] < box[:, 2:]).all()):
        raise ValueError("counts or boxes that cannot be")


def _size(image: Image) -> tuple[int, int]:
    """Width and height of the pixels; zeros where there are none."""
    return (0, 0) if image.grey is None else (image.grey.shape[1], image.grey.shape[0])


def _arrays(*tables: Regions | Candidates | Features) -> dict[str, NDArray[Any]]:
    """The columns of tables that are there, but for the ideal centres, which follow from the measured ones."""
    columns = {f.name: getattr(table, f.name) for table in tables for f in fields(table)}
    return {n: v for n, v in columns.items() if isinstance(v, np.ndarray) and n != "ideal"}


def _table(kind: type[T], arrays: dict[str, Any]) -> T:
    return kind(**{f.name: arrays[f.name] for f in fields(kind) if f.name in arrays})


_OPTIONAL: dict[str, Any] = {
    "color_log_probability": np.zeros((0, len(COLORS)), np.float32),
    "shape_log_probability": np.zeros((0, len(SHAPES)), np.float32),
    "back_score": np.zeros(0, np.float32),
}
_EMPTY = _arrays(Regions.empty(), Candidates.of(Regions.empty()), Features.empty()) | _OPTIONAL
"""Every column of arrays, without rows."""
_COUNTS = ("frame", "width", "height", "region_count", *Dropped._fields)
_COLUMNS = pa.schema(
    [
        *((name, pa.int32()) for name in _COUNTS),
        *((name, pa.list_(pa.from_numpy_dtype(a.dtype))) for name, a in _EMPTY.items()),
    ]
)


def _code_digest() -> str:
    """SHA-256 of all sources that a result depends on."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for room in ("schemas", "stages", "pipeline"):
        files = (path for kind in ("*.py", "*.csv") for path in (root / room).rglob(kind))
        for path in sorted(files):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()
