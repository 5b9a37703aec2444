"""Learn the models of one image from rendered drives and real images: `python -m wayside.pipeline.learn`.

Those of landmarks, which judge what these let through, are learned after them: `learn_landmarks.py`.

The same drives, images, seed and package versions give the same files.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.flow import Flow
from wayside.pipeline.learning import trajectories
from wayside.pipeline.learning.backs import learn_back_classifier
from wayside.pipeline.learning.camera_augmentation import through_other_cameras
from wayside.pipeline.learning.detector import learn_detector
from wayside.pipeline.learning.detector_images import LabelledImage
from wayside.pipeline.learning.face_drawings import FaceLibrary, read_face_library
from wayside.pipeline.learning.face_naming import learn_name_network
from wayside.pipeline.learning.faces import FaceSample
from wayside.pipeline.learning.gaussians import color_model, location_model, shape_model
from wayside.pipeline.learning.outlines import OutlineChoice, gather_choices, learn_outlines
from wayside.pipeline.learning.samples import (
    LEARN_READ,
    CandidateSamples,
    TrainingDrive,
    for_each,
    read_box_features,
    read_drive,
    read_patches,
    read_truth,
)
from wayside.pipeline.learning.scenes import (
    as_images,
    labelled_images,
    real_faces,
    real_sources,
    scene_drive,
    with_drawn_faces,
)
from wayside.pipeline.model_files import load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.pipeline.writing import not_written, write_file
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.frame import Image
from wayside.schemas.model_json import digest, model_to_json
from wayside.schemas.models import GaussianModel, Model
from wayside.schemas.settings import Settings
from wayside.stages.imaging import decode

PREFIX = "learn_"
"""Drives of a folder that are learned from bear this at the front of their name; the others are for measuring."""

BACKGROUND_OVERLAP = 0.05
"""Regions that overlap no face by more are background."""

FACE_SOURCES = ("scenes/jd", "scenes/mi")
"""Sources whose faces are samples for the classes of the report: others show one camera, or few kinds of signs."""

REPORT_IMAGE = (1600, 1200)
"""Width and height of the images of the report, in pixels."""

PROCESSES = 2
"""How many drives are run at a time."""

Notify = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class TrainingData:
    """All that is learned from: drives, real images as a drive a source, and their images, once more, by name.

    crops: clear faces of real images.
    """

    drives: tuple[TrainingDrive, ...]
    scenes: tuple[TrainingDrive, ...]
    crops: tuple[FaceSample, ...]
    reread: dict[str, Callable[[], Iterator[Image]]]

    def features_of(
        self, drive: TrainingDrive, candidates: CandidateSamples
    ) -> NDArray[np.float32]:
        """Box features (n, features) of some candidates of a drive, from its images read once more."""
        return read_box_features(self.reread[drive.name](), candidates)

    def patches_of(self, drive: TrainingDrive, candidates: CandidateSamples) -> NDArray[np.uint8]:
        """Patches (n, 32, 32, 3) of some candidates of a drive, from its images read once more."""
        return read_patches(self.reread[drive.name](), candidates)


def gather(
    logs: Sequence[Path], real: Path | None, settings: Settings, seed: int, notify: Notify
) -> TrainingData:
    """Go through all drives and real images; raises InputError where one cannot be used."""
    reread: dict[str, Callable[[], Iterator[Image]]] = {}
    network = load_models(settings).detection_network

    def rendered(log: Path) -> TrainingDrive:
        truth = read_truth(log.with_suffix(".truth.json"))
        again = reread[truth["name"]] = partial(_shown, log, seed)
        drive = read_drive(
            images(log), again(), truth, log.with_suffix(".masks"), settings, network
        )
        notify(
            f"{log.stem}: {drive.frames} images, {len(drive.faces)} clear faces, "
            f"{len(drive.candidates.frame)} candidates"
        )
        return drive

    def recorded(source: tuple[str, list[LabelledImage]]) -> TrainingDrive:
        name, labelled = source
        again = reread[name] = partial(_shown_scenes, labelled, seed)
        drive = scene_drive(again(), name, labelled, settings, network)
        notify(f"{name}: {drive.frames} images, {len(drive.signs)} faces")
        return drive

    drives = for_each(rendered, logs)
    sources = real_sources(real) if real else {}
    shown = {name: labelled_images(read) for name, read in sources.items()}
    library = read_face_library(real) if real else FaceLibrary((), ())
    drawn = {name: with_drawn_faces(images, library, seed) for name, images in shown.items()}
    scenes = for_each(recorded, drawn.items())
    crops = (face for name in FACE_SOURCES for face in real_faces(shown.get(name, ())))
    return TrainingData(tuple(drives), tuple(scenes), tuple(crops), reread)


def learning_logs(folder: Path) -> list[Path]:
    """The rendered drives of a folder that are learned from, in order; raises InputError where there is none."""
    logs = sorted(folder.glob(f"{PREFIX}*.mcap"))
    if not logs:
        raise InputError(
            f"{folder}: wanted drives named {PREFIX}*.mcap, found none; render them first"
        )
    return logs


def learn(drives: Path, real: Path | None, out: Path, seed: int, notify: Notify) -> dict[str, str]:
    """Learn every model and write it into `out`; the digests by file name.

    Raises
    ------
    InputError
        If there are no learning drives, or one cannot be used.
    OutputError
        If a file cannot be written.
    """
    logs = learning_logs(drives)
    settings, _ = load_settings()
    samples = gather(logs, real, settings, seed, notify)
    rendered, origin = (
        _origin(samples.drives, (), seed),
        _origin(samples.drives, samples.scenes, seed),
    )
    models = gaussian_models(samples.drives, samples.crops, origin)
    models["location.json"] = learn_locations(samples.drives, rendered)
    candidates = settings.candidates
    detector = learn_detector(
        samples.drives,
        samples.features_of,
        samples.patches_of,
        seed,
        origin,
        candidates,
        samples.scenes,
    )
    notify(detector.classifier.provenance)
    models |= {"judge.json": detector.classifier, "face_box.json": detector.regressor}
    try:
        backs = learn_back_classifier(detector.passed, seed, origin, candidates.same_face_iou)
    except InputError as error:
        notify(f"back.json not written, backs of panels are not detected: {error}")
    else:
        models["back.json"] = backs
    for what in ("color", "shape"):
        try:
            models[f"face_{what}.json"] = learn_name_network(
                detector.passed, what, seed, origin, settings.landmark.least_log_probability
            )
        except InputError as error:
            notify(f"face_{what}.json not written, the model that ships is used: {error}")
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


def gaussian_models(
    drives: Sequence[TrainingDrive],
    crops: Sequence[FaceSample],
    origin: str,
) -> dict[str, Model]:
    """Gaussian classes of colour and shape, by the name of their file.

    The report's classes are those of its one camera, as far as there are drives with images of that size.
    """
    report_drives = [drive for drive in drives if drive.size == REPORT_IMAGE] or drives
    faces = [*(face for drive in report_drives for face in drive.faces), *crops]
    background = np.concatenate(
        [d.candidates.regions.rgb[d.candidates.overlap < BACKGROUND_OVERLAP] for d in drives]
    )
    return {
        "color_rgb.json": color_model(faces, background, origin),
        "shape.json": shape_model(faces, origin),
    }


def learn_locations(drives: Sequence[TrainingDrive], origin: str) -> GaussianModel:
    """Gaussian classes of where signs stand beside the path."""
    return location_model(np.concatenate([d.places for d in drives]), origin)


def images(log: Path) -> Iterator[Image]:
    """Every image of a log, decoded, in order."""
    return decode(read_frames(log, LEARN_READ, ReadReport()))


def _shown(log: Path, seed: int) -> Iterator[Image]:
    """The images of a log as the detector is learned with them."""
    return through_other_cameras(images(log), seed)


def _shown_scenes(labelled: Sequence[LabelledImage], seed: int) -> Iterator[Image]:
    """Real images as the detector is learned with them."""
    return through_other_cameras(as_images(labelled), seed)


def _origin(drives: Sequence[TrainingDrive], scenes: Sequence[TrainingDrive], seed: int) -> str:
    """What was learned from, as `learned_from` finds it: each source with its number of images."""
    rendered = ", ".join(f"{d.name} ({d.frames} images, {len(d.faces)} faces)" for d in drives)
    real = ", ".join(f"{d.name} ({d.frames} images, {len(d.signs)} faces)" for d in scenes)
    if real:
        real = f"; real images, with copies of small sources and drawn faces, {real}"
    packages = ", ".join(f"{name} {_version(name)}" for name in ("numpy", "scikit-learn", "torch"))
    return f"rendered drives {rendered}{real}; seed {seed}; {packages}"


def _version(package: str) -> str:
    try:
        # without the name of the build, which says where the package came from
        return version(package).partition("+")[0]
    except PackageNotFoundError:
        return "absent"


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
        help="train the detection network up to so many steps instead (hours; can be interrupted and goes on "
        "from its checkpoint in the folder), and write network.onnx",
    )
    parser.add_argument(
        "--network-from",
        type=Path,
        metavar="NETWORK.onnx",
        help="begin that training with the weights of this network, not at random",
    )
    given = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    if given.network_steps is not None:
        # PyTorch and onnx are wanted by no other model here
        from wayside.pipeline.learning.detector_training import learn_network

        if given.real is None:
            parser.error("--network-steps wants --real")
        learn_network(
            given.drives,
            given.real,
            given.out,
            given.network_steps,
            given.seed,
            given.network_from,
        )
        return 0
    try:
        learn(given.drives, given.real, given.out, given.seed, lambda text: print(text, flush=True))
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
