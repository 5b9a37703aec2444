"""Images given to a command, and the order in which they were taken: by folder, date of capture and number.

Where all names have the form of DCF (JEITA CP-3461), this is its number: four free characters and a number from 0001 to
9999, as in G0010001.JPG. In other names it is the last number.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from hashlib import blake2b
from itertools import accumulate, chain, pairwise
from pathlib import Path

from wayside.pipeline.files.input_files import read_input
from wayside.pipeline.reading.image_headers import Exif, ImageHeader, read_exif, read_image_header
from wayside.schemas.errors import InputError

_SUFFIXES = {".jpg", ".jpeg", ".png"}
_WIDEST_GAP = 20
_LEAST_LAST = 9999
"""The smallest number at which a counter starts again: the last one of DCF."""
_DCF = re.compile(r"(?=.*\D)(.{4})(\d{4})", re.DOTALL)
_LAST_NUMBER = re.compile(r"()(?:.*\D)?(\d+)\D*", re.DOTALL)
_MOST_SHOWN = 4

_Numbers = list[tuple[str, int]]


@dataclass(frozen=True, slots=True)
class ImageFile:
    """A JPEG or PNG file; digest: of all its bytes, the same only for copies."""

    path: Path
    header: ImageHeader
    exif: Exif
    digest: bytes

    @property
    def shown(self) -> str:
        """Folder and name."""
        return f"{self.path.parent.name}/{self.path.name}"


def image_files(paths: Sequence[Path]) -> Iterator[Path]:
    """Files among `paths`, dangling links too, and what has a name of a JPEG or PNG file in folders.

    Raises InputError for what is missing, and for a folder that cannot be listed.
    """
    for path in paths:
        if path.is_dir():
            try:
                yield from (f for f in sorted(path.iterdir()) if f.suffix.lower() in _SUFFIXES)
            except OSError as error:
                raise InputError(
                    f"{path}: the folder cannot be listed: {error.strerror}; check its permissions"
                ) from error
        elif path.is_symlink() or path.exists():
            yield path
        else:
            raise InputError(f"{path}: no such file; check the name")


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sort key by which numbers in a name compare as numbers: image 2 comes before image 10."""
    return _pieces(path.name), str(path)


def _pieces(text: str) -> list[tuple[int, int, str]]:
    pieces = re.split(r"(\d+)", text.lower())
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces if p]


def read_image_file(path: Path) -> ImageFile | str:
    """Header data of an image file, or in words why it cannot be imported."""
    try:
        path.name.encode()
        data = read_input(path)
    except UnicodeEncodeError:
        return "its name is not UTF-8"
    except OSError as error:
        dangling = path.is_symlink() and not path.exists()
        return "a broken link" if dangling else error.strerror or str(error)
    header = read_image_header(data)
    if header is None or header.encoding not in ("jpeg", "png"):
        return "no JPEG or PNG image, or cut off" if data else "empty"
    return ImageFile(path, header, read_exif(data), blake2b(data).digest())


def copies_among(images: Sequence[ImageFile]) -> dict[Path, Path]:
    """Files that agree in every byte with another, each with the one of these that has the shortest name."""
    originals: dict[bytes, Path] = {}
    for image in sorted(images, key=lambda image: len(image.path.name)):
        originals.setdefault(image.digest, image.path)
    return {one.path: originals[one.digest] for one in images if one.path != originals[one.digest]}


def in_order(
    images: Sequence[ImageFile], copies: Mapping[Path, Path], forced: str = ""
) -> list[ImageFile]:
    """The images in the order in which they were taken.

    Within a folder the numbers of the names tell it. A counter that starts again behind 9999 (99999 and so on) is
    followed where the dates of capture do not contradict this. Folders are sorted by their dates, else by the numbers
    in their names. `copies`: of other images, their dates are no witness. `forced`: "name" or "date" alone decides.

    Raises InputError where dates contradict the order of names (with both orders), or one is wanted and missing.
    """
    folders: dict[Path, list[ImageFile]] = {}
    for image in images:
        folders.setdefault(image.path.parent, []).append(image)
    held = [sorted(folder, key=lambda i: natural_key(i.path)) for folder in folders.values()]
    dates = {image.path: image.exif.taken for image in images if image.exif.taken is not None}
    if not all(date.tzinfo for date in dates.values()):  # offsets count where all have one
        dates = {path: date.replace(tzinfo=None) for path, date in dates.items()}
    if forced == "name":
        return list(chain.from_iterable(_folders(held, {})))
    if forced == "date":
        undated = [image.shown for image in images if image.path not in dates]
        if undated:
            raise InputError(
                f"--order date: {len(undated)} of {len(images)} images have no date of capture, the first is "
                f"{undated[0]}; leave them out, or take --order name"
            )
        return sorted(chain.from_iterable(held), key=lambda image: dates[image.path])
    dates = {path: date for path, date in dates.items() if path not in copies}
    held = [_counter_order(folder, copies, dates) for folder in held]
    ordered = list(chain.from_iterable(_folders(held, dates)))
    dated = [image for image in ordered if image.path in dates]
    by_date = sorted(dated, key=lambda image: dates[image.path])
    if dated != by_date:
        raise _contradiction(dated, by_date)
    return ordered


