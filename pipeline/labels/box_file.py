"""Boxes made elsewhere, from Parquet or COCO JSON, by the images that they are of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline.files.input_files import decoded, read_input, read_parquet
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.labels.class_map import numbered, read_class_map
from wayside.pipeline.labels.coco import Entry, coco_box, coco_classes
from wayside.pipeline.reading.image_order import natural_key
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.detectors import IMAGE_KEYS, BoxFile, ExternalBoxes, SignClass
from wayside.schemas.errors import InputError
from wayside.schemas.labels import Box
from wayside.schemas.settings import Settings
from wayside.stages.detection import named_boxes, places_of

CORNERS = ("x_min", "y_min", "x_max", "y_max")
_Image = tuple[str, Any]
"""What a file names an image by, and the number or name."""
ADVICE = "See docs/detectors.md for the columns."


@dataclass(frozen=True, slots=True)
class BoxRows:
    """Rows of a file: key (one of `IMAGE_KEYS`), image (n,) int64, box (n, 4), score (n,), number (n,) of the class.

    `names`: of the classes by number. `color`, `shape` (n,) int8 or -1: what the rows themselves say. `image_names`: in
    natural order, those that the numbers of the images count. `ids`: number of the image by `image_id`, where that is a
    number. `unread`: the fault of each further row.
    """

    key: str
    image: NDArray[np.int64]
    box: NDArray[np.float64]
    score: NDArray[np.float64]
    number: NDArray[np.int64]
    names: Mapping[int, str]
    color: NDArray[np.int8]
    shape: NDArray[np.int8]
    image_names: Sequence[str] = ()
    ids: Mapping[int, int] = field(default_factory=dict)
    unread: Sequence[str] = ()


def load_boxes(settings: Settings) -> BoxFile:
    """The boxes that `models.detections` names, by image.

    Rows that are not finite, without area, of a class that is no sign, or below the least score are left out and
    counted.

    Raises
    ------
    InputError
        The file cannot be read, a column is missing or of another type, or scores are not 0 to 1.
    """
    path = Path(settings.models.detections)
    try:
        data = read_input(path)
    except OSError as error:
        raise _refusal(path, f"cannot be read: {error.strerror}", "Correct the path.") from error
    rows = _coco_rows(path, data) if path.suffix.lower() == ".json" else _parquet_rows(path)
    signs = None
    if settings.models.classes:
        classes = read_class_map(Path(settings.models.classes))
        signs = numbered(classes, rows.names, str(path), complete=False)
    boxes, left_out = boxes_by_image(path, rows, signs, settings.candidates.external_score)
    digest = sha256(data).hexdigest()
    if rows.unread:
        left_out = {"not_read": len(rows.unread)} | left_out
    return BoxFile(
        str(path),
        digest,
        rows.key,
        boxes,
        len(rows.box) + len(rows.unread),
        tuple(rows.image_names),
        rows.ids,
        left_out,
        signs,
        fault=rows.unread[0] if rows.unread else "",
        places=places_of(rows.image_names),
    )


def boxes_by_image(
    path: Path, rows: BoxRows, signs: Mapping[int, SignClass] | None, least_score: float
) -> tuple[dict[int, ExternalBoxes], dict[str, int]]:
    """The rows that can be used by the number of their image, and how many of the others there are by reason."""
    with np.errstate(over="ignore", invalid="ignore"):
        box = rows.box.astype(np.float32)
        some_area = (box[:, 2:] > box[:, :2]).all(axis=1)
    finite = np.isfinite(box).all(axis=1) & np.isfinite(rows.score)
    if finite.any() and not (rows.score[finite].min() >= 0 and rows.score[finite].max() <= 1):
        low, high = rows.score[finite].min(), rows.score[finite].max()
        raise _refusal(
            path,
            f"has scores from {low:g} to {high:g} instead of 0 to 1",
            "Write probabilities, not percent or logits.",
        )
    left_out: Counter[str] = Counter()
    good = np.ones(len(finite), np.bool_)
    reasons = (
        ("not_finite", ~finite),
        ("no_area", ~some_area),
        ("other_class", ~np.isin(rows.number, list(signs)) if signs is not None else ~good),
        ("below_score", rows.score < least_score),
    )
    for reason, bad in reasons:
        count = int((good & bad).sum())
        if count:
            left_out[reason] = count
        good &= ~bad
    kept = np.flatnonzero(good)
    kept = kept[np.lexsort((-rows.score[kept], rows.image[kept]))]
    numbers, first = np.unique(rows.image[kept], return_index=True)
    found = {}
    ends = np.append(first, len(kept))[1:]
    for number, start, end in zip(numbers.tolist(), first, ends, strict=True):
        own = kept[start:end]
        named = named_boxes(
            box[own],
            rows.score[own].astype(np.float32),
            rows.number[own],
            signs,
        )
        found[number] = ExternalBoxes(
            named.box,
            named.score,
            np.where(rows.color[own] < 0, named.color, rows.color[own]).astype(np.int8),
            np.where(rows.shape[own] < 0, named.shape, rows.shape[own]).astype(np.int8),
            len(own),
        )
    return found, dict(left_out)


def _parquet_rows(path: Path) -> BoxRows:
    try:
        table = read_parquet(path)
    except (OSError, pa.ArrowException) as error:
        words = " ".join(str(error).split())[:200]
        raise _refusal(
            path,
            f"is neither a Parquet file nor COCO in a .json file: {words}",
            "Correct the path.",
        ) from error
    keys = [key for key in IMAGE_KEYS if key in table.column_names]
    missing = [name for name in CORNERS if name not in table.column_names]
    if len(keys) != 1 or missing:
        needed = f"the columns {', '.join(CORNERS)} and one of {', '.join(IMAGE_KEYS)}"
        raise _refusal(path, f"must have {needed}, but has {', '.join(table.column_names)}")
    key, count = keys[0], table.num_rows
    names: list[str] = []
    if key == "image_name":
        named = _column(path, table, key, pa.string())
        if named.null_count:
            raise _refusal(path, f"has no value in {named.null_count} rows of column {key}")
        of_rows = [str(name) for name in named.to_pylist()]
        names = _ordered(of_rows)
        place_of = {name: place for place, name in enumerate(names)}
        image = np.array([place_of[name] for name in of_rows], np.int64)
    else:
        image = _filled(path, table, key, pa.int64())
    box = np.column_stack([_filled(path, table, name, pa.float64()) for name in CORNERS])
    score = (
        _filled(path, table, "score", pa.float64())
        if "score" in table.column_names
        else np.ones(count)
    )
    number, class_names = _classes(path, table)
    return BoxRows(
        key,
        image,
        box,
        score,
        number,
        class_names,
        _kinds(path, table, "color", COLORS),
        _kinds(path, table, "shape", SHAPES),
        names,
    )


def _column(path: Path, table: pa.Table, name: str, kind: pa.DataType) -> pa.ChunkedArray[Any]:
    try:
        return table.column(name).cast(kind)
    except pa.ArrowException as error:
        raise _refusal(
            path, f"has a column {name} of type {table.schema.field(name).type} instead of {kind}"
        ) from error


def _filled(path: Path, table: pa.Table, name: str, kind: pa.DataType) -> NDArray[Any]:
    """A column of numbers; null is not a number, and not allowed where an image is named."""
    values = _column(path, table, name, kind)
    if pa.types.is_integer(kind) and values.null_count:
        raise _refusal(path, f"has no value in {values.null_count} rows of column {name}")
    return np.asarray(values.to_numpy())


def _classes(path: Path, table: pa.Table) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Number of the class of each row, and their names: numbers as they are, texts in their order."""
    if "class" not in table.column_names:
        return np.zeros(table.num_rows, np.int64), {}
    kind = table.schema.field("class").type
    if pa.types.is_integer(kind):
        return _filled(path, table, "class", pa.int64()), {}
    texts = [text or "" for text in _column(path, table, "class", pa.string()).to_pylist()]
    names = dict(enumerate(sorted(set(texts))))
    number = {name: k for k, name in names.items()}
    return np.array([number[text] for text in texts], np.int64), names


