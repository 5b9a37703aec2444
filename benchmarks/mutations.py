"""Inputs changed at random: logs, images, calibrations, settings, labels and models (used by reliability_logs.py)."""

from __future__ import annotations

import io
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from random_changes import changed_bytes, changed_tree

from recordings.drives.messages.content import Calibration, CameraPose, FixReading
from recordings.drives.messages.dialects import DIALECTS
from recordings.drives.spec import CameraSpec
from wayside.pipeline.evaluation import evaluate
from wayside.pipeline.model_files import shipped_models
from wayside.pipeline.reading.camera_file import read_camera_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.reading.records import Message, scan
from wayside.pipeline.reading.scan_report import ScanReport
from wayside.pipeline.settings_file import format_settings, load_settings
from wayside.schemas.errors import WaysideError
from wayside.schemas.model_json import model_from_json
from wayside.schemas.models import (
    EvidenceModel,
    GaussianModel,
    LinearModel,
    MixtureModel,
    ScoreModel,
)
from wayside.schemas.settings import ReadSettings
from wayside.schemas.tables import FRAMES, OBSERVATIONS, SIGNS
from wayside.stages.imaging import decode

ROOT = Path(__file__).resolve().parents[1]
START, STEP = 1_700_000_000 * 10**9, 10**9 // 4
WIDTH, HEIGHT = 48, 32
PACKINGS: dict[str, dict[str, Any]] = {
    "not chunked": {"use_chunking": False},
    "chunks": {"compression": CompressionType.NONE},
    "lz4 chunks": {"compression": CompressionType.LZ4},
    "zstd chunks": {"compression": CompressionType.ZSTD},
}
Found = list[tuple[str, int, bytes]]


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


MEMORY_BYTES = 512 << 20
"""What an attempt may take beyond the process as it is."""
LONGEST_S = 2.0


@dataclass(slots=True)
class Tally:
    """What came of many attempts."""

    tries: int = 0
    told: int = 0
    refused: int = 0
    wrong: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    grown_mb: float = 0.0

    def add(self, found: dict[str, Any]) -> None:
        """Count one attempt that another process has made."""
        self.tries += 1
        self.told += found.get("told", 0)
        self.refused, self.wrong = self.refused + found["refused"], self.wrong + found["wrong"]
        if found["fault"]:
            self.faults[found["fault"]] += 1
        self.slowest_s = max(self.slowest_s, found["s"])
        self.grown_mb = max(self.grown_mb, found["grown_mb"])

    def attempt(self, work: Callable[[], object]) -> Any:
        """Result of the work; None where it was refused with words, or broke."""
        self.tries += 1
        started = time.process_time()
        try:
            return work()
        except WaysideError:
            self.refused += 1
        except Exception as error:
            self.faults[f"{type(error).__name__}: {error}"[:100]] += 1
        finally:
            self.slowest_s = max(self.slowest_s, time.process_time() - started)
        return None


Attempt = Callable[[Tally, random.Random], None]
Prepare = Callable[[Path], Attempt]
"""Makes what is to be changed, in a folder of its own."""


def read(path: Path) -> Found:
    """Topic, number and bytes of all messages."""
    found = (m for m in scan(path, ScanReport()) if isinstance(m, Message))
    return [(m.channel.topic, m.sequence, bytes(m.data)) for m in found]


def mutation_table(
    kinds: Mapping[str, Prepare], count: int, seed: int, folder: Path, only: str
) -> Iterator[str]:
    """Rows of the table of mutations, one a kind of input whose name contains `only`."""
    for title, prepare in ((name, made) for name, made in kinds.items() if only in name):
        tally = isolated(title, prepare, count, seed, folder)
        for fault, times in tally.faults.most_common():
            print(f"{title}: {times} x {fault}", file=sys.stderr)
        yield (
            f"| {title} | {tally.tries} | {tally.refused} | {tally.wrong} | {sum(tally.faults.values())} | "
            f"{1e3 * tally.slowest_s:.0f} | {tally.grown_mb:.0f} |"
        )