def _counter_order(
    folder: list[ImageFile], copies: Mapping[Path, Path], dates: Mapping[Path, datetime]
) -> list[ImageFile]:
    """Images of a folder, sorted by name; where the counter started again, the last numbers stand before the first."""
    originals = [image for image in folder if image.path not in copies]
    numbers = _numbers([image.path for image in originals])
    if len(numbers) < 2 or _across(numbers[-1][1], numbers[0][1]) is None:
        return folder
    leaps = [b - a for (_, a), (_, b) in pairwise(numbers)]
    cut = folder.index(originals[leaps.index(max(leaps)) + 1])
    turned = folder[cut:] + folder[:cut]
    known = [dates[image.path] for image in turned if image.path in dates]
    restarted = numbers[0][0] == numbers[-1][0] and max(leaps) > _WIDEST_GAP
    return turned if restarted and known == sorted(known) else folder


def _folders(held: list[list[ImageFile]], dates: Mapping[Path, datetime]) -> list[list[ImageFile]]:
    """Folders, sorted by their dates where each has one, else by their names."""
    dated = [[dates[image.path] for image in f if image.path in dates] for f in held]
    if all(dated):
        return [held[k] for k in sorted(range(len(held)), key=lambda k: min(dated[k]))]
    return sorted(held, key=lambda folder: _pieces(str(folder[0].path.parent)))


def _contradiction(by_name: list[ImageFile], by_date: list[ImageFile]) -> InputError:
    pairs = zip(by_name, by_date, strict=True)
    place = max(0, next(k for k, (a, b) in enumerate(pairs) if a is not b) - 1)
    lines = "".join(
        f"\n  by {word}: {'... ' * (place > 0)}"
        + ", ".join(f"{i.shown} ({i.exif.taken})" for i in order[place : place + _MOST_SHOWN])
        for word, order in (("name", by_name), ("date", by_date))
    )
    return InputError(
        "the dates of capture (Exif) contradict the order of folders and names; leave out images of another "
        f"camera or drive, or choose the order with --order name or --order date{lines}"
    )


def _numbers(files: Sequence[Path]) -> _Numbers:
    """Series and number of each name; empty where one has none."""
    for form in (_DCF, _LAST_NUMBER):
        found = [form.fullmatch(file.stem) for file in files]
        if all(found):
            return [(one[1].lower(), int(one[2])) for one in found if one]
    return []


def _across(a: int, b: int) -> int | None:
    """Numbers from one image to the next one of another series, or behind the counter's last; None: not known."""
    if 1 <= b - a <= _WIDEST_GAP:
        return b - a
    last = 10 ** len(str(a)) - 1
    step = b - a + last + (b == 0)
    return step if last >= _LEAST_LAST and b < a and step <= _WIDEST_GAP else None


def counted(files: Sequence[Path]) -> list[int] | None:
    """Which trigger each image is of, from 1 on, by the numbers in the names; None where these tell nothing.

    That is where they do not rise in multiples of their smallest step, or leap far (times, for instance). From a folder
    or series to the next it is one step where the numbers do not go on.
    """
    numbers = _numbers(files)
    steps: list[int | None] = []
    for (file, (series, a)), (other, (following, b)) in pairwise(zip(files, numbers, strict=False)):
        same = (file.parent, series) == (other.parent, following)
        step = b - a if same and b > a else _across(a, b)
        if same and step is None:
            return None
        steps.append(step)
    known = [step for step in steps if step is not None]
    unit = min(known, default=0)
    if not unit or any(step % unit or step > _WIDEST_GAP * unit for step in known):
        return None
    return list(accumulate((((step or unit) // unit) for step in steps), initial=1))
