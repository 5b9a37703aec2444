"""Inputs changed at random, and inputs that must be refused: the result of each kind."""

import io
import json
import random
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import small_inputs as small
from attempts import (
    REFUSED,
    RIGHT,
    TOLD,
    WRONG,
    Attempt,
    changed_bytes,
    changed_table,
    changed_tree,
    tried,
)
from common import DEMO
from mcap.opcode import Opcode

from wayside.pipeline.cli import app
from wayside.pipeline.evaluation.compare import evaluate
from wayside.pipeline.exporting.export import export
from wayside.pipeline.files.settings_file import format_settings, load_settings
from wayside.pipeline.labels.box_file import load_boxes
from wayside.pipeline.labels.class_map import read_class_map
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.logs.information import format_log, inspect_log
from wayside.pipeline.models.model_folder import shipped_models
from wayside.pipeline.models.model_json import model_from_json
from wayside.pipeline.reading.calibrations import read_camera_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.image_headers import read_image_header
from wayside.pipeline.reading.layout import RECORD_HEAD
from wayside.pipeline.reading.records import ScanReport
from wayside.pipeline.results.result import check_earlier, read_run, read_settings
from wayside.pipeline.reviewing.review import NO_REVIEW, find_review
from wayside.pipeline.running import run
from wayside.pipeline.running.journal import JOURNAL, Journal
from wayside.schemas.frame import USED, Frame
from wayside.schemas.models import EvidenceModel, GaussianModel, LinearModel, MixtureModel
from wayside.schemas.settings import ReadSettings
from wayside.stages.classifiers import evidence_ratios, log_ratio, log_ratios
from wayside.stages.imaging import decode

Content = Callable[[random.Random], bytes]
LogChange = Callable[[bytearray, random.Random], bytes | bytearray]
OUTCOMES = (RIGHT, TOLD, REFUSED)
HEADS = ("input", "tried", *OUTCOMES, WRONG, "slowest, ms of CPU", "memory grown, MB")


def rows(only: Sequence[str], count: int, seed: int) -> Iterator[tuple[list[str], bool]]:
    """A row for each kind of input whose name contains one of `only`, and whether nothing went wrong."""
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    with tempfile.TemporaryDirectory() as folder:
        for title, attempt in KINDS.items():
            if not any(part in title for part in only):
                continue
            found, slowest_s, grown_mb = tried(title, attempt, count, seed, Path(folder))
            known = [found.pop(outcome, 0) for outcome in OUTCOMES]
            for fault, times in found.most_common():
                print(f"{title}: {times} x {fault}", flush=True)
            cells = [title, count, *known, found.total(), f"{1e3 * slowest_s:.0f}"]
            yield [*map(str, cells), f"{grown_mb:.0f}"], not found.total()


def of_file(name: str, made: Content, use: Callable[[Path], object]) -> Attempt:
    """A file of made content, and what reads it."""

    def attempt(folder: Path, rng: random.Random) -> str:
        path = folder / name
        path.write_bytes(made(rng))
        use(path)
        return RIGHT

    return attempt


def must_refuse(attempt: Attempt) -> Attempt:
    """The same, where whatever does not end with words is wrong."""
    return lambda folder, rng: WRONG if attempt(folder, rng) else REFUSED


def edited_bytes(*contents: bytes) -> Content:
    """One of these with bytes changed."""
    return lambda rng: changed_bytes(rng.choice(contents), rng)


def edited_json(*trees: Any) -> Content:
    """One of these as JSON with values changed."""
    return lambda rng: changed_tree(rng.choice(trees), rng)


def edited_tables(*tables: pa.Table) -> Content:
    """One of these as Parquet with columns or bytes changed."""
    return lambda rng: changed_table(rng.choice(tables), rng)


def use_boxes(path: Path) -> object:
    """Read boxes made elsewhere."""
    return load_boxes(load_settings("default", options={"models.detections": str(path)})[0])


def use_model(path: Path) -> None:
    """Read a model and evaluate it on noise."""
    model = model_from_json(path.read_text(encoding="utf-8"))
    values = np.random.default_rng(0).normal(size=(20, 1000)).astype(np.float32)
    with np.errstate(all="ignore"):
        if isinstance(model, GaussianModel) and model.classes:
            log_ratios(values[:, : model.classes[0].mean.size], model)
        elif isinstance(model, MixtureModel):
            log_ratio(values[:, : model.mean.shape[1]], model)
        elif isinstance(model, LinearModel):
            values[:, : len(model.features)].astype(np.float64) @ model.weights
        elif isinstance(model, EvidenceModel):
            evidence_ratios(model, dict.fromkeys(model.features, 0.5))


def model_texts() -> list[Any]:
    """Models that ship, one of each kind."""
    names = ("place", "location", "outline", "color_rgb", "front", "back", "trajectory")
    return [json.loads((shipped_models() / f"{name}.json").read_text()) for name in names]