def isolated(title: str, prepare: Prepare, count: int, seed: int, folder: Path) -> Tally:
    """Attempts in a forked process with limits of memory and time; one that dies is counted, and a new one goes on."""
    total, done = Tally(), 0
    while done < count:
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            status = 1
            try:
                os.close(reading)
                with os.fdopen(writing, "w") as report:
                    _attempts(title, prepare, range(done, count), seed, folder, report)
                status = 0
            finally:
                os._exit(status)
        os.close(writing)
        with os.fdopen(reading) as reports:
            for line in reports:
                total.add(json.loads(line))
                done += 1
        _, status = os.waitpid(child, 0)
        if status and done < count:
            words = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"exit {status}"
            total.add({"refused": 0, "wrong": 0, "fault": words, "s": 0.0, "grown_mb": 0.0})
            done += 1
    return total


def _attempts(
    title: str, prepare: Prepare, numbers: range, seed: int, folder: Path, report: TextIO
) -> None:
    own = Path(tempfile.mkdtemp(dir=folder))
    attempt = prepare(own)
    attempt(Tally(), random.Random(0))  # imports and compiles
    before = _resident_mb()
    limit = _size_bytes() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number in numbers:
        tally = Tally()
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)  # CPU time; the signal ends the process
        attempt(tally, random.Random(f"{seed} {title} {number}"))
        signal.setitimer(signal.ITIMER_PROF, 0)
        found = {"told": tally.told, "refused": tally.refused, "wrong": tally.wrong}
        found |= {"s": tally.slowest_s}
        found |= {"fault": next(iter(tally.faults), ""), "grown_mb": _resident_mb() - before}
        report.write(json.dumps(found) + "\n")
        report.flush()


def _resident_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def _size_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _mutated_logs(folder: Path) -> Attempt:
    path = folder / "changed.mcap"
    logs = []
    for dialect in DIALECTS:
        for name, options in PACKINGS.items():
            content = small_log(dialect, 5, chunk_size=6000, **options)
            path.write_bytes(content)
            logs.append((content, {one[2] for one in read(path)}, name != "not chunked"))

    def attempt(tally: Tally, rng: random.Random) -> None:
        content, known, checked = rng.choice(logs)
        path.write_bytes(changed_bytes(content, rng))

        def work() -> Found:
            found = read(path)
            for _ in decode(read_frames(path, ReadSettings(thin_m=0.0), ReadReport())):
                pass
            return found

        found = tally.attempt(work)
        if (
            checked and found is not None
        ):  # what stands in a chunk has a checksum; a front that is cut off has none
            tally.wrong += sum(one[2] not in known for one in found) > 0

    return attempt


def _mutated_images(_: Path) -> Attempt:
    from wayside.pipeline.reading.image_headers import read_image_header
    from wayside.schemas.frame import USED, Frame

    pixels = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    kinds = (".jpg", ".png", ".webp", ".tiff", ".bmp")
    images = [cv2.imencode(kind, cv2.blur(pixels, (3, 3)))[1].tobytes() for kind in kinds]

    def attempt(tally: Tally, rng: random.Random) -> None:
        data = changed_bytes(rng.choice(images), rng)

        def work() -> None:
            header = read_image_header(data)
            size = (0, 0) if header is None else header[1:]
            if size[0] * size[1] <= 10**6:
                list(decode(iter([Frame(0, 0, None, USED, "", data, None, *size)])))

        tally.attempt(work)

    return attempt


def _mutated_calibrations(folder: Path) -> Attempt:
    path = folder / "camera.yaml"
    text = (
        b"image_width: 640\nimage_height: 480\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        b"  data: [438.78, 0., 305.59, 0., 437.35, 243.74, 0., 0., 1.]\ndistortion_model: plumb_bob\n"
        b"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.36, 0.11, 0.001, 0.0005, 0.0]\n"
    )

    def attempt(tally: Tally, rng: random.Random) -> None:
        path.write_bytes(changed_bytes(text, rng))
        tally.attempt(lambda: read_camera_file(path))

    return attempt


