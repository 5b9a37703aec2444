"""Boxes made elsewhere, from Parquet or COCO JSON, by the images that they are of."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from wayside.pipeline.files.input_files import decoded, read_input
from wayside.pipeline.files.parquet import read_parquet
from wayside.pipeline.files.parsing import CONTENT_FAULTS, parse_json
from wayside.pipeline.labels.class_map import numbered, read_class_map
from wayside.pipeline.labels.formats import Entry, coco_box, coco_classes
from wayside.pipeline.labels.wayside_labels import CORNERS
from wayside.pipeline.reading.image_order import natural_key
from wayside.schemas.detections import COLORS, NONE, SHAPES
from wayside.schemas.detectors import IMAGE_KEYS, BoxFile, ExternalBoxes, SignClass
from wayside.schemas.errors import InputError
from wayside.schemas.settings import Settings
from wayside.stages.detection import named_boxes, places_of

_ADVICE = "See docs/detectors.md for the columns."


@dataclass(frozen=True, slots=True)
class _Rows:
    """What a file holds, one row a box, in the columns of `docs/detectors.md`."""

    table: pa.Table
    key: str
    """The column that names the image: one of `IMAGE_KEYS`, or `image_id` of COCO results."""
    names: Mapping[int, str] = field(default_factory=dict)
    """Of the classes, by number."""
    images: Sequence[str] = ()
    """File names of all images, those without a box among them."""
    ids: Mapping[int, Any] = field(default_factory=dict)
    """Value of `key` by `image_id`."""
    unread: Sequence[str] = ()
    """The fault of each further row."""


def load_boxes(settings: Settings) -> BoxFile:
    """The boxes that `models.detections` names, by image.

    Rows that are not finite, without area, of a class that is no sign, or below the least score are left out and
    counted. Raises InputError where the file cannot be read, a column is missing or wrong, or scores are not 0 to 1.
    """
    path = Path(settings.models.detections)
    try:
        data = read_input(path)
    except OSError as error:
        raise _refusal(path, f"cannot be read: {error.strerror}", "Correct the path.") from error
    rows = _coco_rows(path, data) if path.suffix.lower() == ".json" else _parquet_rows(path)
    table, key, names = rows.table, rows.key, list[str]()
    if key == "image_name":
        texts = _column(path, table, key, pa.string(), filled=True).to_pylist()
        of_rows = [str(text) for text in texts]
        names = sorted({*of_rows, *rows.images}, key=lambda name: natural_key(Path(name)))
        place = {name: number for number, name in enumerate(names)}
        image = np.array([place[name] for name in of_rows], np.int64)
        ids = {number: place[name] for number, name in rows.ids.items() if name in place}
    else:
        image, ids = _numbers(path, table, key, pa.int64()), dict(rows.ids)
    number, class_names = _classes(path, table)
    signs = None
    if settings.models.classes:
        classes = read_class_map(Path(settings.models.classes))
        signs = numbered(classes, rows.names or class_names, str(path), complete=False)
    boxes, left_out = _by_image(path, table, image, number, signs, settings)
    return BoxFile(
        str(path),
        sha256(data).hexdigest(),
        key,
        boxes,
        len(table) + len(rows.unread),
        tuple(names),
        ids,
        ({"not_read": len(rows.unread)} if rows.unread else {}) | left_out,
        signs,
        fault=rows.unread[0] if rows.unread else "",
        places=places_of(names),
    )


def _by_image(
    path: Path,
    table: pa.Table,
    image: NDArray[np.int64],
    number: NDArray[np.int64],
    signs: Mapping[int, SignClass] | None,
    settings: Settings,
) -> tuple[dict[int, ExternalBoxes], dict[str, int]]:
    """The boxes that can be used by the number of their image, the best first; and how many cannot, by reason."""
    score = np.ones(len(table))
    if "score" in table.column_names:
        score = _numbers(path, table, "score", pa.float64())
    corners = [_numbers(path, table, name, pa.float64()) for name in CORNERS]
    with np.errstate(over="ignore", invalid="ignore"):
        box = np.column_stack(corners).astype(np.float32)
        some_area = (box[:, 2:] > box[:, :2]).all(axis=1)
    good = np.isfinite(box).all(axis=1) & np.isfinite(score)
    if ((score[good] < 0) | (score[good] > 1)).any():
        low, high = score[good].min(), score[good].max()
        fault = f"has scores from {low:g} to {high:g} instead of 0 to 1"
        raise _refusal(path, fault, "Write probabilities, not percent or logits.")
    left_out = Counter(not_finite=int((~good).sum()))
    for reason, usable in (
        ("no_area", some_area),
        ("other_class", np.isin(number, list(signs)) if signs is not None else good),
        ("below_score", score >= settings.candidates.external_score),
    ):
        left_out[reason] = int((good & ~usable).sum())
        good &= usable
    kept = np.flatnonzero(good)
    kept = kept[np.lexsort((-score[kept], image[kept]))]
    every = named_boxes(box[kept], score[kept].astype(np.float32), number[kept], signs)
    color, shape = _looks(path, table, "color", COLORS), _looks(path, table, "shape", SHAPES)
    every = replace(
        every,
        color=np.where(color[kept] < 0, every.color, color[kept]).astype(np.int8),
        shape=np.where(shape[kept] < 0, every.shape, shape[kept]).astype(np.int8),
    )
    images, first = np.unique(image[kept], return_index=True)
    spans = np.split(np.arange(len(kept)), first[1:])
    found = {
        one: replace(every.select(span), found=len(span))
        for one, span in zip(images.tolist(), spans, strict=False)
    }
    return found, {reason: count for reason, count in left_out.items() if count}


def _parquet_rows(path: Path) -> _Rows:
    try:
        table = read_parquet(path)
    except (OSError, pa.ArrowException) as error:
        words = " ".join(str(error).split())[:200]
        fault = f"is neither a Parquet file nor COCO in a .json file: {words}"
        raise _refusal(path, fault, "Correct the path.") from error
    keys = [key for key in IMAGE_KEYS if key in table.column_names]
    if len(keys) != 1 or not set(CORNERS) <= set(table.column_names):
        needed = f"the columns {', '.join(CORNERS)} and one of {', '.join(IMAGE_KEYS)}"
        raise _refusal(path, f"must have {needed}, but has {', '.join(table.column_names)}")
    return _Rows(table, keys[0])


def _column(
    path: Path, table: pa.Table, name: str, kind: pa.DataType, *, filled: bool = False
) -> "pa.ChunkedArray[Any]":
    """A column as this type; `filled`: in every row."""
    try:
        values = table.column(name).cast(kind)
    except pa.ArrowException as error:
        found = table.schema.field(name).type
        raise _refusal(path, f"has a column {name} of type {found} instead of {kind}") from error
    if filled and values.null_count:
        raise _refusal(path, f"has no value in {values.null_count} rows of column {name}")
    return values


def _numbers(path: Path, table: pa.Table, name: str, kind: pa.DataType) -> NDArray[Any]:
    """A column of numbers; nan where a real number is null."""
    filled = pa.types.is_integer(kind)
    return np.asarray(_column(path, table, name, kind, filled=filled).to_numpy())


def _classes(path: Path, table: pa.Table) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Number of the class of each row, and their names: numbers as they are, texts in their order."""
    if "class" not in table.column_names:
        return np.zeros(len(table), np.int64), {}
    if pa.types.is_integer(table.schema.field("class").type):
        return _numbers(path, table, "class", pa.int64()), {}
    texts = [text or "" for text in _column(path, table, "class", pa.string()).to_pylist()]
    names, number = np.unique(np.array(texts, object), return_inverse=True)
    return number.astype(np.int64), dict(enumerate(names.tolist()))


