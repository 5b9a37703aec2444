"""Files of users changed at random: boxes, class maps, labels, reviews, results (used by reliability_logs.py)."""

from __future__ import annotations

import csv
import io
import json
import random
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mutations import ROOT, Attempt, Prepare, Tally, small_result
from random_changes import changed_bytes, changed_tree

from wayside.pipeline import run
from wayside.pipeline.box_file import load_boxes
from wayside.pipeline.class_map import read_class_map
from wayside.pipeline.cli import app
from wayside.pipeline.earlier_result import check_earlier
from wayside.pipeline.evaluation import evaluate
from wayside.pipeline.exporting.export import export
from wayside.pipeline.journal import JOURNAL, Journal
from wayside.pipeline.labels import read_labels
from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.result import read_run, read_settings
from wayside.pipeline.reviewing.review import NO_REVIEW, read_review, result_name
from wayside.pipeline.settings_file import load_settings
from wayside.schemas.labels import BACK, SIGN
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS

ODD_COLUMNS: tuple[pa.Array[Any], ...] = (
    pa.nulls(4),
    pa.array([None, 1, 2, 3]),
    pa.array(["a", "\0", "../..", None]),
    pa.array([float("nan"), float("inf"), -1e300, None]),
    pa.array([b"\xff", b"", None, b"x"]),
    pa.array([[1], [], None, [2, 3]]),
    pa.array([{"a": 1}] * 4),
    pa.array([2**63 - 1, -(2**63), 0, -1]),
    pa.array([True, False, None, True]),
    pa.array([1, 2, 3, 4], pa.timestamp("ns")),
)


def changed_table(table: pa.Table, rng: random.Random) -> bytes:
    """Parquet of a table with bytes changed, or with columns left out, doubled, without rows or of other content."""
    if rng.random() < 0.7:
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(table.num_columns)
            name = table.column_names[at]
            edit = rng.randrange(4)
            if edit == 0 and table.num_columns > 1:
                table = table.remove_column(at)
            elif edit == 1:
                table = table.append_column(name, table.column(at))
            elif edit == 2:
                odd = rng.choice(ODD_COLUMNS)
                count = table.num_rows
                table = table.set_column(at, name, pa.concat_arrays([odd] * 9).slice(0, count))
            else:
                table = table.slice(0, rng.randrange(table.num_rows + 1))
    stream = io.BytesIO()
    pq.write_table(table, stream)
    content = stream.getvalue()
    return content if rng.random() < 0.5 else changed_bytes(content, rng)


def _boxes(folder: Path) -> Attempt:
    table = pa.table(
        {
            "frame": [0, 0, 1, 2],
            **{name: [1.0, 2.0, 3.0, 4.0] for name in ("x_min", "y_min")},
            **{name: [11.0, 12.0, 13.0, 14.0] for name in ("x_max", "y_max")},
            "score": [0.5, 1.0, 0.0, 0.9],
            "class": ["stop", "stop", "", "yield"],
            "color": ["red", None, "white", "red"],
        }
    )
    by_name = table.append_column("image_name", pa.array(["a1", "a2", "a10", "b"])).drop_columns(
        "frame"
    )
    images = [{"id": k, "file_name": f"{k}.jpg", "width": 9, "height": 9} for k in range(4)]
    found = [
        {"image_id": k, "bbox": [1, 2, 30, 40], "category_id": 1, "score": 0.5} for k in (0, 3)
    ]
    coco = {"images": images, "annotations": found, "categories": [{"id": 1, "name": "stop"}]}
    parquet, coco_file, classes = folder / "b.parquet", folder / "b.json", folder / "c.toml"
    classes.write_text('[classes]\n"stop" = { color = "red", shape = "octagon" }\n"yield" = {}\n')

    def attempt(tally: Tally, rng: random.Random) -> None:
        if path_is_coco := rng.random() < 0.4:
            coco_file.write_text(json.dumps(changed_tree(rng.choice((coco, found)), rng)))
        else:
            parquet.write_bytes(changed_table(rng.choice((table, by_name)), rng))
        options = {"models.detections": str(coco_file if path_is_coco else parquet)}
        if rng.random() < 0.3:
            options["models.classes"] = str(classes)
        tally.attempt(lambda: load_boxes(load_settings("default", options=options)[0]))

    return attempt


