"""`wayside roc`: gather the inputs of the classifiers on some drives, and write their curves."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from wayside.pipeline.files.output_folder import OutputFolder
from wayside.pipeline.files.parquet import parquet_file, record_batch
from wayside.pipeline.files.writing import create, not_written, refuse
from wayside.pipeline.labels.read import joined, read_labels
from wayside.pipeline.learning import page
from wayside.pipeline.learning.asked import CLASSIFIERS as EVERY_CLASSIFIER
from wayside.pipeline.learning.asked import (
    ClassifierSamples,
    faces_of_log,
    gather_samples,
    join_drives,
)
from wayside.pipeline.learning.curves import ALL, RocCurve, roc_curves
from wayside.pipeline.models.model_files import Models
from wayside.pipeline.results.result import holds_table

# before rerun itself: it says what to install where that is absent
from wayside.pipeline.view.entities import APPLICATION
from wayside.schemas.detections import COLOR_RGB
from wayside.schemas.errors import InputError
from wayside.schemas.roc import CLASSIFIERS, CONFUSION, CURVES
from wayside.schemas.settings import Settings
from wayside.schemas.tables import Table

RECORDING_FILE = "roc.rrd"
KEY = "dot: threshold of the run; ring: knee;\ngrey: 95 % band of the first curve"

Notify = Callable[[str], None]


def measure_roc(
    logs: Sequence[Path],
    labels: Sequence[Path],
    folder: Path,
    settings: Settings,
    models: Models,
    notify: Notify,
    *,
    overwrite: bool = False,
) -> list[RocCurve]:
    """Run logs, and write `roc.parquet`, `classifiers.parquet`, `confusion.parquet`, `roc.rrd` and a PNG a classifier.

    `labels`: files or folders, of any format; each log takes those of its images. `notify`: is called with a line about
    each log. `overwrite`: replace any file of these names; else only an earlier measurement. Raises InputError where a
    log or labels cannot be used or show no sign that was asked about, OutputError where the folder cannot be written.
    """
    written = CURVES.file, CLASSIFIERS.file, CONFUSION.file, RECORDING_FILE
    for name in () if overwrite else written:
        if (folder / name).exists() and not holds_table(folder / CURVES.file, CURVES):
            raise refuse(folder / name, "a file that is not an earlier measurement")
    every = joined([read_labels(path) for path in labels])
    drives = []
    for log in logs:
        faces = faces_of_log(log, every, settings.read)
        drives.append(gather_samples(log, faces, settings, models))
        counted = ", ".join(f"{name} {int(s.count.sum())}" for name, s in drives[-1].items())
        notify(f"{log.name}: asked {counted}")
    samples = join_drives(drives)
    curves = list(roc_curves(samples, settings, models))
    if not any(curve.two_sided for curve in curves):
        raise InputError(
            "roc: no classifier was asked about both signs and other things. Label more signs, or more images "
            "completely."
        )
    _write(folder, samples, curves)
    return curves


def format_curves(curves: Sequence[RocCurve]) -> str:
    """All figures as a Markdown table."""
    lines = [
        "| classifier | class | signs | others | area | threshold | TPR | FPR | knee | TPR | FPR |",
        "| --- | --- | ---: | ---: | --- | ---: | --- | --- | ---: | ---: | ---: |",
    ]
    for row in map(_summary, curves):
        words = [row["classifier"], row["class"], str(row["positives"]), str(row["negatives"])]
        if row["area"] is None:
            words += ["-"] * 7
        else:
            words += [
                _with_ends(row, "area", 1, ".3f"),
                "-" if row["threshold"] is None else f"{row['threshold']:.4g}",
                *(_with_ends(row, rate, 100, ".3g", " %") for rate in ("tpr", "fpr")),
                f"{row['knee']:.4g}",
                *(f"{100 * row[rate]:.3g} %" for rate in ("knee_tpr", "knee_fpr")),
            ]
        lines.append(f"| {' | '.join(words)} |")
    return "\n".join(lines)


def _with_ends(row: Mapping[str, Any], name: str, factor: float, form: str, unit: str = "") -> str:
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "-"
    ends = "" if low is None else f" ({factor * low:{form}} to {factor * high:{form}})"
    return f"{factor * value:{form}}{unit}{ends}"


def _write(
    folder: Path, samples: Mapping[str, ClassifierSamples], curves: Sequence[RocCurve]
) -> None:
    of_both = (curve for curve in curves if curve.two_sided)
    drawn = {name: list(own) for name, own in groupby(of_both, attrgetter("classifier"))}
    counts = [
        {"classifier": name, "labelled": labelled, "given": given, "count": count}
        for name, own in samples.items()
        for (labelled, given), count in own.confusion().items()
    ]
    with OutputFolder(folder) as output:
        try:
            for table, parts in (
                (CURVES, [_curve_columns(one) for one in curves if one.two_sided]),
                (CLASSIFIERS, [_columns(CLASSIFIERS, [*map(_summary, curves)])]),
                (CONFUSION, [_columns(CONFUSION, counts)]),
            ):
                with parquet_file(output.part / table.file, table.schema) as file:
                    batches = [record_batch(table, columns) for columns in parts]
                    file.write_table(pa.Table.from_batches(batches, table.schema))
            for name, those in drawn.items():
                with create(output.part / f"roc_{name}.png") as stream:
                    stream.write(draw_curves(name, those))
        except OSError as error:
            raise not_written(folder, error) from error
        record_curves(output.part / RECORDING_FILE, drawn, format_curves(curves))
        before = EVERY_CLASSIFIER if (folder / CURVES.file).exists() else ()
        output.commit([f"roc_{name}.png" for name in before])


def _curve_columns(curve: RocCurve) -> dict[str, Any]:
    n = len(curve.threshold)
    columns = {
        "classifier": [curve.classifier] * n,
        "class": [curve.name] * n,
        **{name: getattr(curve, name) for name in ("threshold", "tp", "fp", "tpr", "fpr")},
    }
    for name, band in (("tpr", curve.bands.tpr), ("fpr", curve.bands.fpr)):
        for end, side in enumerate(("low", "high")):
            columns[f"{name}_{side}"] = [None] * n if band is None else band[:, end]
    return columns


def _summary(curve: RocCurve) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(column.name for column in CLASSIFIERS.columns) | {
        "classifier": curve.classifier,
        "class": curve.name,
        "unit": curve.unit,
        "positives": curve.positives,
        "negatives": curve.negatives,
        "threshold": curve.used if math.isfinite(curve.used) else None,
        "resampled": curve.resampled,
        "groups": 0,
    }
    if not curve.two_sided:
        return row
    full = int((curve.tp < curve.positives).sum())
    row |= {
        "area": curve.area,
        "knee": float(curve.threshold[curve.knee]),
        "knee_tpr": float(curve.tpr[curve.knee]),
        "knee_fpr": float(curve.fpr[curve.knee]),
        "full_tpr_fpr": float(curve.fpr[full]) if full < len(curve.tp) else None,
        "groups": curve.accepted.shape[1],
    }
    intervals: dict[str, Sequence[float] | None] = {
        "area": curve.bands.area,
        "knee": curve.bands.knee,
    }
    if (at := curve.used_row) is not None:
        row |= {"tpr": float(curve.tpr[at]), "fpr": float(curve.fpr[at])}
        for name, band in (("tpr", curve.bands.tpr), ("fpr", curve.bands.fpr)):
            intervals[name] = None if band is None else band[at].tolist()
    for name, interval in intervals.items():
        if interval is not None:
            row[f"{name}_low"], row[f"{name}_high"] = interval
    return row


def _columns(table: Table, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {one.name: [row[one.name] for row in rows] for one in table.columns}


def draw_curves(classifier: str, drawn: Sequence[RocCurve]) -> bytes:
    """PNG: TPR against FPR of each class, the band of the first; ring: knee, dot: threshold of the run."""
    axes = page.new_axes((0, 1), (0, 1), page.RATES, (1160, max(660, 130 + 42 * len(drawn))))
    axes.set_title(f"ROC of {classifier}", loc="left", color=page.TEXT)
    axes.set_box_aspect(1)
    page.draw_band(axes, drawn[0])
    for row, curve in enumerate(drawn):
        used = curve.used_row
        at = curve.knee if used is None else used
        shown = float(curve.threshold[at]) if used is None else curve.used
        value = f"{shown:.4g}" if math.isfinite(shown) else "none"
        area = _with_ends(_summary(curve), "area", 1, ".3f")
        words = (
            f"{curve.name}   area {area}\n"
            f"{'knee' if used is None else 'threshold'} {value}: {100 * curve.tpr[at]:.1f} % of {curve.positives} signs"
            f", {100 * curve.fpr[at]:.2g} % of {curve.negatives} others"
        )
        width = 2.6 if curve.name == ALL else 1.6
        page.draw_roc(axes, curve, ink_of(curve.name, row), words, used=used, width=width)
    page.legend_beside(axes, KEY)
    return page.png(axes)


def ink_of(name: str, row: int) -> str:
    """Colour of a curve: dark of a whole classifier, that of a class of colour, somewhat darker, else by its row."""
    if name == ALL:
        return page.TEXT
    if name in COLOR_RGB:
        return "#{:02x}{:02x}{:02x}".format(*(round(0.8 * v) for v in COLOR_RGB[name]))
    return page.INKS[row % len(page.INKS)]


def record_curves(path: Path, drawn: Mapping[str, Sequence[RocCurve]], words: str) -> None:
    """Write a .rrd: TPR upwards against FPR of each classifier, knees and thresholds as points; `words`: Markdown."""
    import rerun as rr
    import rerun.blueprint as rrb

    def rgb(ink: str) -> tuple[int, ...]:
        return tuple(bytes.fromhex(ink[1:]))

    plots = [rrb.Spatial2DView(origin=f"/roc/{name}", name=f"ROC of {name}") for name in drawn]
    text = rrb.TextDocumentView(origin="/figures", name="figures")
    layout = rrb.Blueprint(rrb.Horizontal(rrb.Grid(*plots), text), collapse_panels=True)
    stream = rr.RecordingStream(APPLICATION, recording_id="roc")
    stream.save(path, default_blueprint=layout)
    stream.log("/figures", rr.TextDocument(words, media_type=rr.MediaType.MARKDOWN), static=True)
    square = [[(0, 0), (1, 0), (1, -1), (0, -1), (0, 0)], [(0, 0), (1, -1)]]
    for name, curves in drawn.items():
        frame = rr.LineStrips2D(square, colors=[rgb(page.FAINT)], radii=0.001)
        stream.log(f"/roc/{name}/axes", frame, static=True)
        for row, curve in enumerate(curves):
            at, ink = curve.used_row, rgb(ink_of(curve.name, row))
            line = np.stack([np.append(curve.fpr, 1.0), -np.append(curve.tpr, 1.0)], axis=1)
            shown = {"knee": curve.knee} if at is None else {"knee": curve.knee, "threshold": at}
            entity = f"/roc/{name}/{curve.name}"
            strips = rr.LineStrips2D([line], colors=[ink], radii=0.003, labels=[curve.name])
            stream.log(f"{entity}/curve", strips, static=True)
            marks = rr.Points2D(
                line[list(shown.values())],
                colors=[ink],
                radii=[0.008, 0.012][: len(shown)],
                labels=list(shown),
                show_labels=False,
            )
            stream.log(f"{entity}/points", marks, static=True)
    stream.flush()
    stream.disconnect()
