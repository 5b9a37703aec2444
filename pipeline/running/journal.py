"""What was found in each image, kept on disk, so that a run that was killed can go on.

The stages that need one image alone take most of the time of a run. A resumed run decodes the images again, takes these
results from the journal, and measures motion and tracks again. The later stages get the same arrays, and the tables
have the same bytes.

A journal is a list of entries: number, length and CRC-32, then the content. The first is the key, which says what all
results depend on; each other one holds the arrays of an image in NumPy's format, without pickles. What follows
an entry that is torn or altered is cut off.
"""

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
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from wayside.pipeline.files.settings_file import settings_digest
from wayside.pipeline.files.writing import create, not_written
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.models.model_json import digest
from wayside.pipeline.results.result import file_digest, log_fingerprint
from wayside.schemas.detections import Candidates, Detections, Dropped, Features, Regions
from wayside.schemas.errors import UsageError
from wayside.schemas.frame import Image
from wayside.schemas.settings import Settings
from wayside.stages.segmentation import unsegmented

JOURNAL = ".wayside-journal"
_HEAD = struct.Struct("<III")
_SYNC_S = 2.0
_PACKAGES = (
    *("lz4", "numba", "numpy", "onnxruntime", "opencv-python-headless"),
    *("pyproj", "scipy", "simplejpeg"),
)
T = TypeVar("T", Candidates, Features, Regions)


def journal_key(log: Path, settings: Settings, models: Models) -> dict[str, Any]:
    """All that the results of an image depend on; raises UsageError where the log is no file that can be read again."""
    fingerprint = log_fingerprint(log)
    if fingerprint is None:
        raise UsageError(f"--resume: there is no log at {log} that can be read again")
    machine = [platform.machine(), platform.processor(), platform.python_version()]
    return _key(settings, models.digests()) | {"log": fingerprint, "machine": machine}


def result_key(log: Path, settings: Settings, digests: dict[str, str], **how: bool) -> str | None:
    """Digest of all that the tables of a run depend on, models by their `digests`; None for what is no file.

    how: `every_region` of its `RunRequest`, and `self_calibrate`: whether it calibrates.
    """
    fingerprint, key_of = log_fingerprint(log), result_keys(settings, digests, **how)
    return None if fingerprint is None else key_of(fingerprint)


def result_keys(
    settings: Settings,
    digests: dict[str, str],
    *,
    every_region: bool = False,
    self_calibrate: bool = False,
) -> Callable[[str], str]:
    """The same for many logs: a function of the fingerprint of each."""
    rest = _key(settings, digests) | {"how": [every_region, self_calibrate]}
    return lambda fingerprint: digest(json.dumps(rest | {"log": fingerprint}, sort_keys=True))


