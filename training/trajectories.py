"""Densities of the motion of signs in the image, learned from the tracks of rendered drives (report chapter 5).

`python -m training.trajectories DRIVE.mcap... -o FOLDER` writes `trajectory.json` (the report's form)
and `trajectory_compensated.json` (without the camera's rotation). The same drives and package versions give the same
files.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.truth import (
    OUT,
    KnownPanels,
    command,
    processes,
    read_truth,
    write_model,
)
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.labelled import NEITHER, ON
from wayside.pipeline.learning.thresholds import GATE_RATES, with_threshold
from wayside.pipeline.models.model_files import TRAJECTORY_FILES, load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError
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


class Track(NamedTuple):
    """A track that reaches the trajectory classifier."""

    steps: NDArray[np.float64]
    """(s, 2, 4): each step in both of `TRAJECTORY_FORMS`."""
    label: int
    """`ON`, `OFF` or `NEITHER`."""
    drive: int
    """Number of its drive."""


def gather_tracks(log: Path, drive: int) -> list[Track]:
    """Tracks of a rendered drive by the report's chain before its trajectory gate, labelled by its truth."""
    truth = read_truth(log)
    given = {"read.spacing_m": float(truth.get("spacing_m", STEP_M)), "run.workers": 1}
    settings, _ = load_settings("report-2d", None, ["report.trajectory=off"], given)
    flow = Flow(settings, load_models(settings), StageClock())
    known = KnownPanels.of(truth)
    return [
        Track(one.trajectory, known.label_in_images(one), drive)
        for frame in flow.track(read_frames(log, settings.read, ReadReport()))
        for one in frame.landmarks
        if one.verdict in ASKED
    ]


def learn_trajectories(tracks: Sequence[Track], form: str, provenance: str) -> MixtureModel:
    """The density of the steps of signs, with the threshold of the gate's false-alarm rate of whole tracks.

    The number of components has the highest likelihood on drives held out in turn. The threshold is from the same
    held-out scores. Raises InputError where there are too few tracks of signs or drives.
    """
    tracks = [one for one in tracks if one.label != NEITHER]
    sign = np.array([one.label == ON for one in tracks], np.bool_)
    drive = np.array([one.drive for one in tracks], np.int64)
    drives = len(np.unique(drive))
    if sign.sum() < FEWEST or (~sign).sum() < FEWEST or drives < FOLDS:
        raise InputError(
            f"trajectory classifier: {FEWEST} tracks of signs, {FEWEST} others and {FOLDS} drives are needed. There "
            f"are {sign.sum()}, {(~sign).sum()} and {drives}. Add drives."
        )

    def steps(rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        """All steps (m, 4) of some tracks."""
        return steps_in_form([tracks[row] for row in np.flatnonzero(rows)], form)

    def folds(components: int) -> Iterator[tuple[NDArray[np.bool_], MixtureModel]]:
        """The tracks (n,) of each fold, with a model of the signs of the others."""
        for held_out in (drive % FOLDS == part for part in range(FOLDS)):
            yield held_out, fitted(steps(sign & ~held_out), form, components)

    def likelihood(components: int) -> float:
        return sum(float(log_density(steps(sign & own), m).sum()) for own, m in folds(components))

    best = max(range(1, MOST_COMPONENTS + 1), key=likelihood)
    scores = np.empty(len(sign))
    for own, model in folds(best):
        scores[own] = [mean_log_density(tracks[row].steps, model) for row in np.flatnonzero(own)]
    found = replace(fitted(steps(sign), form, best), count=int(sign.sum()), provenance=provenance)
    return with_threshold(found, scores, sign, drive, GATE_RATES["trajectory"])


def steps_in_form(tracks: Sequence[Track], form: str) -> NDArray[np.float64]:
    """All steps (m, 4) of tracks in one form; those without numbers are left out."""
    values = np.concatenate([np.zeros((0, 2, 4)), *(one.steps for one in tracks)])
    values = values[:, TRAJECTORY_FORMS.index(form)]
    return np.asarray(values[np.isfinite(values).all(axis=1)])


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


def learn(logs: Sequence[Path], out: Path, jobs: int) -> None:
    """Write both densities into a folder; `jobs`: drives side by side.

    Raises InputError if a drive has no truth, or there are too few; OutputError if a file cannot be written.
    """
    logs = sorted(logs)
    with processes(jobs) as pool:
        found = list(pool.map(gather_tracks, logs, range(len(logs))))
    tracks = [one for own in found for one in own]
    listed = ", ".join(
        f"{log.stem} ({len(own)} tracks)" for log, own in zip(logs, found, strict=True)
    )
    for form, name in TRAJECTORY_FILES.items():
        model = learn_trajectories(tracks, form, f"rendered drives {listed}")
        write_model(out / name, model)
        print(f"{name}: {len(model.weight)} components, {model.threshold_rule}")


main = command(
    __doc__,
    learn,
    logs=("logs", {"type": Path, "nargs": "+", "help": "rendered drives with truth beside them"}),
    out=OUT,
    jobs=("--jobs", {"type": int, "default": 1, "help": "drives side by side"}),
)

if __name__ == "__main__":
    sys.exit(main())
