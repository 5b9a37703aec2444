"""Learn the landmark classifiers from drives: `python -m wayside.pipeline.learn_landmarks`.

The drives are others than those of `learn.py`: on images that a detector has learned from, its scores are higher than
on the road.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import cv2

from wayside.pipeline.flow import Flow
from wayside.pipeline.learn import PROCESSES, learning_logs, write_model
from wayside.pipeline.learning.detector_images import checked_boxes
from wayside.pipeline.learning.landmarks import (
    KnownPanels,
    LandmarkSamples,
    PosedDrive,
    gather_landmarks,
    joined,
    learn_landmark_classifier,
)
from wayside.pipeline.learning.samples import LEARN_READ, read_truth
from wayside.pipeline.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.settings import ReadSettings
from wayside.stages.odometry import estimate_motion

LENIENT = (0.0, 1.0, 2.0)
"""Log odds by which the threshold of faces is lowered: else few landmarks are no signs."""

REAL_DRIVES = {"ca_city_garmin": ("garmin", 0.0), "us_freeway_yellow_left": ("udacity", 5.9)}
"""Real drives to learn from, each with networks that have not learned from it: source, and distance between images
where the log states none, metres."""

Notify = Callable[[str], None]


def learn_landmarks(
    drives: Path,
    folder: Path,
    notify: Notify,
    real: Path | None = None,
    without: Path | None = None,
) -> dict[str, str]:
    """Learn `place.json` and `back_place.json` from the drives of a folder; the digests by file name.

    folder: the models that the drives are tracked with; what is learned is written there. real: folder of the
    `REAL_DRIVES`; without: folder of models, in folders named after the real drive that they have not learned from. A
    drive that `folder` is named after is left out.

    Raises
    ------
    InputError
        If there are no drives, one cannot be used, or they show too few landmarks.
    OutputError
        If a file cannot be written.
    """
    logs = learning_logs(drives)
    tasks = [
        (folder, log, KnownPanels.of(read_truth(log.with_suffix(".truth.json"))), "", LEARN_READ)
        for log in logs
    ]  # or processes are started for nothing
    for name, (source, spacing_m) in REAL_DRIVES.items():
        if real is not None and name != folder.name:
            log = real / f"{name}.mcap"
            labels = json.loads(log.with_suffix(".labels.json").read_text(encoding="utf-8"))
            known = KnownPanels.of_labels(labels, checked_boxes(name))
            own = folder if without is None or not (without / name).is_dir() else without / name
            read = replace(LEARN_READ, spacing_m=spacing_m)
            tasks.append((own, log, known, source, read))
    with ProcessPoolExecutor(
        PROCESSES, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    ) as processes:
        samples = joined(list(processes.map(_landmarks_of, *zip(*tasks, strict=True))))
    digests: dict[str, str] = {}
    for name, back in (("place.json", False), ("back_place.json", True)):
        side = samples.select(samples.back == back)
        origin = provenance([log.stem for _, log, *_ in tasks], side)
        try:
            model = learn_landmark_classifier(side, origin)
        except InputError as error:
            notify(f"{name} not written, such landmarks are classified by their fit alone: {error}")
        else:
            digests[name] = write_model(folder / name, model, notify)
    return digests


def provenance(names: list[str], samples: LandmarkSamples) -> str:
    """What a model was learned from: drives by name, with the number of landmarks of each."""
    counts = [int((samples.drive == number).sum()) for number in range(len(names))]
    listed = ", ".join(f"{n} ({count} landmarks)" for n, count in zip(names, counts, strict=True))
    return f"drives {listed}; the name of a rendered one ends in what was added to the seed of its specification"


def _landmarks_of(
    folder: Path, log: Path, known: KnownPanels, source: str, read: ReadSettings
) -> LandmarkSamples:
    return gather_landmarks(_posed(folder, log, known, source, read))


def _posed(
    folder: Path, log: Path, known: KnownPanels, source: str, read: ReadSettings
) -> Iterator[PosedDrive]:
    """A drive up to its motion, with its panels, once for each threshold of faces."""
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models = load_models(settings)
    for lower in LENIENT:
        scores = models.front_scores
        if scores is None:
            raise InputError(f"{folder}: wanted thresholds of the box network, found none")
        lenient = replace(scores, threshold=scores.threshold - lower)
        flow = Flow(settings, replace(models, front_scores=lenient), StageClock())
        frames = read_frames(log, read, ReadReport())
        moved = estimate_motion(flow.detect(frames), settings.motion)
        front, back = flow.box_classifiers()
        yield PosedDrive(
            log.stem, moved, front, back, known, flow.panel_method(), source, lower == 0
        )


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m wayside.pipeline.learn_landmarks", description=__doc__
    )
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the model files")
    parser.add_argument("--real", type=Path, help="folder of real drives")
    parser.add_argument("--without", type=Path, help="folder of models without a real drive")
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        learn_landmarks(
            given.drives,
            given.out,
            lambda text: print(text, flush=True),
            given.real,
            given.without,
        )
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
