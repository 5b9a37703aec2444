"""Real drives seen by other cameras: how much of what is found rests on the very pixels; writes altered_images.md.

    .venv/bin/python benchmarks/altered_images.py [--real FOLDER] [--only NAME ...]

The images of each real drive are altered as another camera, light or codec would (`ALTERED`) and run again by models
that never saw the drive. Counts of so few signs move with next to nothing: the rows beside the first say by how much.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from accept import REAL, RESULTS, ROOT, WITHOUT
from checked_boxes import with_checked_boxes
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray
from real_counts import Counts, counts_by_confidence, total

from wayside.pipeline.statistics import share_interval

Bgr = NDArray[np.uint8]
UNSEEN = ("de_road_kitti0015", "ca_city_garmin", "de_city_kitti0001", "de_autobahn")
"""Drives that no model of the runs has learned from: `ca_city_garmin` is run by models without it."""
QUALITY, LOW_QUALITY, HALF = 90, 35, 0.5
SIGN_FROM = 0.5
"""Confidence from which a row is a sign, as in a run."""
PAGE = ROOT / "benchmarks" / "altered_images.md"


def _levels(image: Bgr, change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Bgr:
    return np.clip(np.rint(change(image.astype(np.float64))), 0, 255).astype(np.uint8)


def _dark(image: Bgr) -> Bgr:
    noise = np.random.default_rng(0).normal(0, 4, image.shape)
    return _levels(image, lambda x: 178 * (x / 255) ** 1.8 + noise)


ALTERED: Mapping[str, tuple[str, Callable[[Bgr], Bgr]]] = {
    "as recorded": ("the log itself", lambda image: image),
    "encoded again": (f"JPEG of quality {QUALITY}", lambda image: image),
    "coarse JPEG": (f"JPEG of quality {LOW_QUALITY}", lambda image: image),
    "dark": ("gamma 1.8, 0.7 of the light, noise of 4 levels", _dark),
    "bright": ("1.45 of the light, clipped", lambda image: _levels(image, lambda x: 1.45 * x + 12)),
    "warm": (
        "blue 0.75, red 1.15",
        lambda image: _levels(image, lambda x: x * np.array([0.75, 1, 1.15])),
    ),
    "cold": (
        "blue 1.2, red 0.78",
        lambda image: _levels(image, lambda x: x * np.array([1.2, 1, 0.78])),
    ),
    "flat": (
        "0.55 of the contrast, as in haze",
        lambda image: _levels(image, lambda x: 70 + 0.55 * x),
    ),
    "blurred": (
        "Gaussian of 1.2 px",
        lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), 1.2), np.uint8),
    ),
    "mirrored": (
        "traffic on the left, and no text that can be read",
        lambda image: np.ascontiguousarray(image[:, ::-1]),
    ),
    "half size": (
        "faces half as large",
        lambda image: np.asarray(
            cv2.resize(image, None, fx=HALF, fy=HALF, interpolation=cv2.INTER_AREA), np.uint8
        ),
    ),
}
"""What is done to each image, in words and as a function."""


def main() -> int:
    """Run every drive with every alteration, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--real", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    parser.add_argument("--only", nargs="+", choices=tuple(ALTERED), default=tuple(ALTERED))
    args = parser.parse_args()
    cv2.setNumThreads(1)
    folder = RESULTS / "altered"
    folder.mkdir(parents=True, exist_ok=True)
    rows = {}
    for how in args.only:
        counts = []
        for name in UNSEEN:
            counts.append(counts_of(args.real, name, how, folder))
            print(f"{how:14} {name:20} {counts[-1]}", flush=True)
        rows[how] = total(counts)
    if set(rows) == set(ALTERED):
        PAGE.write_text("\n".join(page(rows)) + "\n", encoding="utf-8")
    return 0


def counts_of(real: Path, name: str, how: str, folder: Path) -> Counts:
    """What a run of an altered drive finds."""
    log, out = folder / f"{name}.mcap", folder / name
    size = write_altered(real / f"{name}.mcap", log, how)
    models = WITHOUT / name
    command = [
        str(Path(sys.executable).with_name("wayside")),
        "run",
        str(log),
        "-o",
        str(out),
        "--overwrite",
    ]
    command += ["--spacing", REAL[name]] if REAL[name] else []
    command += ["--models", str(models)] if models.is_dir() else []
    subprocess.run(command, check=True, capture_output=True)
    labels = json.loads((real / f"{name}.labels.json").read_text(encoding="utf-8"))
    log.unlink()
    labels = altered_labels(with_checked_boxes(labels, name), how, size[0])
    (counts,) = counts_by_confidence(out, labels, (SIGN_FROM,))
    return counts