def of_logs(
    change: LogChange, *, chunked: bool = True, summary: bool = True, frames: bool = False
) -> Attempt:
    """Small logs of every dialect and packing, changed, and read to messages; `frames`: to decoded images, too.

    Wrong: a message with other bytes than were written, or one lost without a word. (Messages outside of chunks have no
    checksum: `frames` counts those of chunks only, as any byte may be changed there.)
    """

    def attempt(folder: Path, rng: random.Random) -> str:
        logs = small.small_logs(8, summary=summary)
        if chunked and not frames:
            logs = [log for log in logs if "not chunked" not in log[0]]
        name, content, whole = rng.choice(logs)
        path = folder / "log.mcap"
        path.write_bytes(change(bytearray(content), rng))
        report = ScanReport()
        found = small.read(path, report)
        told = bool(report.problem_count or report.unchecked)
        if frames:
            list(decode(read_frames(path, ReadSettings(thin_m=0.0), ReadReport())))
            known = {data for _, _, data in whole}
            wrong = "not chunked" not in name and any(data not in known for _, _, data in found)
        else:
            wrong = any(one not in whole for one in found)
            wrong |= len(found) < len(whole) and not told
        if told:
            format_log(inspect_log(path))
        return WRONG if wrong else TOLD if told else RIGHT

    return attempt


def cut_log(folder: Path, rng: random.Random) -> str:
    """A small log cut off at any byte: wrong where a message before the cut is lost, or another comes."""
    logs = [log for summary in (True, False) for log in small.small_logs(8, summary=summary)]
    _, content, whole = rng.choice(logs)
    cut = rng.randrange(len(content))
    path = folder / "log.mcap"
    path.write_bytes(content[:cut])
    found = small.read(path)
    format_log(inspect_log(path))
    complete = small.messages_before(content, cut) <= len(found)
    return TOLD if complete and found == whole[: len(found)] else WRONG


def inserted(record: Content) -> LogChange:
    """A record put between two others before the end of the data."""

    def change(content: bytearray, rng: random.Random) -> bytearray:
        ends = (Opcode.CHUNK, Opcode.DATA_END)
        at = rng.choice([start for kind, start, _ in small.records_of(content) if kind in ends])
        return content[:at] + record(rng) + content[at:]

    return change


def no_kind(rng: random.Random) -> bytes:
    """A record without a kind."""
    return RECORD_HEAD.pack(0, n := rng.randrange(400)) + rng.randbytes(n)


def of_images(made: Content, wanted: Sequence[str] = ()) -> Attempt:
    """An image that must have one of the statuses `wanted`, where any are given."""

    def attempt(_: Path, rng: random.Random) -> str:
        data = made(rng)
        size = (read_image_header(data) or ("", 0, 0))[1:]
        if size[0] * size[1] > 10**6:
            return RIGHT
        (image,) = decode(iter([Frame(0, 0, None, USED, "", data, None, *size)]))
        return RIGHT if not wanted else TOLD if image.frame.status in wanted else WRONG

    return attempt


def image_files() -> list[bytes]:
    """A small image in each format."""
    shape = (small.HEIGHT, small.WIDTH, 3)
    pixels = cv2.blur(np.random.default_rng(0).integers(0, 256, shape, np.uint8), (3, 3))
    kinds = (".jpg", ".png", ".webp", ".tiff", ".bmp")
    return [cv2.imencode(kind, pixels)[1].tobytes() for kind in kinds]