def _looks(path: Path, table: pa.Table, name: str, known: Sequence[str]) -> NDArray[np.int8]:
    """Numbers of the colours or shapes that the rows name, -1 where they name none."""
    if name not in table.column_names:
        return np.full(len(table), NONE, np.int8)
    texts = _column(path, table, name, pa.string()).to_pylist()
    unknown = sorted({text for text in texts if text} - set(known))
    if unknown:
        fault = f"has {unknown[0]!r} in column {name} instead of {', '.join(known)} or null"
        raise _refusal(path, fault)
    return np.array([known.index(text) if text else NONE for text in texts], np.int8)


def _coco_rows(path: Path, data: bytes) -> _Rows:
    """Rows of COCO: a list of results, or a data set with `images`, `annotations` and `categories`."""
    try:
        content = parse_json(decoded(data))
        if isinstance(content, list):
            return _coco_table(content, "result", {})
        images = _coco_images(content["images"])
        rows = _coco_table(content["annotations"], "annotation", images)
        names = [str(name) for key, name in images.values() if key == "image_name"]
        return replace(rows, names=coco_classes(content), images=names, ids={})
    except CONTENT_FAULTS as error:
        raise _refusal(
            path,
            "is not COCO JSON, which has results (image_id, bbox, score), or images and annotations: "
            f"{type(error).__name__}: {error}"[:290],
            "See docs/detectors.md for its keys.",
        ) from error