def write_altered(log: Path, target: Path, how: str) -> tuple[int, int]:
    """Write a log with its images altered, and calibration and fixes to match; width and height of the images."""
    _, change = ALTERED[how]
    size, origin = (0, 0), None
    with log.open("rb") as source, target.open("wb") as sink:
        writer = Writer(sink, compression=CompressionType.ZSTD, chunk_size=1 << 20)
        for schema, channel, message, content in decoded(source):
            if schema == "foxglove.CompressedImage" and how != "as recorded":
                image = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
                image = change(np.asarray(image, np.uint8))
                quality = LOW_QUALITY if how == "coarse JPEG" else QUALITY
                coded = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality))[1]
                content.data, content.format = coded.tobytes(), "jpeg"
                size = image.shape[1], image.shape[0]
            elif schema == "foxglove.CameraCalibration":
                alter_calibration(content, how)
            elif schema == "foxglove.LocationFix" and how == "mirrored":
                origin = content.longitude if origin is None else origin
                content.longitude = 2 * origin - content.longitude
            writer.write_message(
                channel, content, log_time=message.log_time, publish_time=message.publish_time
            )
        writer.finish()
    return size


def decoded(source: Any) -> Iterator[tuple[str, str, Any, Any]]:
    """Schema, topic, message and content of each message of a log."""
    reader = make_reader(source, decoder_factories=[DecoderFactory()])
    for schema, channel, message, content in reader.iter_decoded_messages():
        assert schema is not None
        yield schema.name, channel.topic, message, content


def alter_calibration(content: Any, how: str) -> None:
    """The calibration of mirrored images, or of images of half the size."""
    k, p, d = list(content.K), list(content.P), list(content.D)
    if how == "mirrored":
        k[2], p[2] = content.width - 1 - k[2], content.width - 1 - p[2]
        if len(d) > 3:
            d[3] = -d[3]
    if how == "half size":
        for matrix, row in ((k, 3), (p, 4)):
            matrix[0], matrix[row + 1] = HALF * matrix[0], HALF * matrix[row + 1]
            for at in (2, row + 2):
                matrix[at] = HALF * (matrix[at] + 0.5) - 0.5
        content.width, content.height = round(HALF * content.width), round(HALF * content.height)
    content.K[:], content.P[:], content.D[:] = k, p, d


def altered_labels(labels: dict[str, Any], how: str, width: int) -> dict[str, Any]:
    """The labels with the boxes of the altered images."""

    def moved(box: list[float]) -> list[float]:
        x0, y0, x1, y1 = (HALF * edge if how == "half size" else edge for edge in box)
        return [width - x1, y0, width - x0, y1] if how == "mirrored" else [x0, y0, x1, y1]

    for thing in (*labels["signs"], *labels["distractors"]):
        if "box" in thing:
            thing["box"] = moved(thing["box"])
        for entry in thing.get("boxes", ()):
            entry["box"] = moved(entry["box"])
    return labels


def page(rows: Mapping[str, Counts]) -> Iterator[str]:
    """The table and what it says."""
    yield "# Real drives seen by other cameras"
    yield ""
    names = ", ".join(f"`{name}`" for name in UNSEEN)
    yield (
        f"Made by `benchmarks/altered_images.py`: {names}, preset `default`, by models that learned nothing from the "
        "drive, with every image altered. Rows on signs that the labels leave out are right "
        "([checked_boxes.py](checked_boxes.py)). Intervals: 95 %, Wilson's score. The white balance was "
        "chosen with the rows as recorded, warm and cold in view, the focal length below which images are seen "
        "enlarged with half size, nothing else by altered images; "
        "by the drives as recorded much was ([accuracy_real.md](accuracy_real.md))."
    )
    yield ""
    heads = (
        "images",
        "what is done to them",
        "found without plates",
        "recall (95 %)",
        "parking and bus stop plates",
        "rows on no sign",
        "per 100 images",
    )
    yield f"| {' | '.join(heads)} |"
    yield f"| --- | --- |{' ---: |' * (len(heads) - 2)}"
    for how, one in rows.items():
        interval = share_interval(one.found, one.wanted)
        assert interval is not None
        yield (
            f"| {how} | {ALTERED[how][0]} | {one.found} of {one.wanted} | {one.found / one.wanted:.3f} "
            f"({interval.low:.3f} to {interval.high:.3f}) | {one.plates} of {one.wanted_plates} | {one.false} | "
            f"{100 * one.false / one.images:.1f} |"
        )


if __name__ == "__main__":
    sys.exit(main())
