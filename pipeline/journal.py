"""What was found in each image and each step between two, kept on disk, so that a run that was killed can go on.

The stages that need one image alone and the motion take most of the time of a run. A run that goes on decodes the
images again, takes these results from the journal and tracks anew: the same arrays enter the stages that follow, so the
tables have the same bytes.

A journal is a line that says what it belongs to, and then entries of images and steps: length and CRC-32 of the
content, then the content, compressed. What follows an entry that is torn or altered is cut off.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.earlier_result import file_digest, log_fingerprint
from wayside.pipeline.model_files import Models
from wayside.pipeline.settings_file import settings_digest
from wayside.pipeline.writing import create, not_written
from wayside.schemas.detections import (
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

JOURNAL = ".wayside-journal"
_HEAD = struct.Struct("<II")
_ENTRY = struct.Struct("<Bq")  # kind, frame
_IMAGE, _STEP = 0, 1
_SYNC_S = 2.0
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
        raise UsageError(f"--resume: wanted a log that can be read again, found none at {log}")
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

    note: why one that stood there is not used, or not all of it; empty else. replayed: images in it.

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
        self._entries: dict[tuple[int, int], tuple[int, int]] = {}
        self.note = ""
        self._reading = threading.Lock()
        head = (json.dumps(key, sort_keys=True) + "\n").encode()
        try:
            self._stream = self._open(head)
        except OSError as error:
            raise not_written(folder, error, "to keep the journal here") from error
        self.replayed = sum(kind == _IMAGE for kind, _ in self._entries)
        self._synced = time.monotonic()

    def __contains__(self, frame: int) -> bool:
        return (_IMAGE, frame) in self._entries

    def replay(self, image: Image) -> Detections:
        """What was found in an image, which has been decoded again; from any thread."""
        return _unpacked(self._read(_IMAGE, image.frame.index), image)

    def record(self, found: Iterator[Detections]) -> Iterator[Detections]:
        """Pass results on, in order, and append those that are new.

        Raises
        ------
        OutputError
            The disk took no more.
        """
        for one in found:
            if one.frame.index not in self:
                self._append(_IMAGE, one.frame.index, _packed(one))
            yield one

    def close(self) -> None:
        """Leave the journal for the run that goes on."""
        with suppress(OSError):
            self._stream.close()

    def _open(self, head: bytes) -> io.BufferedRandom:
        with suppress(FileNotFoundError):
            opened = os.open(self._path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            stream = os.fdopen(opened, "r+b")
            if stream.readline() == head:
                end = self._scan(stream)
                if surplus := stream.seek(0, os.SEEK_END) - end:
                    self.note = (
                        f"--resume: {surplus} bytes of the journal are cut or altered and not used"
                    )
                stream.truncate(end)
                return stream
            stream.close()
            self.note = "--resume: the journal there is of another version, log, settings or models and not used"
            self._path.unlink()
        with create(self._path) as fresh:
            fresh.write(head)
        return self._path.open("r+b")

    def _scan(self, stream: io.BufferedRandom) -> int:
        """Find the whole entries; where the last of them ends."""
        end = stream.tell()
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            length, crc = _HEAD.unpack(head)
            content = stream.read(length)
            if len(content) < length or zlib.crc32(content) != crc:
                break
            if length < _ENTRY.size:
                break
            self._entries[_ENTRY.unpack_from(content)] = (end + _HEAD.size, length)
            end = stream.tell()
        return end

    def _read(self, kind: int, frame: int) -> bytes:
        at, length = self._entries[kind, frame]
        with self._reading:
            self._stream.seek(at + _ENTRY.size)
            content = self._stream.read(length - _ENTRY.size)
        return bytes(lz4.frame.decompress(content))

    def _append(self, kind: int, frame: int, body: bytes) -> None:
        content = _ENTRY.pack(kind, frame) + bytes(lz4.frame.compress(body))
        try:
            with self._reading:
                self._stream.seek(0, os.SEEK_END)
                self._stream.write(_HEAD.pack(len(content), zlib.crc32(content)) + content)
                self._stream.flush()
            if time.monotonic() > self._synced + _SYNC_S:
                os.fsync(self._stream.fileno())
                self._synced = time.monotonic()
        except OSError as error:
            raise not_written(self._path.parent, error, "to keep the journal here") from error


def remove_journal(folder: Path) -> None:
    """Remove the journal in a folder whose result stands: there is nothing left to resume."""
    with suppress(OSError):
        (folder / JOURNAL).unlink()


def _packed(found: Detections) -> bytes:
    """Counts, and the arrays of a frame, in one piece."""
    arrays = {
        **_arrays("region", found.candidates.regions),
        **_arrays("candidate", found.candidates),
        **_arrays("feature", found.features),
    }
    names = [(name, a.dtype.str, a.shape) for name, a in arrays.items()]
    seen = found.segmentation
    head = json.dumps([seen.region_count, seen.dropped, names]).encode()
    return b"".join([struct.pack("<I", len(head)), head, *(a.tobytes() for a in arrays.values())])


def _unpacked(body: bytes, image: Image) -> Detections:
    (length,) = struct.unpack_from("<I", body)
    region_count, dropped, names = json.loads(body[4 : 4 + length])
    at, parts = 4 + length, dict[str, dict[str, NDArray[Any]]](region={}, candidate={}, feature={})
    for name, kind, shape in names:
        count = int(np.prod(shape, dtype=np.int64))
        array = np.frombuffer(body, np.dtype(kind), count, at).reshape(shape).copy()
        part, _, column = name.partition(".")
        parts[part][column] = array
        at += array.nbytes
    seen = Segmentation(
        image,
        Regions.empty(),
        region_count,
        np.zeros((0, 3), np.float32),
        np.zeros(0, np.float32),
        (0, 0),
        dropped=Dropped(*dropped),
    )
    candidates = Candidates(Regions(**parts["region"]), **parts["candidate"])
    return Detections(seen, candidates, Features(**parts["feature"]))


def _arrays(part: str, table: object) -> dict[str, NDArray[Any]]:
    """The columns of a table that are there."""
    columns = {f"{part}.{f.name}": getattr(table, f.name) for f in fields(table)}  # type: ignore[arg-type]
    return {name: value for name, value in columns.items() if isinstance(value, np.ndarray)}


def _code_digest() -> str:
    """SHA-256 of all sources that a result depends on."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for room in ("schemas", "stages", "pipeline"):
        for path in sorted((root / room).rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()