def _coco_table(
    entries: Sequence[Entry], what: str, images: Mapping[Any, tuple[str, int | str]]
) -> _Rows:
    """Rows of annotations of `images`, or of results without them. Raises `CONTENT_FAULTS` where none can be read."""
    rows: dict[str, list[dict[str, Any]]] = {}
    ids: dict[int, Any] = {}
    unread: list[str] = []
    for place, one in enumerate(entries):
        try:
            key, image = images[one["image_id"]] if images else _image_of_result(one)
            if not isinstance(one["image_id"], str):
                if ids.setdefault(_whole(one["image_id"]), image) != image:
                    raise ValueError(f"image_id {one['image_id']} is of two files")
            row = dict(zip(CORNERS, coco_box(one), strict=True)) | {key: image}
            row |= {"score": float(one.get("score", 1)), "class": _whole(one.get("category_id", 0))}
            rows.setdefault(key, []).append(row)
        except CONTENT_FAULTS as error:
            words = f"no image {error}" if isinstance(error, KeyError) else str(error)
            unread.append(f"{what} {place}: {words}")
    if unread and not rows:
        raise ValueError(unread[0])
    if len(rows) > 1:
        first, second = sorted(rows)
        raise ValueError(f"some results name their image by {first}, others by {second}")
    key = next(iter(rows), "image_id")
    empty = dict.fromkeys((key, *CORNERS, "class"), np.zeros(0, np.int64))
    table = pa.Table.from_pylist(rows[key]) if rows else pa.table(empty)
    return _Rows(table, key, ids=ids, unread=unread)


def _coco_images(images: Sequence[Entry]) -> dict[Any, tuple[str, int | str]]:
    """What names the images of a data set, by id: the key, and the number or name."""
    if not images:
        raise ValueError("no images")
    for key in IMAGE_KEYS[:3]:
        if all(key in one for one in images):
            return {one["id"]: (key, _whole(one[key])) for one in images}
    if len({str(one["file_name"]) for one in images}) != len(images):
        raise ValueError("file_name is not unique")
    return {one["id"]: ("image_name", str(one["file_name"])) for one in images}


def _image_of_result(result: Entry) -> tuple[str, int | str]:
    """What names the image of a result: its file; where `image_id` is a text, it is the name of the file."""
    name = result.get("file_name") or result["image_id"]
    return ("image_name", name) if isinstance(name, str) else ("image_id", _whole(name))


def _whole(value: Any) -> int:
    number = int(value)
    if number != value or abs(number) >= 1 << 63:
        raise ValueError(f"{value!r:.40} is not a whole number")
    return number


def _refusal(path: Path, fault: str, advice: str = _ADVICE) -> InputError:
    return InputError(f"models.detections: {path} {fault}. {advice}")