def _class_maps(folder: Path) -> Attempt:
    path = folder / "classes.toml"
    text = b'[classes]\n"stop sign" = { color = "red", shape = "octagon" }\n"7" = {}\nsign = { color = "white" }\n'

    def attempt(tally: Tally, rng: random.Random) -> None:
        path.write_bytes(changed_bytes(text, rng))
        tally.attempt(lambda: read_class_map(path))

    return attempt


def _labels(folder: Path) -> Attempt:
    def yolo(place: Path, change: Callable[[bytes], bytes]) -> Path:
        image = cv2.imencode(".png", np.zeros((20, 30, 3), np.uint8))[1].tobytes()
        (place / "a.png").write_bytes(image)
        (place / "a.txt").write_bytes(change(b"0 0.5 0.5 0.2 0.1\n1 0.1 0.1 0.2 0.1 0.3 0.3\n"))
        (place / "data.yaml").write_bytes(change(b"names:\n  0: stop\n  1: yield\n"))
        return place

    def voc(place: Path, change: Callable[[bytes], bytes]) -> Path:
        box = "<xmin>1</xmin><ymin>2</ymin><xmax>11</xmax><ymax>12</ymax>"
        one = f"<object><name>stop</name><difficult>0</difficult><bndbox>{box}</bndbox></object>"
        size = "<size><width>30</width><height>20</height></size>"
        text = f"<annotation><filename>a.png</filename>{size}{one}</annotation>"
        (place / "a.xml").write_bytes(change(text.encode()))
        return place

    box = {"image_id": 1, "bbox": [1, 2, 30, 40], "category_id": 1, "segmentation": [[1, 2, 3, 4]]}
    coco = {
        "images": [{"id": 1, "file_name": "a.jpg", "width": 90, "height": 90, "frame": 3}],
        "annotations": [box],
        "categories": [{"id": 1, "name": "stop"}],
    }
    view = {"frame": 3, "log_time_ns": 5, "box": [1, 2, 3, 4]}
    marks = {
        "wayside_marks": 1, "reviewer": "x", "log": "demo",
        "marks": [{"name": "a", "kind": "sign", "color": "red", "views": [view]}],
    }  # fmt: skip
    scene = {
        "file": "a.jpg",
        "width": 9,
        "height": 9,
        "complete": True,
        "signs": [{"box": [1, 2, 3, 4]}],
    }
    own = pa.table(
        {
            "log": ["a"] * 4, "frame": [0, 1, 2, 3], "kind": [SIGN, BACK, SIGN, "complete"],
            **{name: [1.0, 2.0, 3.0, None] for name in ("x_min", "y_min")},
            **{name: [11.0, 12.0, 13.0, None] for name in ("x_max", "y_max")},
            "color": ["red", None, "white", None],
            "polygon": [[[1.0, 2.0]], None, [], None],
        }
    )  # fmt: skip

    def attempt(tally: Tally, rng: random.Random) -> None:
        place = folder / "labels"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        kind = rng.randrange(4)
        if kind < 2:
            path = (yolo, voc)[kind](place, lambda data: changed_bytes(data, rng))
        elif kind == 2:
            path = place / "labels.json"
            path.write_text(json.dumps(changed_tree(rng.choice((coco, marks, [scene])), rng)))
        else:
            path = place / "labels.parquet"
            path.write_bytes(changed_table(own, rng))
        tally.attempt(lambda: read_labels(path))

    return attempt


def _results(folder: Path) -> Attempt:
    out = small_result(folder, rows=4)
    tables = {
        table.file: pq.read_table(out / table.file) for table in (SIGNS, OBSERVATIONS, FRAMES)
    }
    sound = {name: (out / name).read_bytes() for name in tables}
    about = {
        "wayside": "0.1", "log": "demo.mcap", "log_path": "/nowhere/demo.mcap", "learned_from_log": [],
        "files": {name: {"rows": 1, "sha256": "0" * 64} for name in tables},
        "settings": {"read": {"thin_m": 1.0}}, "world": "local", "camera": None, "notes": [],
        "accounting": {"frames_read": 6, "used": 6, "rejected": {}, "lost": []},
    }  # fmt: skip
    truth = ROOT / "recordings" / "demo.truth.json"

    def attempt(tally: Tally, rng: random.Random) -> None:
        for name, content in sound.items():
            (out / name).write_bytes(content)
        (out / "run.json").write_text(json.dumps(about))
        name = rng.choice([*tables, "run.json"])
        if name == "run.json":
            (out / name).write_text(json.dumps(changed_tree(about, rng)))
        else:
            (out / name).write_bytes(changed_table(tables[name], rng))
        kind, to = rng.choice(("csv", "geojson")), folder / "signs.out"
        uses: tuple[Callable[[], object], ...] = (
            lambda: read_settings(out, read_run(out)),
            lambda: check_earlier(out, folder / "log.mcap"),
            lambda: export(out, NO_REVIEW, to, kind, overwrite=True),
            lambda: evaluate(out, truth),
        )
        tally.attempt(rng.choice(uses))

    return attempt


