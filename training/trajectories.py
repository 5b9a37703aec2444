"""How signs move in the image and other things do not, learned from the tracks of rendered drives (report chapter 5).

`python -m training.trajectories DRIVE.mcap... -o FOLDER` writes `trajectory.json` (the report's form) and
`trajectory_compensated.json` (without the camera's rotation). The same drives and versions give the same files.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.truth import OUT, KnownPanels, command, processes, read_truth, write_model
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.learning.labelled import NEITHER, OFF, ON
from wayside.pipeline.learning.thresholds import GATE_RATES, with_threshold
from wayside.pipeline.models.model_files import TRAJECTORY_FILES, load_models
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.pipeline.running.flow import Flow
from wayside.pipeline.workers import StageClock
from wayside.schemas.errors import InputError
from wayside.schemas.models import MixtureModel
from wayside.stages.report.trajectory import STEP_M, TRAJECTORY_FORMS, mean_log_ratio, trajectory_of

COMPONENTS = 4
"""Gaussians of each mixture: on drives held out in turn two or eight do not separate better."""

ASKED = ("sign", "trajectory", "duplicate")
"""Verdicts at the end on what reaches the trajectory gate, whose only later one is that of assembly."""

FOLDS = 5
"""Parts of the drives that are held out in turn."""

FEWEST = 40
"""Fewer tracks of signs, or fewer drives than folds, are no sample of how signs move."""


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
        Track(trajectory_of(*one.trace), known.label_in_images(one), drive)
        for frame in flow.track(read_frames(log, settings.read, ReadReport()))
        for one in frame.landmarks
        if one.verdict in ASKED
    ]


def learn_trajectories(tracks: Sequence[Track], form: str, provenance: str) -> MixtureModel:
    """The ratio of the densities of steps of signs and of other tracks, at the gate's false-alarm rate of whole tracks.

    The threshold and the operating points are from scores of drives held out in turn. Raises InputError where there are
    too few tracks of signs, of other things, or drives.
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
    scores = np.empty(len(sign))
    for held_out in (drive % FOLDS == part for part in range(FOLDS)):
        model = fitted([one for one, own in zip(tracks, held_out, strict=True) if not own], form)
        for row in np.flatnonzero(held_out):
            scores[row] = mean_log_ratio(tracks[row].steps, model)
    found = replace(fitted(tracks, form), provenance=provenance)
    return with_threshold(found, scores, sign, drive, GATE_RATES["trajectory"])


def steps_in_form(tracks: Sequence[Track], form: str) -> NDArray[np.float64]:
    """All steps (m, 4) of tracks in one form; those without numbers are left out."""
    values = np.concatenate([np.zeros((0, 2, 4)), *(one.steps for one in tracks)])
    values = values[:, TRAJECTORY_FORMS.index(form)]
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def fitted(tracks: Sequence[Track], form: str) -> MixtureModel:
    """Mixtures of Gaussians of the steps of signs and of the others, by expectation maximisation; it accepts all.

    The prior of a covariance is the covariance of all steps, split among the components (Fraley and Raftery 2007).
    """
    from sklearn.mixture import BayesianGaussianMixture  # only learning wants it

    fits = []
    for label in (ON, OFF):
        values = steps_in_form([one for one in tracks if one.label == label], form)
        d = values.shape[1]
        fits.append(
            BayesianGaussianMixture(
                n_components=COMPONENTS,
                covariance_prior=np.cov(values.T) / COMPONENTS ** (2 / d),
                degrees_of_freedom_prior=d + 2,
                mean_precision_prior=0.01,
                weight_concentration_prior_type="dirichlet_distribution",
                random_state=1,
                max_iter=1000,
            ).fit(values)
        )
    return MixtureModel(
        form,
        COMPONENTS,
        np.concatenate([one.weights_ for one in fits]),
        np.concatenate([one.means_ for one in fits]),
        np.concatenate([one.covariances_ for one in fits]),
        threshold=-np.inf,
        threshold_rule="",
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
