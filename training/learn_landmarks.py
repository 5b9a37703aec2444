"""Learn the landmark classifiers from drives: `python -m training.learn_landmarks`.

The drives are others than those of `learn.py`: on images that a detector has learned from, its scores are higher than
on the road.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import cv2

from training.detector_images import checked_boxes
from training.landmarks import (
    KnownPanels,
    LandmarkRow,
    LandmarkSamples,
    labelled_landmarks,
    learn_landmark_classifier,
    samples_of,
)
from training.learn import PROCESSES, learning_logs, run, write_model
from wayside.pipeline.chains import panel_method
from wayside.pipeline.detectors import detector_of
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.truth import LEARN_READ, read_truth
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ReadSettings, TrackSettings
from wayside.stages.mapping import track
from wayside.stages.odometry import estimate_motion

LENIENT = (0.0, 1.0, 2.0)
"""Log odds by which the threshold of faces is lowered: else few landmarks are no signs."""

FEWEST = 2
"""Landmarks of fewer views than are reported are learned from, too: there are more, and the number is a feature."""

REAL_DRIVES = {"ca_city_garmin": ("garmin", 0.0), "us_freeway_yellow_left": ("udacity", 5.9)}
"""Real drives to learn from, each with networks that have not learned from it: source, and distance between images
where the log states none, metres."""


def learn_landmarks(
    drives: Path,
    folder: Path,
    real: Path | None = None,
    without: Path | None = None,
) -> None:
    """Learn `place.json` and `back_place.json` from the drives of a folder.

    `folder`: the models that the drives are tracked with; what is learned is written there. `real`: folder of the
    `REAL_DRIVES`. `without`: folder of models, in folders named after the real drive that they have not learned from. A
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
        (folder, log, KnownPanels.of(read_truth(log.with_suffix(".truth.json"))), LEARN_READ)
        for log in logs
    ]  # or processes are started for nothing
    sources = [""] * len(logs)
    for name, (source, spacing_m) in REAL_DRIVES.items():
        if real is not None and name != folder.name:
            log = real / f"{name}.mcap"
            labels = json.loads(log.with_suffix(".labels.json").read_text(encoding="utf-8"))
            known = KnownPanels.of_labels(labels, checked_boxes(name))
            own = folder if without is None or not (without / name).is_dir() else without / name
            read = replace(LEARN_READ, spacing_m=spacing_m)
            tasks.append((own, log, known, read))
            sources.append(source)
    with ProcessPoolExecutor(
        PROCESSES, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    ) as processes:
        found = processes.map(_landmarks_of, *zip(*tasks, strict=True))
        samples = samples_of(list(zip(sources, found, strict=True)))
    for name, back in (("place.json", False), ("back_place.json", True)):
        side = samples.select(samples.back == back)
        origin = provenance([log.stem for _, log, *_ in tasks], side)
        try:
            model = learn_landmark_classifier(side, origin)
        except InputError as error:
            print(f"{name} not written, such landmarks are classified by their fit alone: {error}")
        else:
            write_model(folder / name, model)


def provenance(names: list[str], samples: LandmarkSamples) -> str:
    """What a model was learned from: drives by name, with the number of landmarks of each."""
    counts = [int((samples.drive == number).sum()) for number in range(len(names))]
    listed = ", ".join(f"{n} ({count} landmarks)" for n, count in zip(names, counts, strict=True))
    return f"drives {listed}; the name of a rendered one ends in what was added to the seed of its specification"


def _landmarks_of(
    folder: Path, log: Path, known: KnownPanels, read: ReadSettings
) -> list[LandmarkRow]:
    """The landmarks of a drive by the models of a folder, once for each threshold of faces."""
    settings, _ = load_settings("default", None, [], {"models.folder": str(folder)})
    models, rows = load_models(settings), list[LandmarkRow]()
    if models.front_scores is None:
        raise InputError(f"{folder}: there are no thresholds of the box network")
    for lower in LENIENT:
        scores = replace(models.front_scores, threshold=models.front_scores.threshold - lower)
        # without landmark classifiers, everything that stands is followed to its end
        own = replace(
            models, front_scores=scores, landmark_classifier=None, back_landmark_classifier=None
        )
        found = Flow(settings, own, StageClock()).detect(read_frames(log, read, ReadReport()))
        moved = estimate_motion(found, settings.motion)
        detector = detector_of(settings, own)
        settled = TrackSettings(fewest_views=FEWEST)
        panel = panel_method(own)
        tracked = track(moved, settled, detector.front, detector.back, panel)
        rows += labelled_landmarks(tracked, known, usual=lower == 0)
    return rows


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m training.learn_landmarks", description=__doc__)
    parser.add_argument("--drives", type=Path, required=True, help="folder of rendered drives")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the model files")
    parser.add_argument("--real", type=Path, help="folder of real drives")
    parser.add_argument("--without", type=Path, help="folder of models without a real drive")
    given = parser.parse_args(arguments)
    return run(
        lambda: learn_landmarks(given.drives, given.out, real=given.real, without=given.without)
    )


if __name__ == "__main__":
    sys.exit(main())
