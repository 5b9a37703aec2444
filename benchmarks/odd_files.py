"""Files that must be refused with words, made and given to what reads them (used by reliability_faults.py)."""

from __future__ import annotations

import io
import json
import random
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.box_file import load_boxes
from wayside.pipeline.earlier_result import check_earlier
from wayside.pipeline.lengths import parse_spacing
from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.settings_file import load_settings


def deep_settings(folder: Path, rng: random.Random) -> object:
    """Settings, nested without end or not text."""
    path, depth = folder / "deep.toml", rng.randrange(2_000, 100_000)
    junk = [
        b"a = " + b"[" * depth,
        b"a" + b".a" * depth + b" = 1",
        b"\0\xff\xfe" * 99,
        b"[segment]\nclusters = 1e999",
    ]
    path.write_bytes(rng.choice(junk))
    return load_settings("default", path)


def bad_calibration(folder: Path, rng: random.Random) -> object:
    """A camera that cannot be, or YAML made to grow."""
    path = folder / "camera.yaml"
    fx, cx, width = rng.choice(
        [(1e-9, 300, 640), (400, 1e9, 640), (400, 300, 30_000), (-4, 300, 640), ("nan", 3, 640)]
    )
    text = f"image_width: {width}\nimage_height: {width}\n"
    text += f"camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0, {cx}, 0, {fx}, 240, 0, 0, 1]}}\n"
    text += "distortion_model: plumb_bob\n"
    text += "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    bomb = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{k}: &a{k} [{','.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 12)
    )
    path.write_text(
        rng.choice([text, text, bomb, "[" * 50_000, "a: !!python/object/apply:os.getpid []\n"])
    )
    return read_camera_file(path)


@cache
def parquet_bombs() -> list[bytes]:
    """Parquet of some kilobytes: one long text in each of many rows, and two hundred million rows of zeros."""
    numbers = pa.array(np.zeros(100_000, np.int32))
    texts = pa.DictionaryArray.from_arrays(numbers, pa.array(["x" * 1_000_000]))
    zeros = pa.table({"frame": np.zeros(10_000_000, np.int8)})
    one, many = io.BytesIO(), io.BytesIO()
    pq.write_table(pa.table({"image_name": texts}), one, store_schema=False)
    with pq.ParquetWriter(many, zeros.schema, compression="zstd") as writer:
        for _ in range(20):
            writer.write_table(zeros)
    return [one.getvalue(), many.getvalue()]


def boxes_beyond_measure(folder: Path, rng: random.Random) -> object:
    """Boxes made elsewhere that unpack to more than a gibibyte."""
    path = folder / "boxes.parquet"
    path.write_bytes(rng.choice(parquet_bombs()))
    settings, _ = load_settings("default", options={"models.detections": str(path)})
    return load_boxes(settings)


def no_unit(_: Path, rng: random.Random) -> object:
    """A spacing without a unit."""
    return parse_spacing(f"{rng.uniform(1, 90):.1f}")


def bad_result(folder: Path, rng: random.Random) -> object:
    """`run.json` that is none, deep or odd, in the place of a result."""
    out = Path(tempfile.mkdtemp(dir=folder))
    odd = [
        "[" * 100_000,
        "{}",
        "null",
        json.dumps({"files": {"../../x": {}}}),
        "\0",
        '{"log_path": 3, "files": []}',
    ]
    (out / "run.json").write_text(rng.choice(odd))
    (out / "signs.parquet").write_bytes(b"PAR1")
    return check_earlier(out, folder / "log.mcap")
