"""Fit every model that labels suffice for: colours, shapes, location, confidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.fitting.confidence import FittedConfidence, fit_confidence
from wayside.pipeline.fitting.landmarks import by_side, landmark_samples, run_drives
from wayside.pipeline.fitting.models import FittedModel, Task, fit_classes_of, fit_colors
from wayside.pipeline.fitting.regions import Gathered, color_samples, shape_samples
from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.learning.gaussians import PLACE_FLOOR, SHAPE_FLOOR
from wayside.pipeline.model_files import OWN_COLORS, REPORT_LOCATION, Models, load_models
from wayside.schemas.detections import SHAPES
from wayside.schemas.errors import InputError
from wayside.schemas.models import GaussianModel
from wayside.schemas.settings import Settings

COLOR, SHAPE, LOCATION, CONFIDENCE = "color", "shape", "location", "confidence"
FILES = {
    COLOR: OWN_COLORS,
    SHAPE: "shape.json",
    LOCATION: REPORT_LOCATION,
    CONFIDENCE: "place.json",
}
"""What can be fitted, in the order of the chain, and the file of its model."""
SIDES = ("right", "left", "overhead")
"""Classes of the location model."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one model.

    fitted: the model with its figures, None where there were too few samples; refusal: why the shipped model stays, ""
    where the fitted one is written; faces, met: labelled faces, and those with a region on them; None for landmarks.
    """

    what: str
    fitted: FittedModel | FittedConfidence | None
    refusal: str = ""
    faces: int | None = None
    met: int | None = None

    @property
    def written(self) -> bool:
        """Whether its file is."""
        return self.fitted is not None and not self.refusal


Notify = Callable[[str], None]


def fit_models(
    drives: Sequence[LabelledDrive],
    presets: Mapping[str, Settings],
    task: Task,
    wanted: Sequence[str],
    space: str | None,
    notify: Notify,
) -> list[Outcome]:
    """Fit the wanted models in the order of the chain; each is asked about what those before it accept.

    Parameters
    ----------
    drives
        Images with labels.
    presets
        Settings of `report-shape`, `report` and `default`.
    task, space
        As of `fit_colors`.
    wanted
        Of `FILES`.
    notify
        Called with what comes next.
    """
    report = presets["report"]
    models = load_models(report)
    outcomes: list[Outcome] = []
    few = task.settings.most_others
    if COLOR in wanted:
        notify("colours: segmenting the labelled images")
        gathered = color_samples(drives, report, few)
        found = _tried(COLOR, lambda: fit_colors(gathered.samples, _colors(models), task, space))
        outcomes.append(_with_faces(found, gathered))
        models = replace(models, color_classes=_chosen(outcomes[-1], _colors(models)))
    if SHAPE in wanted:
        notify("shapes: segmenting the labelled images")
        outlines = shape_samples(drives, report, few, _colors(models))
        shipped = load_models(presets["report-shape"]).shape_classes
        if shipped is None:
            raise ValueError("models: wanted the shape classes of preset report-shape, found none")

        def fit_shapes() -> FittedModel:
            return fit_classes_of(
                outlines.samples, SHAPES, "shape", _even_floor(SHAPE_FLOOR), shipped, task
            )

        outcomes.append(_with_faces(_tried(SHAPE, fit_shapes), outlines))
    if LOCATION in wanted:
        notify("location: running the logs with preset report")
        outcomes.append(_tried(LOCATION, lambda: _fit_location(drives, report, models, task)))
    if CONFIDENCE in wanted:
        notify("confidence: running the logs with preset default")
        default = presets["default"]
        outcomes.append(_tried(CONFIDENCE, lambda: _fit_confidence(drives, default, task)))
    return outcomes


def _fit_location(
    drives: Sequence[LabelledDrive], settings: Settings, models: Models, task: Task
) -> FittedModel:
    runs = run_drives(drives, settings, models)
    samples = by_side(landmark_samples(runs, LOCATION))

    def floor(mean: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(PLACE_FLOOR)

    return fit_classes_of(samples, SIDES, "side of the road", floor, models.location_classes, task)


def _fit_confidence(
    drives: Sequence[LabelledDrive], settings: Settings, task: Task
) -> FittedConfidence:
    models = load_models(settings)
    if models.landmark_classifier is None:
        raise InputError(
            "wanted a landmark classifier to calibrate, found none; install wayside again"
        )
    samples = landmark_samples(run_drives(drives, settings, models), "landmark")
    shipped = models.landmark_classifier
    return fit_confidence(samples, shipped, task.settings, task.provenance, task.alpha)


def _tried(what: str, fit: Callable[[], FittedModel | FittedConfidence]) -> Outcome:
    """The outcome of a fit: refused where it raises, or where the shipped model does better on what was held out."""
    try:
        fitted = fit()
    except InputError as error:
        return Outcome(what, None, str(error))
    if fitted.better:
        return Outcome(what, fitted)
    margin = " by a standard error" if isinstance(fitted, FittedModel) else ""
    return Outcome(
        what, fitted, f"on what was held out it is not better than the shipped one{margin}"
    )


def _with_faces(outcome: Outcome, gathered: Gathered) -> Outcome:
    return replace(outcome, faces=gathered.faces, met=gathered.met)


def _chosen(outcome: Outcome, shipped: GaussianModel) -> GaussianModel:
    if outcome.written and isinstance(outcome.fitted, FittedModel):
        return outcome.fitted.model
    return shipped


def _colors(models: Models) -> GaussianModel:
    if models.color_classes is None:
        raise ValueError("models: wanted those of preset report")
    return models.color_classes


def _even_floor(scatter: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    return lambda mean: np.full(len(mean), scatter)
