"""Learn from rendered drives and real images: `python -m wayside.pipeline.learn`.

Where signs stand, the outlines of panels and how signs move; with `--network-steps` the two
networks of preset `default` instead. Their thresholds and the landmark classifiers, which decide on what these
let through, are learned after them: `learning/box_thresholds.py`, `learn_landmarks.py`.

The same drives, images, seed and package versions give the same files.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wayside.pipeline.flow import Flow
from wayside.pipeline.learning import trajectories
from wayside.pipeline.learning.gaussians import location_model
from wayside.pipeline.learning.outlines import OutlineChoice, gather_choices, learn_outlines
from wayside.pipeline.learning.samples import LEARN_READ, read_truth, sign_positions
from wayside.pipeline.learning.scenes import real_sources
from wayside.pipeline.model_files import load_models, shipped_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.pipeline.writing import not_written, write_file
from wayside.schemas.errors import InputError, OutputError, WaysideError
from wayside.schemas.frame import Image
from wayside.schemas.model_json import digest, model_to_json
from wayside.schemas.models import Model
from wayside.stages.imaging import decode

PREFIX = "learn_"
"""Drives of a folder that are learned from bear this at the front of their name; the others are for measuring."""

PROCESSES = 2
"""How many drives are run at a time."""

Notify = Callable[[str], None]


def learning_logs(folder: Path) -> list[Path]:
    """The rendered drives of a folder that are learned from, in order; raises InputError where there is none."""
    logs = sorted(folder.glob(f"{PREFIX}*.mcap"))
    if not logs:
        raise InputError(
            f"{folder}: wanted drives named {PREFIX}*.mcap, found none; render them first"
        )
    return logs


def learn(drives: Path, out: Path, seed: int, notify: Notify) -> dict[str, str]:
    """Learn every model and write it into `out`; the digests by file name.

    Raises
    ------
    InputError
        If there are no learning drives, or one cannot be used.
    OutputError
        If a file cannot be written, or `out` is where the models that ship lie: they are in use meanwhile.
    """
    if out.resolve() == Path(str(shipped_models())).resolve():
        raise OutputError(
            f"{out}: wanted a folder of its own, found that of the models that ship, which are in use while others are "
            "learned; `make learn` puts the new ones there at its end"
        )
    logs = learning_logs(drives)
    truths = [read_truth(log.with_suffix(".truth.json")) for log in logs]
    rendered = _origin(truths, seed)
    places = np.concatenate([sign_positions(truth) for truth in truths])
    models: dict[str, Model] = {"location.json": location_model(places, rendered)}
    digests = {name: write_model(out / name, model, notify) for name, model in models.items()}
    further: dict[str, Callable[[], Mapping[str, Model]]] = {
        "outline.json": lambda: {
            "outline.json": learn_outlines(outline_choices(logs, seed), rendered)
        },
        "trajectory.json": lambda: trajectories.learn(logs, str(out), PROCESSES, notify),
    }
    for name, learned in further.items():
        try:
            digests |= {n: write_model(out / n, model, notify) for n, model in learned().items()}
        except InputError as error:
            notify(f"{name} not written, the model that ships is used: {error}")
    return digests


def outline_choices(logs: Sequence[Path], seed: int) -> list[OutlineChoice]:
    """The candidates of the outlines of all faces of the drives; views are registered with the model that ships."""
    settings, _ = load_settings()
    method = Flow(settings, load_models(settings), StageClock()).panel_method()
    choices: list[OutlineChoice] = []
    for log in logs:
        truth = read_truth(log.with_suffix(".truth.json"))
        choices += gather_choices(images(log), truth, method, seed)
    return choices


def images(log: Path) -> Iterator[Image]:
    """Every image of a log, decoded, in order."""
    return decode(read_frames(log, LEARN_READ, ReadReport()))


def _origin(truths: Sequence[Mapping[str, Any]], seed: int) -> str:
    """What was learned from: each drive with its number of images."""
    rendered = ", ".join(f"{one['name']} ({len(one['frames'])} images)" for one in truths)
    return f"rendered drives {rendered}; seed {seed}; numpy {np.__version__}"


def write_model(path: Path, model: Model, notify: Notify) -> str:
    """Write a model over the file of an earlier one; its digest. Raises OutputError where that cannot be done."""
    text = model_to_json(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(path, error, "to write a model here") from error
    write_file(path, text.encode(), overwrite=True)  # models are learned again into their folder
    notify(f"{path}: {len(text) / 1e3:.0f} kB; {model.provenance}")
    return digest(text)


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m wayside.pipeline.learn", description=__doc__)
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("--real", type=Path, help="folder of real images with boxed signs")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the model files")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--network-steps",
        type=int,
        metavar="N",
        help="train the detection network and the box network up to so many steps instead (can be interrupted and "
        "goes on from its checkpoint in the folder), and write network.onnx and box.onnx",
    )
    parser.add_argument(
        "--begin-from",
        type=Path,
        metavar="FOLDER",
        help="begin that training with the weights of the networks in a folder, not at random",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        metavar="SOURCE",
        help="train networks beside, into the folder `without`, that see nothing of a source of real images, so that "
        "they can be measured on it; repeatable",
    )
    parser.add_argument(
        "--proposing",
        type=Path,
        metavar="NETWORK.onnx",
        default=Path(str(shipped_models() / "network.onnx")),
        help="detection network whose boxes the box network learns to classify; default: the one that ships",
    )
    parser.add_argument(
        "--processes",
        type=int,
        metavar="N",
        help="processes that make crops; default: cores less one",
    )
    parser.add_argument(
        "--device", choices=("cpu", "cuda"), help="default: cuda where there is one"
    )
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    if given.real is None and given.network_steps is not None:
        parser.error("the training of the networks wants --real")
    if given.begin_from is not None and given.without:
        parser.error(
            "wanted --begin-from or --without: networks that are begun from may have seen the source"
        )
    try:
        if given.network_steps is not None:
            _train(given)
        else:
            learn(given.drives, given.out, given.seed, partial(print, flush=True))
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def _train(given: argparse.Namespace) -> None:
    """Train the networks; PyTorch and onnx are wanted by nothing else here."""
    real_sources(given.real, given.without)  # before minutes of reading images
    from wayside.pipeline.learning.network_training import TrainingOptions, learn_networks

    asked = {
        name: getattr(given, name)
        for name in ("processes", "device")
        if getattr(given, name) is not None
    }
    options = TrainingOptions(
        given.network_steps,
        given.seed,
        given.proposing,
        begin_from=given.begin_from,
        without=given.without,
        **asked,
    )
    learn_networks(given.drives, given.real, given.out, options)


if __name__ == "__main__":
    sys.exit(main())
