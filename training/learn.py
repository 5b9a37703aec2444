"""Learn where signs stand and the outlines of panels from rendered drives: `python -m training.learn`.

The networks (`network_training.py`), their thresholds (`box_thresholds.py`), the landmark classifiers, which decide on
what these let through (`learn_landmarks.py`), and the face classifier (`face_codes.py`) are learned by themselves.

The same drives, seed and package versions give the same files.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from training.outlines import gather_choices, learn_outlines
from wayside.pipeline.chains import panel_method
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import not_written, write_file
from wayside.pipeline.learning.truth import LEARN_READ, location_model, read_truth, sign_positions
from wayside.pipeline.models.model_files import load_models, shipped_models
from wayside.pipeline.models.model_json import model_to_json
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError, OutputError, WaysideError
from wayside.schemas.frame import Image
from wayside.schemas.models import Model
from wayside.stages.imaging import decode

PREFIX = "learn_"
"""Drives of a folder that are learned from bear this at the front of their name; the others are for measuring."""

PROCESSES = 2
"""How many drives are run at a time."""


def learning_logs(folder: Path) -> list[Path]:
    """The rendered drives of a folder that are learned from, in order. Raises InputError without drives."""
    logs = sorted(folder.glob(f"{PREFIX}*.mcap"))
    if not logs:
        raise InputError(f"{folder}: there are no drives named {PREFIX}*.mcap. Render them first.")
    return logs


def learn(drives: Path, out: Path, seed: int) -> None:
    """Learn `location.json` and `outline.json` and write them into `out`.

    Raises
    ------
    InputError
        If there are no learning drives, one cannot be used, or they show too few signs.
    OutputError
        If a file cannot be written, or `out` is where the models that ship lie: they are in use meanwhile.
    """
    if out.resolve() == Path(str(shipped_models())).resolve():
        raise OutputError(
            f"{out}: this is the folder of the models that ship, which are in use while others are learned. Choose "
            "another folder; `make learn` moves the new ones at its end."
        )
    logs = learning_logs(drives)
    truths = [read_truth(log.with_suffix(".truth.json")) for log in logs]
    listed = ", ".join(
        f"{truth['name']} ({len(truth['frames'])} images, {len(truth['signs'])} signs)"
        for truth in truths
    )
    origin = f"rendered drives {listed}; seed {seed}; numpy {np.__version__}"
    places = np.concatenate([sign_positions(truth) for truth in truths])
    write_model(out / "location.json", location_model(places, origin))
    settings, _ = load_settings()
    # views are registered with the model that ships
    method = panel_method(load_models(settings))
    choices = [
        choice
        for log, truth in zip(logs, truths, strict=True)
        for choice in gather_choices(images(log), truth, method, seed)
    ]
    write_model(out / "outline.json", learn_outlines(choices, origin))


def images(log: Path) -> Iterator[Image]:
    """Every image of a log, decoded, in order."""
    return decode(read_frames(log, LEARN_READ, ReadReport()))


def write_model(path: Path, model: Model) -> None:
    """Write a model over the file of an earlier one, and say so; raises OutputError where that cannot be done."""
    text = model_to_json(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(path, error, "a model") from error
    write_file(path, text.encode(), overwrite=True)  # models are learned again into their folder
    print(f"{path}: {len(text) / 1e3:.0f} kB; {model.provenance}", flush=True)


def run(work: Callable[[], object]) -> int:
    """Do what a command line asks for; the exit status."""
    cv2.setNumThreads(1)
    try:
        work()
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m training.learn", description=__doc__)
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the model files")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    return run(lambda: learn(given.drives, given.out, given.seed))


if __name__ == "__main__":
    sys.exit(main())