def _mutated_settings(folder: Path) -> Attempt:
    path = folder / "settings.toml"
    text = format_settings(*load_settings(), expert=False).encode()

    def attempt(tally: Tally, rng: random.Random) -> None:
        path.write_bytes(changed_bytes(text, rng))
        tally.attempt(lambda: load_settings("default", path))

    return attempt


def small_result(folder: Path, rows: int = 1) -> Path:
    """A result of some images with one sign, or several; without `run.json`."""
    out = folder / "out"
    out.mkdir()
    signs = [
        {c.name: None for c in SIGNS.columns} | {
            "sign_id": f"a-{k + 1:04d}", "status": "sign", "color": "red", "shape": "octagon", "best_frame": 3,
            "best_box": [10.0, 10.0, 30.0, 30.0], "right_m": 4.0, "down_m": -1.0, "ahead_m": 20.0,
        }
        for k in range(rows)
    ]  # fmt: skip
    for table, content in (
        (SIGNS, signs),
        (OBSERVATIONS, []),
        (FRAMES, [{"frame": k} for k in range(6)]),
    ):
        required = {f.name: _some(f) for f in table.schema if not f.nullable}
        full = [required | {k: v for k, v in row.items() if v is not None} for row in content]
        pq.write_table(pa.Table.from_pylist(full, table.schema), out / table.file)
    return out


def _mutated_labels(folder: Path) -> Attempt:
    out, path = small_result(folder), folder / "labels.json"
    truth = json.loads((ROOT / "recordings" / "demo.truth.json").read_text())
    truth["signs"], truth["frames"] = truth["signs"][:2], truth["frames"][:6]
    for one in truth["signs"]:
        one["frames"] = one["frames"][:3]
    box = {"i": 3, "box": [11, 11, 29, 31]}
    labels = {
        "signs": [{"id": "s1", "wanted": True, "boxes": [box]}],
        "stride": 2,
        "distractors": [{"what": "lamp", "source_frame": 4, "box": [1, 2, 3, 4]}],
    }

    def attempt(tally: Tally, rng: random.Random) -> None:
        path.write_text(json.dumps(changed_tree(rng.choice((truth, labels)), rng)))
        tally.attempt(lambda: evaluate(out, path))

    return attempt


def _some(column: pa.Field) -> Any:
    kind = column.type
    if pa.types.is_dictionary(kind) or pa.types.is_string(kind):
        return ""
    if pa.types.is_fixed_size_list(kind):
        return [0.0] * kind.list_size
    return 0


def _mutated_models(_: Path) -> Attempt:
    names = ("place", "location", "outline", "color_rgb", "front", "back", "trajectory")
    models = [json.loads((shipped_models() / f"{name}.json").read_text()) for name in names]

    def attempt(tally: Tally, rng: random.Random) -> None:
        text = json.dumps(changed_tree(rng.choice(models), rng))

        def work() -> None:
            model = model_from_json(text)
            values = np.random.default_rng(0).normal(size=(20, 1000)).astype(np.float32)
            with np.errstate(all="ignore"):
                if isinstance(model, GaussianModel) and model.classes:
                    model.distances(values[:, : model.classes[0].mean.size])
                elif isinstance(model, MixtureModel):
                    model.log_density(values[:, : model.mean.shape[1]])
                elif isinstance(model, LinearModel):
                    model.values(values[:, : len(model.features)].astype(np.float64))
                elif isinstance(model, EvidenceModel):
                    model.ratios(dict.fromkeys(model.features, 0.5))
                elif isinstance(model, ScoreModel) and model.with_network is not None:
                    joined = model.with_network
                    values @ np.full(1000, joined.own + joined.network + joined.shift)

        tally.attempt(work)

    return attempt


KINDS: dict[str, Prepare] = {
    "logs, read to frames and decoded": _mutated_logs,
    "images": _mutated_images,
    "calibrations (YAML)": _mutated_calibrations,
    "settings (TOML)": _mutated_settings,
    "labels and truth (JSON)": _mutated_labels,
    "models (JSON), evaluated where they are accepted": _mutated_models,
}
