"""Recall on real images by classifiers not trained on their source, and the step that loses each missed face.

    OMP_NUM_THREADS=1 .venv/bin/python benchmarks/scenes.py [--real FOLDER] [--drives FOLDER] [--every N]

The classifiers are learned again as `make learn` does it, in two groups, from every fourth rendered learning drive and
the sources of the scenes; then the images of each source go through the stages of a run with the classifier of the
group that it is not in, and with a ranking and a pre-filter learned from the drives alone. Writes
benchmarks/scenes.md and prints every face that was not seen and every false box. The scenes are not part of
the repository: without them it says so
and ends with status 2. Wants what `make learn` installs.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from reached import (
    CANDIDATE,
    CLASSIFIED,
    KEPT,
    PASSED,
    STOPPED,
    bin_names,
    bin_of,
    reached,
    shares,
    table,
)

from wayside.pipeline.flow import Flow
from wayside.pipeline.learn import gather, learning_logs
from wayside.pipeline.learning.detector import learn_detector
from wayside.pipeline.learning.prefilter import learn_prefilter, learn_ranking
from wayside.pipeline.learning.samples import NEAR_FACE
from wayside.pipeline.learning.scenes import read_scenes, scene_images, scene_sources
from wayside.pipeline.model_files import load_models
from wayside.pipeline.settings_file import load_settings
from wayside.pipeline.workers import StageClock
from wayside.schemas.detections import COLORS, VERDICTS, Candidates
from wayside.schemas.errors import WaysideError
from wayside.schemas.frame import Frame
from wayside.schemas.models import NetworkModel, TreeModel
from wayside.stages.geometry import iou_matrix

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "benchmarks" / "scenes.md"
SEED = 1
SMALLEST_PX = 10.0
"""Lower faces are not counted."""
HEIGHTS = (10, 15, 20, 25, 35, 50, 100)
STAGES = (CANDIDATE, CLASSIFIED, PASSED, KEPT)
HEAD = ("faces", "candidate", "passed pre-filter", "passed classifier", "detected")


@dataclass(frozen=True, slots=True)
class SceneModels:
    """Models applied to one image: ranking, box classifier with its pre-filter, box regression."""

    ranking: TreeModel
    box_classifier: TreeModel
    face_box: NetworkModel


@dataclass(frozen=True, slots=True)
class FaceOutcome:
    """One labelled face: how far its candidates went, and the best score on it above the threshold (nan: none)."""

    source: str
    file: str
    box: tuple[float, ...]
    color: str
    level: int
    score: float

    @property
    def height_px(self) -> float:
        """Height of the face."""
        return self.box[3] - self.box[1]


@dataclass(frozen=True, slots=True)
class Source:
    """The images of one source: faces, images in which all faces are labelled, and false boxes in those."""

    name: str
    images: int
    faces: tuple[FaceOutcome, ...]
    complete: int
    false: tuple[tuple[str, tuple[float, ...], float], ...]


def main() -> int:
    """Learn, detect, write the page, print what was not seen."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--real", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    parser.add_argument("--drives", type=Path, default=ROOT / ".cache" / "drives")
    parser.add_argument("--every", type=int, default=4, help="learn from every n-th drive only")
    args = parser.parse_args()
    if not (args.real / "scenes" / "scenes.json").is_file():
        print(f"no scenes/scenes.json in {args.real}: they are not part of the repository; --real")
        return 2
    cv2.setNumThreads(1)
    try:
        sources, provenance = measured(args.real, learning_logs(args.drives)[:: args.every])
    except WaysideError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    PAGE.write_text(page(sources, provenance))
    for line in missed_lines(sources):
        print(line)
    say("written")
    return 0


def say(text: str) -> None:
    """Print with the processor time so far."""
    print(f"{time.process_time():7.0f} s  {text}", flush=True)


def measured(real: Path, logs: Sequence[Path]) -> tuple[list[Source], str]:
    """Every source, with what models find that have not seen it; and how they were learned, in words."""
    settings, _ = load_settings()
    samples = gather(logs, real, settings, SEED, say)
    detectors = learn_detector(
        samples.drives,
        samples.features_of,
        samples.patches_of,
        SEED,
        "",
        settings.candidates,
        samples.scenes,
    ).out_of_fold
    ranking = learn_ranking(samples.drives, (), SEED, "", settings.candidates.most)
    _, gate = learn_prefilter(samples.drives, SEED, "")
    found = []
    for source, listed in scene_sources(read_scenes(real)).items():
        classifier, face_box = detectors[source]
        by = SceneModels(ranking, replace(classifier, prefilter=gate), face_box)
        found.append(source_of(source, real, listed, by))
        say(f"measured the {len(listed)} images of {source}")
    images = sum(drive.frames for drive in samples.drives)
    return found, f"{len(samples.drives)} rendered drives ({images} images)"


def source_of(source: str, real: Path, scenes: list[dict[str, Any]], by: SceneModels) -> Source:
    """How far the candidates on the faces of a source go, and the boxes left on no face where all are known."""
    faces: list[FaceOutcome] = []
    false: list[tuple[str, tuple[float, ...], float]] = []
    for scene, own in zip(scenes, candidates_of(real, scenes, by), strict=True):
        verdicts = names_of(own)
        for sign in scene["signs"]:
            box = tuple(float(v) for v in sign["box"])
            if box[3] - box[1] < SMALLEST_PX:
                continue
            level = reached(box, own.regions.box, verdicts)
            score = best_score(box, own) - by.box_classifier.threshold
            faces.append(FaceOutcome(source, scene["file"], box, sign["color"], level, score))
        if scene["complete"]:
            known = np.array([sign["box"] for sign in scene["signs"]], np.float64).reshape(-1, 4)
            false += [
                (
                    scene["file"],
                    tuple(own.regions.box[row].tolist()),
                    own.score[row] - by.box_classifier.threshold,
                )
                for row in strays(own, known)
            ]
    complete = sum(bool(scene["complete"]) for scene in scenes)
    return Source(source, len(scenes), tuple(faces), complete, tuple(false))


