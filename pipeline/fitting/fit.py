"""Fit every model that labels suffice for: colours, shapes, location, confidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wayside.pipeline.fitting.gathering import (
    Gathered,
    by_side,
    landmark_samples,
    region_samples,
    run_drives,
)
from wayside.pipeline.fitting.models import (
    FittedConfidence,
    FittedModel,
    Task,
    fit_colors,
    fit_confidence,
    fit_gaussians,
)
from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.learning.gaussians import PLACE_FLOOR, SHAPE_FLOOR, SIDES, Samples
from wayside.pipeline.models.model_files import OWN_COLORS, REPORT_LOCATION, Models, load_models
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


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one model.

    `fitted`: the model with its figures, None with too few samples. `refusal`: why the shipped model stays, else "".
    `faces`, `met`: labelled faces, and those with a region on them; None for landmarks.
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


def fit_models(
    drives: Sequence[LabelledDrive],
    presets: Mapping[str, Settings],
    task: Task,
    wanted: Sequence[str],
    space: str | None,
    notify: Callable[[str], None],
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
    models, default = load_models(report), load_models(presets["default"])
    shapes = load_models(presets["report-shape"]).shape_classes
    colors, evidence = models.color_classes, default.landmark_classifier
    if colors is None or shapes is None or evidence is None:
        raise InputError("models that ship with wayside are missing. Install wayside again.")
    outcomes: list[Outcome] = []
    if COLOR in wanted:
        notify("colours: segmenting the labelled images")
        found = region_samples(drives, report)
        fit = partial(fit_colors, found.samples, colors, task, space)
        outcomes.append(_tried(COLOR, fit, found))
        fitted = outcomes[-1].fitted
        if outcomes[-1].written and isinstance(fitted, FittedModel):
            colors = fitted.model
            models = replace(models, color_classes=colors)
    if SHAPE in wanted:
        notify("shapes: segmenting the labelled images")
        found = region_samples(drives, report, colors)
        floor = np.full(shapes.classes[0].mean.shape, SHAPE_FLOOR)
        fit = partial(_fit_one_space, found.samples, floor, SHAPES, "shape", shapes, task)
        outcomes.append(_tried(SHAPE, fit, found))
    if LOCATION in wanted:
        notify("location: running the logs with preset report")
        outcomes.append(_tried(LOCATION, partial(_fit_location, drives, report, models, task)))
    if CONFIDENCE in wanted:
        notify("confidence: running the logs with preset default")

        def fit_evidence() -> FittedConfidence:
            runs = run_drives(drives, presets["default"], default)
            return fit_confidence(landmark_samples(runs, "landmark"), evidence, task)

        outcomes.append(_tried(CONFIDENCE, fit_evidence))
    return outcomes


def _fit_location(
    drives: Sequence[LabelledDrive], settings: Settings, models: Models, task: Task
) -> FittedModel:
    samples = by_side(landmark_samples(run_drives(drives, settings, models), LOCATION))
    floor, shipped = np.array(PLACE_FLOOR), models.location_classes
    return _fit_one_space(samples, floor, SIDES, "side of the road", shipped, task)


def _fit_one_space(
    samples: Samples,
    floor: np.ndarray,
    known: tuple[str, ...],
    what: str,
    shipped: GaussianModel,
    task: Task,
) -> FittedModel:
    spaces = {shipped.space: (samples, lambda mean: floor)}
    return fit_gaussians(samples, spaces, known, what, shipped, task)


def _tried(
    what: str, fit: Callable[[], FittedModel | FittedConfidence], gathered: Gathered | None = None
) -> Outcome:
    """The outcome of a fit: refused where it raises, or where the shipped model does better on what was held out."""
    faces, met = (None, None) if gathered is None else (gathered.faces, gathered.met)
    try:
        fitted = fit()
    except InputError as error:
        return Outcome(what, None, str(error), faces, met)
    margin = " by a standard error" if isinstance(fitted, FittedModel) else ""
    worse = f"on what was held out it is not better than the shipped one{margin}"
    return Outcome(what, fitted, "" if fitted.better else worse, faces, met)
