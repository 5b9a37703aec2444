"""`wayside fit`: fit every model for which the labels suffice, write the better ones, and report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np

from wayside import __version__
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.files.writing import not_written, refuse, write_file, write_json
from wayside.pipeline.fitting import models, report, samples
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.learning.fits import PLACE_FLOOR, SHAPE_FLOOR, SIDES
from wayside.pipeline.models.model_files import load_models
from wayside.pipeline.models.model_json import model_to_json
from wayside.schemas.detections import SHAPES
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.settings import Settings

_SAYING = (".xml", ".txt", ".yaml", ".json", ".csv")
FIGURES, PAGE = "fit.json", "fit.html"


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of the command.

    `labels`, `images`: files and folders as given. `read`: options of reading by their setting. `wanted`: which models.
    `alpha`: false-alarm rate. `space`: of the colours, `auto`: by cross-validation. `complete`: every labelled image
    shows no other sign. `only_labelled`: leave out classes of too few signs. `classes`: TOML file for foreign class
    names. `source`, `licence`: words for the model files.
    """

    labels: tuple[Path, ...]
    images: tuple[Path, ...]
    read: dict[str, object]
    wanted: tuple[str, ...]
    alpha: float | None
    space: str
    complete: bool
    only_labelled: bool
    classes: Path | None
    source: str
    licence: str


def fit_labels(
    options: FitOptions, out: Path, *, overwrite: bool, notify: Callable[[str], None]
) -> str:
    """Fit models by labels, write them into a folder, and give the report.

    Raises UsageError where there are several files of labels, but not one for each of the images. Raises InputError if
    labels or images cannot be used, or no model can be fitted. Raises OutputError if a file exists or is not writable.
    """
    if len(options.labels) not in (1, len(options.images)):
        raise UsageError(
            f"{len(options.labels)} files of labels are given. Give one, or one for each of the {len(options.images)} "
            "--images in their order."
        )
    for name in (*report.FILES.values(), FIGURES, PAGE):
        if (out / name).exists() and not overwrite:
            raise refuse(out / name, "an earlier model or other figures")
    presets = {
        name: load_settings(name, None, [], options.read)[0]
        for name in ("report-shape", "report", "default")
    }
    labels = [read_labels(path, options.classes) for path in options.labels]
    read = presets["report"].read
    drives = samples.labelled_drives(labels, options.images, read, complete=options.complete)
    task = models.Task(options.alpha, options.only_labelled, provenance(options, drives))
    faces = [drive.faces for drive in drives]
    few = {what: words for what in options.wanted if (words := models.too_few_labels(faces, what))}
    left = tuple(what for what in options.wanted if what not in few)
    outcomes = fit_models(drives, presets, task, replace(options, wanted=left), notify)
    outcomes += [report.Outcome(what, None, words) for what, words in few.items()]
    if not any(one.written for one in outcomes):
        lines = [line for one in outcomes for line in report.outcome_lines(one)]
        raise InputError("\n".join(["no model is written", *lines]))
    _write(out, outcomes, drives, task)
    return report.format_fit(outcomes, drives, out)


def provenance(options: FitOptions, drives: Sequence[samples.LabelledDrive]) -> str:
    """Words of a model file on the labels, the images and their licence."""
    files = ", ".join(
        f"{path.resolve().name} (SHA-256 {digest_of(path)})" for path in options.labels
    )
    images = ", ".join(
        f"{one.name} ({len(one.stretch)} labelled images, {one.boxes_of_signs})" for one in drives
    )
    return visible(
        f"labels {files} on {images}; source: {options.source or 'not stated'}; "
        f"licence: {options.licence or 'not stated'}; wayside fit {__version__}"
    )


