"""Small inputs of every kind that wayside reads: logs, labels, boxes, results."""

import io
import json
import random
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from common import DEMO
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from recordings.drives.messages.content import Calibration, CameraPose, FixReading
from recordings.drives.messages.dialects import DIALECTS
from recordings.drives.spec import CameraSpec
from wayside.pipeline.reading.layout import MAGIC, RECORD_HEAD, Budget, parse_record, unpack_chunk
from wayside.pipeline.reading.records import Message, ScanReport, scan
from wayside.schemas.labels import BACK, SIGN
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

START, STEP, WIDTH, HEIGHT = 1_700_000_000 * 10**9, 10**9 // 4, 48, 32
PACKINGS: dict[str, dict[str, Any]] = {
    "not chunked": {"use_chunking": False},
    "chunks": {"compression": CompressionType.NONE},
    "lz4 chunks": {"compression": CompressionType.LZ4},
    "zstd chunks": {"compression": CompressionType.ZSTD},
}
BARE: dict[str, Any] = {"index_types": IndexType.NONE} | dict.fromkeys(
    ("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False
)
"""Options of a log without a summary."""
Found = list[tuple[str, int, bytes]]


def read(path: Path, report: ScanReport | None = None) -> Found:
    """Topic, number and bytes of all messages."""
    found = (m for m in scan(path, report or ScanReport()) if isinstance(m, Message))
    return [(m.channel.topic, m.sequence, bytes(m.data)) for m in found]


def small_log(dialect_name: Any, images: int, **options: Any) -> bytes:
    """A log of some small images, with calibration, poses and fixes."""
    dialect = DIALECTS[dialect_name]()
    stream, channels = io.BytesIO(), {}
    writer = Writer(stream, **options)
    writer.start(library="benchmarks")
    calibration = Calibration(CameraSpec(WIDTH, HEIGHT, 50.0, 50.0, 23.5, 15.5))
    for k in range(images):
        ns = START + k * STEP
        pixels = np.random.default_rng(k).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
        jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
        pose = CameraPose(np.array([8.0 * k, 0, 2]), np.array([0.0, 0, 0, 1]), 0.1, 0.1)
        for topic, (name, data) in (
            ("/calibration", dialect.calibration(ns, calibration)),
            ("/pose", dialect.pose(ns, pose)),
            ("/fix", dialect.fix(ns, FixReading(48.0, 11.0 + k * 1e-4, 500.0, (2.0, 2.0, 4.0)))),
            ("/image", dialect.compressed(ns, jpeg)),
        ):
            if topic not in channels:
                schema = writer.register_schema(name, dialect.schema_encoding, dialect.schema(name))
                channels[topic] = writer.register_channel(topic, dialect.encoding, schema)
            writer.add_message(channels[topic], ns, data, ns, k)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


@cache
def small_logs(images: int, *, summary: bool = True) -> list[tuple[str, bytes, Found]]:
    """Small logs of every dialect and packing: name, bytes, messages."""
    logs = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        for dialect in DIALECTS:
            for name, options in PACKINGS.items():
                more = options | {"chunk_size": 750 * images} | ({} if summary else BARE)
                path.write_bytes(small_log(dialect, images, **more))
                ending = "" if summary else ", no summary"
                logs.append((f"{dialect}, {name}{ending}", path.read_bytes(), read(path)))
    return logs


def records_of(content: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Opcode, start and end of the records of a sound log up to the end of its data."""
    found, at = [], len(MAGIC)
    while not found or found[-1][0] != Opcode.DATA_END:
        opcode, length = RECORD_HEAD.unpack_from(content, at)
        found.append((opcode, at, at + RECORD_HEAD.size + length))
        at = found[-1][2]
    return found


def messages_before(content: bytes, cut: int) -> int:
    """How many messages of a sound log lie in records that end before a byte."""
    count = 0
    for kind, start, end in records_of(content):
        body = memoryview(content)[start + RECORD_HEAD.size : end]
        if end <= cut and kind == Opcode.MESSAGE:
            count += 1
        if end <= cut and kind == Opcode.CHUNK:
            chunk, _ = parse_record(kind, body)
            inner = unpack_chunk(chunk, Budget.of(len(content)))
            count += sum(one == Opcode.MESSAGE for one, _ in inner)
    return count


CAMERAS = (
    b"image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
    b"  data: [438.78, 0., 305.59, 0., 437.35, 243.74, 0., 0., 1.]\ndistortion_model: plumb_bob\n"
    b"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.11, 0.001, 0.0005, 0.0]\n",
    b"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n"
    b"   rows: 3\n   cols: 3\n   dt: d\n   data: [ 438., 0., 305., 0., 437., 243., 0., 0., 1. ]\n"
    b"distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n"
    b"   data: [ -0.3, 0.1, 0., 0., 0. ]\n",
    b"cam0:\n  camera_model: pinhole\n  intrinsics: [438., 437., 305., 243.]\n"
    b"  resolution: [640, 480]\n  distortion_model: radtan\n"
    b"  distortion_coeffs: [-0.3, 0.1, 0.0, 0.0]\n",
)
"""Calibrations of ROS, OpenCV and Kalibr."""
CLASS_MAP = b'[classes]\n"stop" = { color = "red", shape = "octagon" }\n"yield" = {}\n7 = {}\n'
BOXES = pa.table(
    {
        "frame": [0, 0, 1, 2],
        **{name: [1.0, 2.0, 3.0, 4.0] for name in ("x_min", "y_min")},
        **{name: [11.0, 12.0, 13.0, 14.0] for name in ("x_max", "y_max")},
        "score": [0.5, 1.0, 0.0, 0.9],
        "class": ["stop", "stop", "", "yield"],
        "color": ["red", None, "white", "red"],
    }
)
COCO = {
    "images": [{"id": k, "file_name": f"{k}.jpg", "width": 90, "height": 90} for k in range(4)],
    "annotations": [
        {"image_id": k, "bbox": [1, 2, 30, 40], "category_id": 1, "score": 0.5} for k in (0, 3)
    ],
    "categories": [{"id": 1, "name": "stop"}],
}
LABELS = pa.table(
    {
        "log": ["a"] * 4, "frame": [0, 1, 2, 3], "kind": [SIGN, BACK, SIGN, "complete"],
        **{name: [1.0, 2.0, 3.0, None] for name in ("x_min", "y_min")},
        **{name: [11.0, 12.0, 13.0, None] for name in ("x_max", "y_max")},
        "color": ["red", None, "white", None],
        "polygon": [[[1.0, 2.0]], None, [], None],
    }
)  # fmt: skip
VIEW = {"frame": 3, "log_time_ns": 5, "box": [1, 2, 3, 4]}
MARK = {"name": "a", "kind": "sign", "color": "red", "views": [VIEW]}
MARKS = {"wayside_marks": 1, "reviewer": "x", "log": "demo", "marks": [MARK]}
SCENES = [
    {"file": "a.jpg", "width": 9, "height": 9, "complete": True, "signs": [{"box": [1, 2, 3, 4]}]}
]
REAL_LABELS = {
    "signs": [{"id": "s1", "wanted": True, "boxes": [{"i": 3, "box": [11, 11, 29, 31]}]}],
    "stride": 2,
    "distractors": [{"what": "lamp", "source_frame": 4, "box": [1, 2, 3, 4]}],
}
REVIEWS = [
    {"sign_id": "a-0001", "review": "accepted"},
    {"sign_id": "a-0002", "review": "edited", "color": "red", "note": "=1"},
    {"review": "missing", "x": 1.0, "y": 2.0, "reviewer": "x"},
]
ABOUT = {
    "wayside": "0.1", "log": "demo.mcap", "log_path": "/nowhere/demo.mcap", "learned_from_log": [],
    "files": {t.file: {"rows": 1, "sha256": "0" * 64} for t in (SIGNS, OBSERVATIONS, FRAMES)},
    "settings": {"read": {"thin_m": 1.0}}, "world": "local", "camera": None, "notes": [],
    "accounting": {"frames_read": 6, "used": 6, "rejected": {}, "lost": []},
}  # fmt: skip


def short_truth() -> dict[str, Any]:
    """The truth of the first signs and images of the demo drive."""
    truth: dict[str, Any] = json.loads(DEMO.with_suffix(".truth.json").read_text())
    truth["signs"], truth["frames"] = truth["signs"][:2], truth["frames"][:6]
    for one in truth["signs"]:
        one["frames"] = one["frames"][:3]
    return truth


@cache
def small_result(folder: Path) -> tuple[Path, dict[str, bytes]]:
    """A result of some images with signs, and the content of its files."""
    out = folder / "out"
    out.mkdir()
    signs = [
        {
            "sign_id": f"a-{k + 1:04d}", "status": "sign", "color": "red", "shape": "octagon", "best_frame": 3,
            "best_box": [10.0, 10.0, 30.0, 30.0], "right_m": 4.0, "down_m": -1.0, "ahead_m": 20.0,
        }
        for k in range(4)
    ]  # fmt: skip
    frames = [{"frame": k} for k in range(6)]
    for table, content in ((SIGNS, signs), (OBSERVATIONS, []), (FRAMES, frames)):
        required = {f.name: _some(f) for f in table.schema if not f.nullable}
        full = [required | row for row in content]
        pq.write_table(pa.Table.from_pylist(full, table.schema), out / table.file)
    (out / "run.json").write_text(json.dumps(ABOUT))
    return out, {path.name: path.read_bytes() for path in out.iterdir()}


def _some(column: pa.Field) -> Any:
    kind = column.type
    if pa.types.is_dictionary(kind) or pa.types.is_string(kind):
        return ""
    return [0.0] * kind.list_size if pa.types.is_fixed_size_list(kind) else 0


def chunks_of(content: bytearray) -> list[tuple[int, int]]:
    """Where each chunk begins and ends."""
    return [(start, end) for kind, start, end in records_of(content) if kind == Opcode.CHUNK]


def flipped_bit(content: bytearray, rng: random.Random) -> bytearray:
    """A bit of the first chunk changed."""
    start, end = chunks_of(content)[0]
    content[rng.randrange(start + 60, end)] ^= 1 << rng.randrange(8)
    return content


def missing_bytes(content: bytearray, rng: random.Random) -> bytearray:
    """Bytes missing from a chunk."""
    start, end = rng.choice(chunks_of(content))
    at = rng.randrange(start + 60, end)
    return content[:at] + content[min(at + rng.randrange(1, 200), end) :]


def other_opcode(content: bytearray, rng: random.Random) -> bytearray:
    """The kind of a chunk changed."""
    at, _ = rng.choice(chunks_of(content))
    content[at] = rng.choice([0, 1, 3, 5, 7, 9, 11, 12, 15, 0x80, 0xFF])
    return content