def _kinds(path: Path, table: pa.Table, name: str, known: Sequence[str]) -> NDArray[np.int8]:
    """Numbers of the colours or shapes that the rows name, -1 where they name none."""
    if name not in table.column_names:
        return np.full(table.num_rows, NONE, np.int8)
    texts = _column(path, table, name, pa.string()).to_pylist()
    unknown = sorted({text for text in texts if text} - set(known))
    if unknown:
        raise _refusal(
            path, f"has {unknown[0]!r} in column {name} instead of {', '.join(known)} or null"
        )
    return np.array([known.index(text) if text else -1 for text in texts], np.int8)


def _coco_rows(path: Path, data: bytes) -> BoxRows:
    """Rows of COCO: a list of results, or a data set with `images`, `annotations` and `categories`."""
    try:
        return _coco_table(parse_json(decoded(data)))
    except CONTENT_FAULTS as error:
        found = f"{type(error).__name__}: {error}"
        raise _refusal(
            path,
            f"is not COCO JSON, which has results (image_id, bbox, score), or images and annotations: {found[:200]}",
            "See docs/detectors.md for its keys.",
        ) from error


def _coco_table(content: Any) -> BoxRows:
    results = isinstance(content, list)
    images = {} if results else _coco_images(content["images"])
    rows: list[tuple[_Image, Box, float, int]] = []
    ids: dict[int, Any] = {}
    unread: list[str] = []
    for place, one in enumerate(content if results else content["annotations"]):
        try:
            image = _result_image(one) if results else images[one["image_id"]]
            if results and not isinstance(one["image_id"], str):
                if ids.setdefault(_whole(one["image_id"]), image[1]) != image[1]:
                    raise ValueError(f"image_id {one['image_id']} is of two files")
            score, number = float(one.get("score", 1)), _whole(one.get("category_id", 0))
            rows.append((image, coco_box(one), score, number))
        except CONTENT_FAULTS as error:
            words = f"no image {error}" if isinstance(error, KeyError) else str(error)
            unread.append(f"{'result' if results else 'annotation'} {place}: {words}")
    if unread and not rows:
        raise ValueError(unread[0])
    keys = sorted({key for (key, _), *_ in rows}) or ["image_id"]
    if len(keys) > 1:
        raise ValueError(f"some results name their image by {keys[0]}, others by {keys[1]}")
    values = [value for (_, value), *_ in rows]
    names: list[str] = []
    if keys == ["image_name"]:
        names = _ordered([name for _, name in images.values()] or values)
        place_of = {name: place for place, name in enumerate(names)}
        values = [place_of[name] for name in values]
        ids = {number: place_of[name] for number, name in ids.items() if name in place_of}
    unnamed = np.full(len(rows), NONE, np.int8)
    return BoxRows(
        keys[0],
        np.array(values, np.int64),
        np.array([box for _, box, *_ in rows], np.float64).reshape(-1, 4),
        np.array([score for *_, score, _ in rows], np.float64),
        np.array([number for *_, number in rows], np.int64),
        {} if results else coco_classes(content),
        unnamed,
        unnamed,
        names,
        ids,
        unread,
    )


