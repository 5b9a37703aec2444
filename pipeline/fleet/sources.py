"""The logs of a fleet: files, folders, patterns, lists, and URLs of any storage that fsspec reaches."""

import glob
import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote, urlsplit

from wayside.pipeline.files.input_files import files_below, read_input_text
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.files.writing import UNWRITABLE, not_written
from wayside.pipeline.results.result import stream_fingerprint
from wayside.schemas.errors import InputError, UsageError, WaysideError

_SUFFIX = ".mcap"
_PATTERN = "*?["
_QUOTED = r"""^(["'])(.*)\1$"""
"""As file managers write a path."""
_MOST_BYTES = 250
"""Of the name of a log: names of files, with `.mcap` or `.txt` behind it, have at most 255."""


class UnreachableError(InputError):
    """A log cannot be read now; another time it may be."""


def expand_sources(given: Iterable[str]) -> list[str]:
    """The logs that are meant, each once, in order: absolute paths and URLs.

    `given`: files, folders (every `.mcap` below), patterns (`*`, `?`, `[...]`, `**`), or URLs of these. `@FILE` is a
    list of them, one a line, with comments after `#`. Relative paths are relative to the working folder. Raises
    UsageError where there is no log, a list cannot be read, or a URL needs a package that is not installed.
    """
    return list(dict.fromkeys(uri for text in given for uri in _expanded(text)))


def source_name(uri: str) -> tuple[str, str]:
    """Stem of the log's file name and the name of the folder it lies in, which may be empty."""
    first = uri.partition("::")[0]  # fsspec chains: the file in front, its container behind
    path = PurePosixPath(unquote(urlsplit(first).path)) if _is_url(uri) else Path(uri)
    return path.stem or "log", path.parent.name


def folder_name(text: str) -> str:
    """A text as the name of a folder: what a file system or shell reads as anything else is replaced.

    A digest of the whole ends a name that would be too long, so that no two have one.
    """
    name = re.sub(r'[/\\*?"<>|]', "_", visible(text)).lstrip(".") or "log"
    if is_folder_name(name):
        return name
    end = f"-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()[:12]}"
    return name.encode()[: _MOST_BYTES - len(end)].decode("utf-8", "ignore") + end


def is_folder_name(name: str) -> bool:
    """Whether a text is the name of one folder, as this and earlier versions make them, and leads nowhere else."""
    single = Path(name).name == name and visible(name) == name and name[:1] not in ("", ".")
    return single and len(name.encode()) <= _MOST_BYTES


def fingerprint_source(uri: str) -> tuple[str, int]:
    """Which recording a log is (`log_fingerprint`) and its length in bytes; of a URL, 2 MiB are read.

    Raises UnreachableError where it cannot be read.
    """
    path = Path(uri)
    if not _is_url(uri) and not path.is_file():
        found = "this is a folder, not a log" if path.is_dir() else "there is no such log"
        raise UnreachableError(f"{uri}: {found}")
    with _reading(uri):
        if _is_url(uri):
            system, inner = _file_system(uri)
            size, opened = int(system.size(inner)), system.open(inner, "rb", cache_type="none")
        else:
            size, opened = path.stat().st_size, path.open("rb")
        with opened as stream:
            return stream_fingerprint(stream, size), size


@contextmanager
def fetched(uri: str) -> Iterator[Path]:
    """A log as a local file; that of a URL is loaded into a scratch folder, which goes with the block.

    Raises UnreachableError where it cannot be read, and OutputError where the scratch folder (`TMPDIR`) cannot take it.
    """
    if not _is_url(uri):
        yield Path(uri)
        return
    with TemporaryDirectory(prefix="wayside-") as scratch:
        path = Path(scratch) / f"{folder_name(source_name(uri)[0])}{_SUFFIX}"
        with _reading(uri):
            system, inner = _file_system(uri)
            try:
                system.get_file(inner, str(path))
            except OSError as error:
                if error.errno not in UNWRITABLE:
                    raise
                instead = "point TMPDIR to another folder"
                raise not_written(path.parent, error, "a loaded log", instead) from error
        yield path


def _expanded(text: str) -> list[str]:
    path = Path(text)
    if text.startswith("@"):
        found = _listed(Path(text[1:]))
    elif _is_url(text):
        found = _stored(text)
    elif os.path.isdir(path):  # no error where it lies in a folder that cannot be searched
        logs = [p for p in files_below(path) if p.suffix.lower() == _SUFFIX and p.is_file()]
        found = sorted(str(p.absolute()) for p in logs)
    elif not os.path.exists(path) and any(c in text for c in _PATTERN):
        names = glob.glob(text, recursive=True)
        found = sorted(str(Path(name).absolute()) for name in names if os.path.isfile(name))
    else:
        found = [str(path.absolute())]
    if not found:
        raise UsageError(f"{text}: there are no logs ({_SUFFIX}) here")
    return found


def _listed(file: Path) -> list[str]:
    try:
        lines = [line.strip() for line in read_input_text(file).splitlines()]
    except (OSError, ValueError) as error:
        raise UsageError(
            f"@{file}: the list of logs cannot be read: {error}. Write one log per line."
        ) from error
    lines = [re.sub(_QUOTED, r"\2", line).strip() for line in lines]
    entries = [line for line in lines if line and not line.startswith("#")]
    if nested := [line for line in entries if line.startswith("@")]:
        raise UsageError(f"@{file}: the list names another list, {nested[0]}. Name logs only.")
    return [uri for line in entries for uri in _expanded(line)]


def _stored(url: str) -> list[str]:
    with _reading(url):
        system, inner = _file_system(url)
        if any(c in inner for c in _PATTERN):
            found = system.glob(inner)
        elif system.isdir(inner):
            found = [p for p in system.find(inner) if p.lower().endswith(_SUFFIX)]
        else:
            return [url]
        container = "".join(url.partition("::")[1:])  # of the files that were found
        return [name + container for name in sorted(map(str, map(system.unstrip_protocol, found)))]


@contextmanager
def _reading(uri: str) -> Iterator[None]:
    """Turn what a storage raises, errors of its own, into UnreachableError."""
    try:
        yield
    except WaysideError:
        raise
    except Exception as error:
        raise UnreachableError(
            f"{uri}: the log cannot be read: {type(error).__name__}: {error}. Try again, or check the address and "
            "access."
        ) from error


def _file_system(url: str) -> tuple[Any, str]:
    """The storage of a URL and the name in it; fsspec has no types."""
    try:
        from fsspec.core import url_to_fs

        system, inner = url_to_fs(url)
    except ImportError as error:
        raise UsageError(
            f"{url}: the package that reads this storage is missing: {error}. URLs need `pip install "
            "'wayside[fleet]'`, and s3fs, gcsfs or adlfs for S3, Google and Azure."
        ) from error
    except ValueError as error:
        raise UsageError(f"{url}: fsspec does not know this kind of URL: {error}") from error
    return system, str(inner)


def _is_url(text: str) -> bool:
    return "://" in text