def half_jpeg(rng: random.Random) -> bytes:
    """A JPEG that ends early."""
    noise = np.random.default_rng(rng.randrange(9)).integers(0, 256, (9, 12, 3), np.uint8)
    data = cv2.imencode(".jpg", cv2.resize(noise, (320, 240)))[1].tobytes()
    return data[: rng.randrange(len(data) // 3, len(data) - 30)]


def changed_result(folder: Path, rng: random.Random) -> str:
    """A result with a table or `run.json` changed, read, exported or evaluated."""
    out, sound = small.small_result(folder)
    for name, content in sound.items():
        (out / name).write_bytes(content)
    name = rng.choice(sorted(sound))
    if name.endswith(".json"):
        content = changed_tree(small.ABOUT, rng)
    else:
        content = changed_table(pq.read_table(out / name), rng)
    (out / name).write_bytes(content)
    uses: tuple[Callable[[], object], ...] = (
        lambda: read_settings(out, read_run(out)),
        lambda: check_earlier(out, folder / "log.mcap"),
        lambda: export(out, NO_REVIEW, folder / "signs.csv", "csv", overwrite=True),
        lambda: export(out, NO_REVIEW, folder / "signs.geojson", "geojson", overwrite=True),
        lambda: evaluate(out, DEMO.with_suffix(".truth.json")),
    )
    rng.choice(uses)()
    return RIGHT


@cache
def sound_journal(out: Path) -> tuple[bytes, Any]:
    """The journal of a run, and the key that it states."""
    line = ["run", str(DEMO), "-o", str(out), "--until", "0.6s", "--resume", "--workers", "1"]
    removed, run.remove_journal = run.remove_journal, lambda folder: None
    with redirect_stdout(io.StringIO()):
        app(line, standalone_mode=False)
    run.remove_journal = removed
    content = (out / JOURNAL).read_bytes()
    (length,) = struct.unpack_from("<I", content, 4)
    return content, json.loads(content[12 : 12 + length])


def changed_journal(folder: Path, rng: random.Random) -> str:
    """The journal of a run, changed."""
    out = folder / "out"
    content, key = sound_journal(out)
    (out / JOURNAL).write_bytes(changed_bytes(content, rng))
    Journal(out, key).close()
    return RIGHT


def odd_settings(rng: random.Random) -> bytes:
    """Settings, nested without end or not text."""
    depth = rng.randrange(2_000, 100_000)
    deep = (b"a = " + b"[" * depth, b"a = " + b"{b = " * depth)
    return rng.choice((*deep, b"\0\xff\xfe" * 99, b"[segment]\nclusters = 1e999"))


def odd_camera(rng: random.Random) -> bytes:
    """A camera that cannot exist, or YAML that grows when it is read."""
    fx, cx, width = rng.choice(
        [(1e-9, 300, 640), (400, 1e9, 640), (400, 300, 30_000), (-4, 300, 640), ("nan", 3, 640)]
    )
    text = f"image_width: {width}\nimage_height: {width}\n"
    text += f"camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0, {cx}, 0, {fx}, 240, 0, 0, 1]}}\n"
    text += "distortion_model: plumb_bob\n"
    text += "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    grows = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{k}: &a{k} [{','.join(9 * [f'*a{k - 1}'])}]\n" for k in range(1, 12)
    )
    calls = "a: !!python/object/apply:os.getpid []\n"
    return rng.choice([text, text, grows, "[" * 50_000, calls]).encode()


KINDS: dict[str, Attempt] = {
    # Changed at random
    "logs, read to frames and decoded": of_logs(
        lambda content, rng: changed_bytes(bytes(content), rng), frames=True
    ),
    "images": of_images(edited_bytes(*image_files())),
    "calibrations (YAML)": of_file("c.yaml", edited_bytes(*small.CAMERAS), read_camera_file),
    "settings (TOML)": of_file(
        "s.toml",
        edited_bytes(format_settings(*load_settings()).encode()),
        partial(load_settings, "default"),
    ),
    "labels and truth (JSON)": of_file(
        "labels.json",
        edited_json(small.short_truth(), small.REAL_LABELS),
        lambda path: evaluate(small.small_result(path.parent)[0], path),
    ),
    "models (JSON), evaluated where they are accepted": of_file(
        "m.json", edited_json(*model_texts()), use_model
    ),
    "boxes made elsewhere (Parquet)": of_file("b.parquet", edited_tables(small.BOXES), use_boxes),
    "boxes made elsewhere (COCO)": of_file(
        "b.json", edited_json(small.COCO, small.COCO["annotations"]), use_boxes
    ),
    "class maps (TOML)": of_file("classes.toml", edited_bytes(small.CLASS_MAP), read_class_map),
    "labels of others (COCO, marks, scenes)": of_file(
        "labels.json", edited_json(small.COCO, small.MARKS, small.SCENES), read_labels
    ),
    "labels (Parquet)": of_file("labels.parquet", edited_tables(small.LABELS), read_labels),
    "results (tables, run.json), read, exported, evaluated": changed_result,
    "reviews (JSON)": of_file(
        "r.json",
        edited_json({"wayside_review": 1, "result": "0" * 16, "reviews": small.REVIEWS}),
        lambda path: find_review(small.small_result(path.parent)[0], [path]),
    ),
    "journals": changed_journal,
    # Faults at one point
    "logs cut off": cut_log,
    "records without a kind (opcode 0)": of_logs(inserted(no_kind), chunked=False),
    "a bit of the first chunk": of_logs(small.flipped_bit),
    "a bit of the first chunk, no summary": of_logs(small.flipped_bit, summary=False),
    "bytes missing from a chunk": of_logs(small.missing_bytes),
    "the kind of a chunk changed": of_logs(small.other_opcode),
    "JPEGs that end early": of_images(half_jpeg, ("damaged", "undecodable")),
    # Always to be refused
    "settings nested without end, not text, infinite": must_refuse(
        of_file("s.toml", odd_settings, partial(load_settings, "default"))
    ),
    "calibrations that cannot be, YAML that grows": must_refuse(
        of_file("c.yaml", odd_camera, read_camera_file)
    ),
}
"""What is tried, by the name of its row."""