def candidates_of(
    real: Path, scenes: list[dict[str, Any]], by: SceneModels
) -> Iterator[Candidates]:
    """The candidates of each image after all stages that need a single image."""
    settings, _ = load_settings("default")
    models = replace(
        load_models(settings),
        region_ranking=by.ranking,
        box_classifier=by.box_classifier,
        box_regressor=by.face_box,
    )
    flow = Flow(settings, models, StageClock())
    return (one.candidates for one in flow.detect(scene_frames(real, scenes)))


def scene_frames(real: Path, scenes: list[dict[str, Any]]) -> Iterator[Frame]:
    """The images as they are stored, as frames of a log."""
    for scene, image in zip(scenes, scene_images(real, scenes), strict=True):
        yield replace(image.frame, data=(real / "scenes" / scene["file"]).read_bytes())


def names_of(candidates: Candidates) -> NDArray[np.str_]:
    """The verdict on each candidate, by name."""
    return np.array(VERDICTS)[candidates.verdict]


def best_score(box: tuple[float, ...], candidates: Candidates) -> float:
    """Best score of the candidates on a face; nan where none was classified."""
    on = iou_matrix(np.array([box]), candidates.regions.box)[0] >= 0.5
    scores = candidates.score[on & np.isfinite(candidates.score)]
    return float(scores.max()) if len(scores) else float("nan")


def strays(candidates: Candidates, known: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows that the classifier kept on no known face (m, 4); what overlaps one by some counts as neither."""
    kept = candidates.open_rows()
    if len(known) == 0 or len(kept) == 0:
        return kept
    near = iou_matrix(candidates.regions.box[kept], known).max(axis=1) >= NEAR_FACE
    return np.asarray(kept[~near])


def page(sources: Sequence[Source], learned: str) -> str:
    """The page: by source, by colour, by height."""
    faces = [face for source in sources for face in source.faces]
    images, complete = sum(s.images for s in sources), sum(s.complete for s in sources)
    lines = [
        "# Recall on single real images",
        "",
        "Made by `python benchmarks/scenes.py` where the scenes are available; they are not part of the repository.",
        f"{images} single images with hand-made boxes, {len(faces)} faces at least {SMALLEST_PX:g} px tall. Each",
        "source is evaluated with a classifier learned as `make learn` does it, in two groups with every other source",
        "and",
        f"every other of {learned}: the one of the group that it is not in. Ranking and pre-filter",
        "are learned from these drives alone.",
        "In brackets the 95 % interval (Wilson's score; exact for none and all) as if faces were independent; many",
        "images show one place and the sources are few, so the truth is wider.",
        "",
        "*candidate*: a box on the face (IoU .5); *passed pre-filter*, *passed classifier*: one above the threshold of",
        "that model; *detected*: one that survives non-maximum suppression and goes on to tracking. *False*: boxes",
        f"kept that overlap no face, in those images in which all faces are labelled ({complete} of {images}); distant",
        "unlabelled signs may be",
        "among them.",
        "",
        "## By source",
        "",
        *table(
            ("source", "images", *HEAD, "false per image", "in images"),
            [source_row(source) for source in sources],
        ),
        "",
        "## By colour of the face",
        "",
        *table(("colour", *HEAD), groups(faces, COLORS, lambda f: f.color)),
        "",
        "## By height of the face",
        "",
        *table(
            ("height", *HEAD),
            groups(
                faces,
                bin_names(HEIGHTS, "px"),
                lambda f: bin_names(HEIGHTS, "px")[bin_of(f.height_px, HEIGHTS)],
            ),
        ),
    ]
    return "\n".join(lines) + "\n"


def source_row(source: Source) -> list[str]:
    """One line of the first table."""
    rate = f"{len(source.false) / source.complete:.1f}" if source.complete else "-"
    cells = shares((f.level for f in source.faces), STAGES, sure=True)
    return [source.name, str(source.images), *cells, rate, str(source.complete)]


def groups(
    faces: Sequence[FaceOutcome], names: Sequence[str], name_of: Callable[[FaceOutcome], str]
) -> Iterator[list[str]]:
    """One line a group that has faces, and one for all."""
    for name in (*names, "**all**"):
        own = [face for face in faces if name in (name_of(face), "**all**")]
        if own:
            yield [name.replace("_", " "), *shares((f.level for f in own), STAGES, sure=True)]


def missed_lines(sources: Sequence[Source]) -> Iterator[str]:
    """Every face that was not seen, with where it stopped, and every false box."""
    for face in (f for source in sources for f in source.faces if f.level < KEPT):
        box = ",".join(f"{v:.0f}" for v in face.box)
        yield f"missed  {face.file}  {box}  {face.color}  {STOPPED[face.level]}  {face.score:+.1f}"
    for file, corners, score in (one for source in sources for one in source.false):
        box = ",".join(f"{v:.0f}" for v in corners)
        yield f"false   {file}  {box}  {score:+.1f}"


if __name__ == "__main__":
    sys.exit(main())
