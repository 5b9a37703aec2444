"""What `wayside fit` does: read labels, fit models, write them with what they rest on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from wayside import __version__
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.files.visible_text import visible
from wayside.pipeline.files.writing import not_written, refuse, write_file, write_json
from wayside.pipeline.fitting.fit import FILES, Outcome, fit_models
from wayside.pipeline.fitting.models import Task
from wayside.pipeline.fitting.report import FIT_KEYS, fit_json, fit_page, format_fit, outcome_lines
from wayside.pipeline.fitting.sources import LabelledDrive, labelled_drives
from wayside.pipeline.labels.read import read_labels
from wayside.pipeline.models.model_json import model_to_json
from wayside.schemas.errors import InputError, UsageError

_SAYING = (".xml", ".txt", ".yaml", ".json", ".csv")
FIGURES, PAGE = "fit.json", "fit.html"


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of the command.

    `labels`, `images`: files and folders as given. `classes`: TOML file for foreign class names. `read`: options of
    reading by their setting. `wanted`: which models. `alpha`: false-alarm rate. `space`: of the colours, None: by
    cross-validation. `complete`: every labelled image shows no other sign. `only_labelled`: leave out classes of too
    few signs. `source`, `licence`: words for the model files.
    """

    labels: tuple[Path, ...]
    images: tuple[Path, ...]
    classes: Path | None
    read: dict[str, object]
    wanted: tuple[str, ...]
    alpha: float | None
    space: str | None
    complete: bool
    only_labelled: bool
    source: str
    licence: str


def fit_labels(
    options: FitOptions, out: Path, *, overwrite: bool, notify: Callable[[str], None]
) -> str:
    """Fit models by labels, write them into a folder, and give the report.

    Raises
    ------
    UsageError
        There are several files of labels, but not one for each of the images.
    InputError
        Labels or images cannot be used, or not one model can be fitted.
    OutputError
        A file cannot be written, or stands there already.
    """
    if len(options.labels) not in (1, len(options.images)):
        raise UsageError(
            f"{len(options.labels)} files of labels are given. Give one, or one for each of the {len(options.images)} "
            "--images in their order."
        )
    _require_free(out, overwrite=overwrite)
    presets = {
        name: load_settings(name, None, [], options.read)[0]
        for name in ("report-shape", "report", "default")
    }
    labels = [read_labels(path, options.classes) for path in options.labels]
    read = presets["report"].read
    drives = labelled_drives(labels, options.images, read, complete=options.complete)
    origin = provenance(options, drives)
    task = Task(options.alpha, options.only_labelled, origin)
    outcomes = fit_models(drives, presets, task, options.wanted, options.space, notify)
    if not any(one.written for one in outcomes):
        lines = [line for one in outcomes for line in outcome_lines(one)]
        raise InputError("\n".join(["no model is written", *lines]))
    _write(out, outcomes, drives, origin, options.alpha)
    return format_fit(outcomes, drives, out)


def provenance(options: FitOptions, drives: Sequence[LabelledDrive]) -> str:
    """What a model file says of the labels, the images and their licence."""
    files = ", ".join(
        f"{path.resolve().name} (SHA-256 {digest_of(path)})" for path in options.labels
    )
    images = ", ".join(
        f"{one.name} ({len(one.stretch)} labelled images, {len(one.faces.sign)} boxes of "
        f"{len(set(one.faces.sign.tolist()))} signs)"
        for one in drives
    )
    said = [f"labels {files} on {images}"]
    said.append(f"source: {options.source or 'not stated'}")
    said.append(f"licence: {options.licence or 'not stated'}")
    return visible("; ".join([*said, f"wayside fit {__version__}"]))


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


def _require_free(out: Path, *, overwrite: bool) -> None:
    for name in (*FILES.values(), FIGURES, PAGE):
        if (out / name).exists() and not overwrite:
            raise refuse(out / name, "an earlier model or other figures")


def _write(
    out: Path,
    outcomes: Sequence[Outcome],
    drives: Sequence[LabelledDrive],
    origin: str,
    alpha: float | None,
) -> None:
    """Write models, figures and curves; remove earlier models, which have other figures."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in FILES.values():
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise not_written(out, error, "a model") from error
    for one in outcomes:
        if one.fitted is not None and one.written:
            text = model_to_json(one.fitted.model)
            write_file(out / FILES[one.what], text.encode(), overwrite=True)
    write_json(out / FIGURES, fit_json(outcomes, drives, origin, alpha), FIT_KEYS, overwrite=True)
    write_file(out / PAGE, fit_page(outcomes, origin).encode(), overwrite=True)