def digest_of(path: Path) -> str:
    """SHA-256, hexadecimal, of a file, or of the names and contents of all files in a folder that say what is labelled.

    Of a result these are its review and `run.json`, which has the digests of its tables.
    """
    if path.is_file():
        return sha256(path.read_bytes()).hexdigest()
    digest = sha256()
    for file in sorted(one for one in path.rglob("*") if one.suffix in _SAYING):
        digest.update(file.relative_to(path).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def fit_models(
    drives: Sequence[samples.LabelledDrive],
    presets: Mapping[str, Settings],
    task: models.Task,
    options: FitOptions,
    notify: Callable[[str], None],
) -> list[report.Outcome]:
    """Fit those of `FILES` that are wanted, in the order of the chain; each is asked about what those before accept.

    `presets`: settings of `report-shape`, `report` and `default`. `notify`: is called with what comes next.
    """
    wanted, chain = options.wanted, presets["report"]
    own, default = load_models(chain), load_models(presets["default"])
    shapes = load_models(presets["report-shape"]).shape_classes
    colors, evidence = own.color_classes, default.landmark_classifier
    if colors is None or shapes is None or evidence is None:
        raise InputError("models that ship with wayside are missing. Install wayside again.")
    outcomes: list[report.Outcome] = []
    if report.COLOR in wanted:
        notify("colours: segmenting the labelled images")
        found = samples.region_samples(drives, chain)
        fit = partial(models.fit_colors, found.samples, colors, task, options.space)
        outcomes.append(_tried(report.COLOR, fit, found))
        fitted = outcomes[0].fitted
        if outcomes[0].written and isinstance(fitted, models.FittedModel):
            colors = fitted.model
    if report.SHAPE in wanted:
        notify("shapes: segmenting the labelled images")
        found = samples.region_samples(drives, chain, colors)
        floor = np.full(shapes.classes[0].mean.shape, SHAPE_FLOOR)
        asked = {shapes.space: (found.samples, lambda mean: floor)}
        known = found.samples, asked, SHAPES, report.SHAPE, shapes, task
        outcomes.append(_tried(report.SHAPE, partial(models.fit_gaussians, *known), found))
    if report.LOCATION in wanted:
        notify("location: running the logs with preset report")
        gates = replace(own, color_classes=colors)

        def fit_location() -> models.FittedModel:
            runs = samples.run_drives(drives, chain, gates)
            where = samples.by_side(samples.landmark_samples(runs, report.LOCATION))
            shipped = own.location_classes
            places = {shipped.space: (where, lambda mean: np.array(PLACE_FLOOR))}
            return models.fit_gaussians(where, places, SIDES, report.LOCATION, shipped, task)

        outcomes.append(_tried(report.LOCATION, fit_location))
    if report.CONFIDENCE in wanted:
        notify("confidence: running the logs with preset default")

        def fit_evidence() -> models.FittedConfidence:
            runs = samples.run_drives(drives, presets["default"], default)
            return models.fit_confidence(samples.landmark_samples(runs, "landmark"), evidence, task)

        outcomes.append(_tried(report.CONFIDENCE, fit_evidence))
    return outcomes


def _tried(
    what: str,
    fit: Callable[[], models.FittedModel | models.FittedConfidence],
    regions: samples.Gathered | None = None,
) -> report.Outcome:
    """The outcome of a fit: refused if it raises, or if the shipped model is better on held-out samples."""
    try:
        fitted = fit()
    except InputError as error:
        return report.Outcome(what, None, str(error), regions)
    margin = " by a standard error" if isinstance(fitted, models.FittedModel) else ""
    worse = f"on held-out labels it is not better than the shipped one{margin}"
    return report.Outcome(what, fitted, "" if fitted.better else worse, regions)


def _write(
    out: Path,
    outcomes: Sequence[report.Outcome],
    drives: Sequence[samples.LabelledDrive],
    task: models.Task,
) -> None:
    """Write models, figures and curves; remove earlier models, which have other figures."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in report.FILES.values():
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise not_written(out, error, "a model") from error
    for one in outcomes:
        if one.fitted is not None and one.written:
            text = model_to_json(one.fitted.model)
            write_file(out / report.FILES[one.what], text.encode(), overwrite=True)
    write_json(
        out / FIGURES, report.fit_json(outcomes, drives, task), report.FIT_KEYS, overwrite=True
    )
    write_file(out / PAGE, report.fit_page(outcomes, task.provenance).encode(), overwrite=True)