def _reviews(folder: Path) -> Attempt:
    out = small_result(folder, rows=4)
    (out / "run.json").write_text(json.dumps({"files": {SIGNS.file: {"sha256": "a" * 64}}}))
    rows = [
        {"sign_id": "a-0001", "review": "accepted"},
        {"sign_id": "a-0002", "review": "edited", "color": "red", "note": "=1"},
        {"review": "missing", "x": 1.0, "y": 2.0, "reviewer": "x"},
    ]
    as_json = {"wayside_review": 1, "result": result_name(read_run(out)), "reviews": rows}
    text = io.StringIO()
    writer = csv.DictWriter(text, ("sign_id", "review", "color", "x", "y", "note", "reviewer"))
    writer.writeheader()
    writer.writerows(rows)

    def attempt(tally: Tally, rng: random.Random) -> None:
        if rng.random() < 0.5:
            path = folder / "review.json"
            path.write_text(json.dumps(changed_tree(as_json, rng)))
        else:
            path = folder / "review.csv"
            path.write_bytes(changed_bytes(text.getvalue().encode(), rng))
        tally.attempt(lambda: read_review(path, out))

    return attempt


def _journals(folder: Path) -> Attempt:
    out = folder / "out"
    line = ["run", str(ROOT / "recordings" / "demo.mcap"), "-o", str(out), "--until", "0.6s"]
    removed, run.remove_journal = run.remove_journal, lambda folder: None
    app([*line, "--resume", "--workers", "1"], standalone_mode=False)
    run.remove_journal = removed
    content = (out / JOURNAL).read_bytes()
    with pa.ipc.open_stream(content[8:]) as stream:
        key = json.loads(stream.schema.metadata[b"key"])

    def attempt(tally: Tally, rng: random.Random) -> None:
        altered = changed_bytes(content, rng)
        if len(altered) < 8:
            return
        (length,) = struct.unpack_from("<I", altered)  # as if its check sum were right
        sealed = struct.pack("<I", zlib.crc32(altered[8 : 8 + length]))
        (out / JOURNAL).write_bytes(altered[:4] + sealed + altered[8:])
        tally.attempt(lambda: Journal(out, key).close())

    return attempt


def _camera_files(folder: Path) -> Attempt:
    path = folder / "camera.yaml"
    texts = (
        b"%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
        b"   dt: d\n   data: [ 438., 0., 305., 0., 437., 243., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n"
        b"   rows: 1\n   cols: 5\n   dt: d\n   data: [ -0.3, 0.1, 0., 0., 0. ]\n",
        b"cam0:\n  camera_model: pinhole\n  intrinsics: [438., 437., 305., 243.]\n  resolution: [640, 480]\n"
        b"  distortion_model: radtan\n  distortion_coeffs: [-0.3, 0.1, 0.0, 0.0]\n",
    )

    def attempt(tally: Tally, rng: random.Random) -> None:
        path.write_bytes(changed_bytes(rng.choice(texts), rng))
        tally.attempt(lambda: read_camera_file(path))

    return attempt


FILES: dict[str, Prepare] = {
    "calibrations of OpenCV and Kalibr (YAML)": _camera_files,
    "boxes made elsewhere (Parquet, COCO)": _boxes,
    "class maps (TOML)": _class_maps,
    "labels of others (COCO, YOLO, VOC, marks, Parquet)": _labels,
    "results (tables, run.json), read, exported, evaluated": _results,
    "reviews (JSON, CSV)": _reviews,
    "journals": _journals,
}