def _key(settings: Settings, digests: dict[str, str]) -> dict[str, Any]:
    return {
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

    `folder`: of the output, locked by the caller. `key`: what results depend on; a journal of another key is replaced.

    Raises OutputError where the journal cannot be read or written.
    """

    def __init__(self, folder: Path, key: dict[str, Any]) -> None:
        self._path = folder / JOURNAL
        self._entries: dict[int, tuple[int, int]] = {}
        self.note = ""
        """Why an earlier journal is not used, or not all of it."""
        self._at_work, self._synced = threading.Lock(), time.monotonic()
        try:
            self._stream = self._open(json.dumps(key, sort_keys=True).encode())
        except OSError as error:
            raise not_written(folder, error, "the journal") from error
        self.replayed = len(self._entries)
        """Number of images in it."""

    def __contains__(self, frame: int) -> bool:
        return frame in self._entries

    def replay(self, image: Image) -> Detections | None:
        """What was found in an image, which has been decoded again; from any thread. None: it was of another size."""
        at, length = self._entries[image.frame.index]
        with self._at_work:
            self._stream.seek(at)
            content = self._stream.read(length)
        with np.load(io.BytesIO(content), allow_pickle=False) as held:
            arrays: dict[str, Any] = dict(held)
        width, height, region_count, *dropped = arrays["counts"].tolist()
        if (width, height) != _size(image):
            return None
        arrays["regions"] = _table(Regions, arrays)
        seen = replace(unsegmented(image), region_count=region_count, dropped=Dropped(*dropped))
        return Detections(seen, _table(Candidates, arrays), _table(Features, arrays))

    def record(self, found: Iterator[Detections]) -> Iterator[Detections]:
        """Pass results on, in order, and append those that are new; raises OutputError where the disk took no more."""
        for one in found:
            if one.frame.index not in self:
                try:
                    self._append(one)
                except OSError as error:
                    raise not_written(self._path.parent, error, "the journal") from error
            yield one

    def close(self) -> None:
        """Leave the journal for the run that goes on."""
        with suppress(OSError):
            self._stream.close()

    def _open(self, key: bytes) -> BinaryIO:
        with suppress(FileNotFoundError):
            opened = os.open(self._path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            stream = os.fdopen(opened, "r+b")
            if end := self._scan(stream, key):
                if surplus := stream.seek(0, os.SEEK_END) - end:
                    self.note = (
                        f"--resume: {surplus} bytes of the journal are cut or altered and not used"
                    )
                stream.truncate(end)
                return stream
            stream.close()
            self._path.unlink()
            self.note = (
                "--resume: the journal there is of another version, log, settings or models, or was altered, and is "
                "not used"
            )
        create(self._path).close()
        stream = self._path.open("r+b")
        _write(stream, 0, key)
        return stream

    def _scan(self, stream: BinaryIO, key: bytes) -> int:
        """Find the whole entries and the end of the last one; 0 where the first is not this key."""
        end, following = 0, 0
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            number, length, crc = _HEAD.unpack(head)
            content = stream.read(length)
            whole = len(content) == length and zlib.crc32(content, number) == crc
            if not whole or number < following or (not following and content != key):
                break
            if following:
                self._entries[number - 1] = (end + _HEAD.size, length)
            end, following = stream.tell(), number + 1
        return end

    def _append(self, found: Detections) -> None:
        seen, candidates = found.segmentation, found.candidates
        tables = (candidates.regions, candidates, found.features)
        columns = {f.name: getattr(table, f.name) for table in tables for f in fields(table)}
        arrays = {
            name: column for name, column in columns.items() if isinstance(column, np.ndarray)
        }
        arrays["counts"] = np.array([*_size(found.image), seen.region_count, *seen.dropped])
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **arrays)
        with self._at_work:
            self._stream.seek(0, os.SEEK_END)
            _write(self._stream, found.frame.index + 1, content.getvalue())
        if time.monotonic() > self._synced + _SYNC_S:
            os.fsync(self._stream.fileno())
            self._synced = time.monotonic()


def remove_journal(folder: Path) -> None:
    """Remove the journal in a folder whose result stands: there is nothing left to resume."""
    with suppress(OSError):
        (folder / JOURNAL).unlink()


def _write(stream: BinaryIO, number: int, content: bytes) -> None:
    """Append an entry: the key is number 0, a frame follows its index by one."""
    stream.write(_HEAD.pack(number, len(content), zlib.crc32(content, number)) + content)
    stream.flush()


def _size(image: Image) -> tuple[int, int]:
    """Width and height of the pixels; zeros where there are none."""
    return (0, 0) if image.grey is None else (image.grey.shape[1], image.grey.shape[0])


def _table(kind: type[T], arrays: dict[str, Any]) -> T:
    return kind(**{f.name: arrays[f.name] for f in fields(kind) if f.name in arrays})


def _code_digest() -> str:
    """SHA-256 of all sources that a result depends on."""
    root = Path(__file__).parents[2]
    found = hashlib.sha256()
    for room in ("schemas", "stages", "pipeline"):
        for path in sorted([*(root / room).rglob("*.py"), *(root / room).rglob("*.csv")]):
            found.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return found.hexdigest()