def _coco_images(images: Sequence[Entry]) -> dict[Any, _Image]:
    """What names the images of a data set, by id."""
    if not images:
        raise ValueError("no images")
    for key in IMAGE_KEYS[:3]:
        if all(key in one for one in images):
            return {one["id"]: (key, _whole(one[key])) for one in images}
    names = {str(one["file_name"]) for one in images}
    if len(names) != len(images):
        raise ValueError("file_name is not unique")
    return {one["id"]: ("image_name", str(one["file_name"])) for one in images}


def _result_image(result: Entry) -> _Image:
    """What names the image of a result: its file; where `image_id` is a text, it is the name of the file."""
    name = result.get("file_name") or result["image_id"]
    return ("image_name", name) if isinstance(name, str) else ("image_id", _whole(name))


def _whole(value: Any) -> int:
    number = int(value)
    if number != value or abs(number) >= 1 << 63:
        raise ValueError(f"{value!r:.40} is no whole number")
    return number


def _ordered(names: Iterable[str]) -> list[str]:
    """Each name once, in natural order."""
    return sorted(set(names), key=lambda name: natural_key(Path(name)))


def _refusal(path: Path, fault: str, advice: str = ADVICE) -> InputError:
    return InputError(f"models.detections: {path} {fault}. {advice}")
