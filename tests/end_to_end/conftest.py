"""The demo log, run once per preset and session through the command `wayside run`."""

import json
import signal
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer

from wayside.pipeline.cli import app

RECORDINGS = Path(__file__).parents[2] / "recordings"
HALF_PX = 0.5
"""The truth has pixel centres at integers, boxes have their edges there."""


@dataclass(frozen=True)
class Result:
    """The tables of a result folder as rows, and its `run.json`."""

    signs: list[dict[str, Any]]
    observations: list[dict[str, Any]]
    frames: list[dict[str, Any]]
    about: dict[str, Any]

    @property
    def verdicts(self):
        """Regions by the verdict on them, the unlisted ones too."""
        return dict(self.about["accounting"]["regions"])


def run_log_file(log, folder, *options):
    """Run a log with those options into the folder, in this process, and read the result."""
    assert not app(["run", str(log), "-o", str(folder), *options], standalone_mode=False)
    signs, observations, frames = (
        pq.read_table(folder / f"{name}.parquet").to_pylist()
        for name in ("signs", "observations", "frames")
    )
    return Result(signs, observations, frames, json.loads((folder / "run.json").read_text()))


def _as_seen(content, image):
    """The message of an image with other pixels (BGR in, BGR or grey out)."""
    seen = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
    changed = image(np.asarray(seen, np.uint8))
    quality = (cv2.IMWRITE_JPEG_QUALITY, 95)
    content.data = cv2.imencode(".jpg", changed, quality)[1].tobytes()
    return content


def altered_demo(path, image=None, calibration=lambda message: None, most=40, message=None):
    """Write the start of the demo log with every image, and every calibration message, as a function makes it.

    image: of pixels; message: of the whole message of an image, which it gives back.
    """
    with (RECORDINGS / "demo.mcap").open("rb") as source, path.open("wb") as sink:
        writer = Writer(sink)
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for schema, channel, held, content in islice(reader.iter_decoded_messages(), most):
            kind, written = "" if schema is None else schema.name, content
            if kind == "foxglove.CompressedImage":
                written = message(content) if image is None else _as_seen(content, image)
            elif kind == "foxglove.CameraCalibration":
                calibration(content)
            writer.write_message(channel.topic, written, held.log_time, held.publish_time)
        writer.finish()
    return path


@pytest.fixture(scope="session", autouse=True)
def heeded_signals():
    """Let the commands that tests start heed signals, also where a shell has its background jobs ignore them."""
    for name in ("SIGINT", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


@pytest.fixture(scope="session")
def run_demo(tmp_path_factory):
    """A function that runs the demo log with given options and reads the result."""
    log, made = RECORDINGS / "demo.mcap", tmp_path_factory.mktemp
    return lambda *options: run_log_file(log, made("demo"), *options)


@pytest.fixture(scope="session")
def default_demo(run_demo):
    """The result of the preset `default`, on a route."""
    return run_demo("--preset", "default", "--route", "US-36 EB", "--milepost", "12.35")


@pytest.fixture(scope="session")
def truth():
    """What was rendered into the demo log."""
    return dict(json.loads((RECORDINGS / "demo.truth.json").read_text()))


@pytest.fixture(scope="session")
def true_boxes(truth):
    """Rows of a file of boxes: the faces that are half visible at least."""
    rows = []
    for sign in truth["signs"]:
        for view in sign["frames"]:
            if view["side"] == "front" and view["visible_fraction"] >= 0.5:
                x_min, y_min, x_max, y_max = (side + HALF_PX for side in view["box"])
                corners = {"x_min": x_min, "y_min": y_min, "x_max": x_max, "y_max": y_max}
                rows.append({"frame": view["frame"], **corners, "class": sign["kind"]})
    return rows
