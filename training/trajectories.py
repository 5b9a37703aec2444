"""Densities of the motion of signs in the image, learned from the tracks of rendered drives (report chapter 5).

`python -m training.trajectories DRIVE.mcap... -o FOLDER` writes `trajectory.json` (the report's form)
and `trajectory_compensated.json` (without the camera's rotation). The same drives and package versions give the same
files.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from training.landmarks import NEITHER, SIGN, KnownPanels, label_in_images
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.writing import write_file
from wayside.pipeline.learning.curves import KNEE_RULE, Scores, roc_curve
from wayside.pipeline.learning.truth import read_truth
from wayside.pipeline.models.model_files import TRAJECTORY_FILES, load_models
from wayside.pipeline.models.model_json import model_to_json
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError, WaysideError
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.models import MixtureModel
from wayside.stages.classifiers import log_density
from wayside.stages.report import STEP_M, TRAJECTORY_FORMS, mean_log_density

MOST_COMPONENTS = 4
"""Mixtures of up to so many Gaussians are compared."""

ASKED = ("sign", "trajectory", "duplicate")
"""Verdicts at the end on what reaches the trajectory gate, whose only later one is that of assembly."""

FOLDS = 5
"""Parts of the drives that are held out in turn."""

FEWEST = 40
"""Fewer tracks of signs, or fewer drives than folds, are no sample of how signs move."""

LEAST_SIGMA = 5e-4
"""Smallest standard deviation of a component: the centre of a box is known to about a pixel."""

Notify = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Tracks:
    """Tracks that reach the trajectory classifier: steps (s, 2, 4) of each, label (n,) int8, drive (n,)."""

    steps: tuple[NDArray[np.float64], ...]
    label: NDArray[np.int8]
    drive: NDArray[np.int64]

    def of(self, rows: NDArray[np.bool_]) -> Tracks:
        """Those rows."""
        kept = tuple(one for one, own in zip(self.steps, rows, strict=True) if own)
        return Tracks(kept, self.label[rows], self.drive[rows])

    def in_form(self, form: str) -> NDArray[np.float64]:
        """All steps (m, 4) in one form; those that have no numbers are left out."""
        values = np.concatenate([np.zeros((0, 2, 4)), *self.steps])
        values = values[:, TRAJECTORY_FORMS.index(form)]
        return np.asarray(values[np.isfinite(values).all(axis=1)])

    def scores(self, model: MixtureModel) -> NDArray[np.float64]:
        """Mean log density of each track (n,)."""
        return np.array([mean_log_density(one, model) for one in self.steps])


def gather_tracks(log: Path, folder: str = "") -> Tracks:
    """Tracks of a rendered drive by the report's chain before its trajectory gate, labelled by its truth.

    folder: of the colour model, where it is not the one that ships.
    """
    truth = read_truth(log.with_suffix(".truth.json"))
    settings, _ = load_settings(
        "report-2d",
        None,
        ["report.trajectory=off"],
        {
            "read.spacing_m": float(truth.get("spacing_m", STEP_M)),
            "run.workers": 1,
            "models.folder": folder,
        },
    )
    flow = Flow(settings, load_models(settings), StageClock())
    return tracks_of(flow.track(read_frames(log, settings.read, ReadReport())), truth)


def tracks_of(frames: Iterable[TrackedFrame], truth: dict[str, Any]) -> Tracks:
    """Tracks of one drive that the trajectory gate is asked about: all that no stage before it refused."""
    known = KnownPanels.of(truth)
    asked = [one for frame in frames for one in frame.landmarks if one.verdict in ASKED]
    labels = np.array([label_in_images(one, known) for one in asked], np.int8)
    return Tracks(tuple(one.trajectory for one in asked), labels, np.zeros(len(asked), np.int64))


def joined(parts: Sequence[Tracks]) -> Tracks:
    """The tracks of several drives in one; drives are numbered by the order of the parts."""
    return Tracks(
        tuple(one for part in parts for one in part.steps),
        np.concatenate([part.label for part in parts]),
        np.repeat(np.arange(len(parts)), [len(part.label) for part in parts]),
    )


def learn_trajectories(tracks: Tracks, form: str, provenance: str) -> MixtureModel:
    """The density of the steps of signs, with the threshold at the knee of the ROC of whole tracks.

    The number of components has the highest likelihood on drives held out in turn. The threshold and its rates are from
    the same held-out scores.

    Raises
    ------
    InputError
        Where there are too few tracks of signs or drives.
    """
    tracks = tracks.of(tracks.label != NEITHER)
    sign, drives = tracks.label == SIGN, len(np.unique(tracks.drive))
    if sign.sum() < FEWEST or (~sign).sum() < FEWEST or drives < FOLDS:
        raise InputError(
            f"trajectory classifier: {FEWEST} tracks of signs, {FEWEST} others and {FOLDS} drives are needed. There "
            f"are {sign.sum()}, {(~sign).sum()} and {drives}. Add drives."
        )
    fold = tracks.drive % FOLDS
    best, most = 1, -np.inf
    for components in range(1, MOST_COMPONENTS + 1):
        held_out = 0.0
        for part in range(FOLDS):
            model = fitted(tracks.of(sign & (fold != part)).in_form(form), form, components)
            held_out += log_density(tracks.of(sign & (fold == part)).in_form(form), model).sum()
        if held_out > most:
            best, most = components, held_out
    scores = np.empty(len(sign))
    for part in range(FOLDS):
        model = fitted(tracks.of(sign & (fold != part)).in_form(form), form, best)
        scores[fold == part] = tracks.of(fold == part).scores(model)
    ones = np.ones(len(scores), np.int64)
    curve = roc_curve(Scores(scores, sign, ones, tracks.drive, accept_below=False))
    assert curve is not None  # there are tracks of both kinds
    threshold = float(curve.threshold[curve.knee])
    found, wrong = curve.tpr[curve.knee], curve.fpr[curve.knee]
    return replace(
        fitted(tracks.of(sign).in_form(form), form, best),
        threshold=threshold,
        threshold_rule=(
            f"{KNEE_RULE}; on drives held out in turn {found:.3f} of {sign.sum()} tracks of signs and {wrong:.3f} of "
            f"{(~sign).sum()} others"
        ),
        count=int(sign.sum()),
        provenance=provenance,
    )


def fitted(values: NDArray[np.float64], form: str, components: int) -> MixtureModel:
    """A mixture of Gaussians fitted to steps (n, 4) by expectation maximisation; it accepts everything."""
    from sklearn.mixture import GaussianMixture  # only learning wants it

    scale = values.std(axis=0)
    fit = GaussianMixture(components, reg_covar=1e-6, random_state=1, max_iter=300).fit(
        values / scale
    )
    floor = np.eye(values.shape[1]) * LEAST_SIGMA**2
    return MixtureModel(
        form,
        fit.weights_ / fit.weights_.sum(),
        fit.means_ * scale,
        fit.covariances_ * np.outer(scale, scale) + floor,
        threshold=-np.inf,
        threshold_rule="",
        count=0,
        provenance="",
    )


def learn(logs: Sequence[Path], folder: str, jobs: int, notify: Notify) -> dict[str, MixtureModel]:
    """Both densities, by the name of their file; raises InputError where a drive has no truth or there are too few.

    folder: as in `gather_tracks`; jobs: drives side by side.
    """
    with ProcessPoolExecutor(
        jobs, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
    ) as processes:
        parts = []
        found = processes.map(partial(gather_tracks, folder=folder), logs)
        for log, part in zip(logs, found, strict=True):
            parts.append(part)
            notify(f"{log.stem}: {len(part.label)} tracks, {(part.label == SIGN).sum()} of signs")
    tracks = joined(parts)
    counts = [(tracks.drive == k).sum() for k in range(len(logs))]
    listed = zip(logs, counts, strict=True)
    origin = "rendered drives " + ", ".join(f"{log.stem} ({n} tracks)" for log, n in listed)
    return {
        name: learn_trajectories(tracks, form, origin) for form, name in TRAJECTORY_FILES.items()
    }


def main(arguments: list[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m training.trajectories", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+", help="rendered drives with truth beside them")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the model files")
    parser.add_argument("--jobs", type=int, default=1, help="drives side by side")
    given = parser.parse_args(arguments)
    try:
        models = learn(sorted(given.logs), "", given.jobs, partial(print, flush=True))
        for name, model in models.items():
            write_file(given.out / name, model_to_json(model).encode(), overwrite=True)
            print(f"{name}: {len(model.weight)} components, {model.threshold_rule}")
    except WaysideError as error:
        print(f"wayside: {error}", file=sys.stderr)
        return error.exit_status
    return 0


if __name__ == "__main__":
    sys.exit(main())
