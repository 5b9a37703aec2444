"""`wayside roc`: gather what the classifiers are asked on some drives, and write their curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from wayside.pipeline.input_files import read_parquet
from wayside.pipeline.labels import joined, read_labels
from wayside.pipeline.model_files import Models
from wayside.pipeline.output_folder import OutputFolder
from wayside.pipeline.parquet import ParquetFile, record_batch
from wayside.pipeline.roc.classifier_samples import ClassifierSamples, join_drives
from wayside.pipeline.roc.curves import RocCurve, roc_curve
from wayside.pipeline.roc.pictures import draw_curves, png
from wayside.pipeline.roc.questions import Question, confusion, questions
from wayside.pipeline.roc.recording import record_curves
from wayside.pipeline.roc.samples import gather_samples
from wayside.pipeline.writing import create, not_written, refuse
from wayside.schemas.errors import InputError
from wayside.schemas.roc import CLASSIFIERS, CONFUSION, CURVES
from wayside.schemas.settings import Settings
from wayside.schemas.tables import Table

RECORDING_FILE = "roc.rrd"

Notify = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Characteristics:
    """What was measured: the samples by classifier, and each test of them with its curve (None: it has none)."""

    samples: Mapping[str, ClassifierSamples]
    curves: Sequence[tuple[Question, RocCurve | None]]

    def drawn(self) -> dict[str, list[tuple[Question, RocCurve]]]:
        """The tests that have a curve, by classifier."""
        found: dict[str, list[tuple[Question, RocCurve]]] = {}
        for question, curve in self.curves:
            if curve is not None:
                found.setdefault(question.classifier, []).append((question, curve))
        return found


def characteristics(
    samples: Mapping[str, ClassifierSamples], settings: Settings, models: Models
) -> Characteristics:
    """The curves of all classifiers that were asked."""
    return Characteristics(
        samples, [(one, roc_curve(one.scores)) for one in questions(samples, settings, models)]
    )


def measure_roc(
    logs: Sequence[Path],
    labels: Sequence[Path],
    folder: Path,
    settings: Settings,
    models: Models,
    notify: Notify,
    *,
    overwrite: bool = False,
) -> Characteristics:
    """Run the logs, and write the curves of their classifiers into `folder`.

    Parameters
    ----------
    logs
        Drives with labels.
    labels
        Files or folders of labels, of any format; each log takes those of its images.
    folder
        Output: `roc.parquet`, `classifiers.parquet`, `confusion.parquet`, `roc.rrd` and a picture a classifier.
    settings, models
        What the runs work with.
    notify
        Called with a line about each log.
    overwrite
        Replace whatever stands there under these names; else only those of an earlier measurement.

    Raises
    ------
    InputError
        A log or labels cannot be used, or the labels show no sign that a classifier was asked about.
    OutputError
        The folder cannot be written.
    """
    if not overwrite:
        _check_free(folder)
    every = joined([read_labels(path) for path in labels])
    drives = []
    for log in logs:
        drives.append(gather_samples(log, every, settings, models))
        counted = ", ".join(f"{name} {int(s.count.sum())}" for name, s in drives[-1].items())
        notify(f"{log.name}: asked {counted}")
    measured = characteristics(join_drives(drives), settings, models)
    if not measured.drawn():
        raise InputError(
            "roc: wanted signs and other things that a classifier was asked about, found no classifier with both; "
            "label more signs, or more images completely"
        )
    _write(folder, measured)
    return measured


def format_characteristics(measured: Characteristics) -> str:
    """All figures as a Markdown table."""
    lines = [
        "| classifier | class | signs | others | area | threshold | TPR | FPR | knee | TPR | FPR |",
        "| --- | --- | ---: | ---: | --- | ---: | --- | --- | ---: | ---: | ---: |",
    ]
    for question, curve in measured.curves:
        row = _summary(question, curve)
        words = [question.classifier, question.name, str(row["positives"]), str(row["negatives"])]
        if curve is None:
            lines.append(f"| {' | '.join([*words, *['-'] * 7])} |")
            continue
        words += [
            f"{row['area']:.3f}{_ends(row['area_low'], row['area_high'], 1, '.3f')}",
            "-" if row["threshold"] is None else f"{question.threshold:.4g}",
            *(
                "-"
                if row[rate] is None
                else f"{100 * row[rate]:.3g} %{_ends(row[f'{rate}_low'], row[f'{rate}_high'], 100, '.3g')}"
                for rate in ("tpr", "fpr")
            ),
            f"{row['knee']:.4g}",
            *(f"{100 * row[rate]:.3g} %" for rate in ("knee_tpr", "knee_fpr")),
        ]
        lines.append(f"| {' | '.join(words)} |")
    return "\n".join(lines)


def _ends(low: float | None, high: float | None, factor: float, form: str) -> str:
    return (
        "" if low is None or high is None else f" ({factor * low:{form}} to {factor * high:{form}})"
    )


def _write(folder: Path, measured: Characteristics) -> None:
    drawn = measured.drawn()
    with OutputFolder(folder) as output:
        try:
            _write_table(output.part, CURVES, _curve_rows(measured))
            _write_table(
                output.part,
                CLASSIFIERS,
                [_summary(question, curve) for question, curve in measured.curves],
            )
            rows = [
                {"classifier": name, "labelled": labelled, "given": given, "count": count}
                for name, samples in measured.samples.items()
                for (labelled, given), count in confusion(samples).items()
            ]
            _write_table(output.part, CONFUSION, rows)
            for name, curves in drawn.items():
                with create(output.part / f"roc_{name}.png") as stream:
                    stream.write(png(draw_curves(name, curves)))
        except OSError as error:
            raise not_written(folder, error) from error
        record_curves(output.part / RECORDING_FILE, drawn, format_characteristics(measured))
        output.commit(_pictures_of_before(folder))


def _curve_rows(measured: Characteristics) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for question, curve in measured.curves:
        if curve is None:
            continue
        for k in range(len(curve.threshold)):
            rows.append(
                {
                    "classifier": question.classifier,
                    "class": question.name,
                    "threshold": float(curve.threshold[k]),
                    "tp": int(curve.tp[k]),
                    "fp": int(curve.fp[k]),
                    "tpr": float(curve.tpr[k]),
                    "fpr": float(curve.fpr[k]),
                    **_band(curve, k),
                }
            )
    return rows


def _summary(question: Question, curve: RocCurve | None) -> dict[str, Any]:
    scores = question.scores
    row: dict[str, Any] = dict.fromkeys(column.name for column in CLASSIFIERS.columns)
    row |= {
        "classifier": question.classifier,
        "class": question.name,
        "unit": question.unit,
        "positives": int(scores.count[scores.on].sum()),
        "negatives": int(scores.count[~scores.on].sum()),
        "threshold": question.threshold if math.isfinite(question.threshold) else None,
        "resampled": question.resampled,
        "groups": 0,
    }
    if curve is None:
        return row
    full = int((curve.tp < curve.positives).sum())
    row |= {
        "area": curve.area,
        "knee": float(curve.threshold[curve.knee]),
        "knee_tpr": float(curve.tpr[curve.knee]),
        "knee_fpr": float(curve.fpr[curve.knee]),
        "full_tpr_fpr": float(curve.fpr[full]) if full < len(curve.tp) else None,
        "groups": curve.groups,
    }
    if (at := question.used_row(curve)) is not None:
        row |= {"tpr": float(curve.tpr[at]), "fpr": float(curve.fpr[at]), **_band(curve, at)}
    for name, interval in (("area", curve.area_interval), ("knee", curve.knee_interval)):
        if interval is not None:
            row |= {f"{name}_low": interval.low, f"{name}_high": interval.high}
    return row


def _band(curve: RocCurve, row: int) -> dict[str, float | None]:
    """Columns of the bands at a row of the curve."""
    columns: dict[str, float | None] = {}
    for name, band in (("tpr", curve.tpr_band), ("fpr", curve.fpr_band)):
        for end, side in enumerate(("low", "high")):
            columns[f"{name}_{side}"] = None if band is None else float(band[row, end])
    return columns


def _write_table(folder: Path, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    values = {column.name: [row[column.name] for row in rows] for column in table.columns}
    with ParquetFile(folder / table.file, table.schema) as file:
        file.write([record_batch(table, values)])


def _pictures_of_before(folder: Path) -> list[str]:
    """Pictures of the classifiers of an earlier measurement that is there: those of others go away with it."""
    try:
        rows = read_parquet(folder / CLASSIFIERS.file, ["classifier"]).to_pylist()
    except (OSError, ValueError, pa.ArrowException):
        return []
    names = {f"roc_{row['classifier']}.png" for row in rows}
    return sorted(name for name in names if Path(name).name == name)  # no file elsewhere


def _check_free(folder: Path) -> None:
    """Make sure that what is replaced is an earlier measurement."""
    present = [
        folder / name
        for name in (CURVES.file, CLASSIFIERS.file, CONFUSION.file, RECORDING_FILE)
        if (folder / name).exists()
    ]
    if present:
        try:
            own = pq.read_schema(folder / CURVES.file).equals(CURVES.schema, check_metadata=True)
        except (OSError, ValueError):
            own = False
        if not own:
            raise refuse(present[0], "a file there that is no earlier measurement")
