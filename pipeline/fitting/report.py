"""The outcome of a fit: in words, as JSON, and as a page with the held-out curves."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.files.visible_text import counted
from wayside.pipeline.fitting.models import FittedConfidence, FittedModel, Task
from wayside.pipeline.fitting.samples import Gathered, LabelledDrive
from wayside.pipeline.learning import page
from wayside.pipeline.learning.fits import ClassScore, Rates
from wayside.pipeline.models.model_files import OWN_COLORS, REPORT_LOCATION
from wayside.pipeline.pages import render_page
from wayside.pipeline.statistics import Interval

COLOR, SHAPE, LOCATION, CONFIDENCE = "color", "shape", "location", "confidence"
FILES = {
    COLOR: OWN_COLORS,
    SHAPE: "shape.json",
    LOCATION: REPORT_LOCATION,
    CONFIDENCE: "place.json",
}
"""What can be fitted, in the order of the chain, and the file of its model."""
FIT_KEYS = ("provenance", "models", "held_out")
NETWORKS = (
    "network.onnx, box.onnx, front.json, back.json: too large for labels of a few roads; "
    "those that ship are used"
)
"""What cannot be fitted."""
_CHOSEN = (
    "no image is complete, so only marked regions count as not signs. A run accepted most of these, so the "
    "shipped model looks worse on them than it is. Try the result on another drive, or label complete images "
    "(--complete)"
)
_CURVES = (
    "Curves show samples that were held out. Grey: 95 % band of the true positive rate over stretches of road. Dot: "
    "the threshold in the model file, one of all classes; ring: the knee."
)

Table = Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome for one model.

    `fitted`: the model with its figures, None with too few samples. `refusal`: why the shipped model stays, else "".
    `regions`: what it is fitted to, None for landmarks.
    """

    what: str
    fitted: FittedModel | FittedConfidence | None
    refusal: str = ""
    regions: Gathered | None = None

    @property
    def written(self) -> bool:
        """Whether its file is written."""
        return self.fitted is not None and not self.refusal


def format_fit(outcomes: Sequence[Outcome], drives: Sequence[LabelledDrive], out: Path) -> str:
    """The report that the command prints."""
    lines = [
        f"{drive.name}: {counted(len(drive.stretch), 'labelled image')}, {drive.boxes_of_signs}, "
        f"{len(drive.faces.complete)} images complete"
        for drive in drives
    ]
    stretches = _stretches(drives)
    held = f"{len(drives)} drives" if _by_drive(drives) else f"{stretches} stretches of road"
    lines.append(f"held out in turn: {held}; brackets: 95 % intervals over {stretches} stretches")
    if not any(drive.faces.complete for drive in drives):
        lines.append(_CHOSEN)
    for one in outcomes:
        lines += ["", *outcome_lines(one)]
    written = [one.what for one in outcomes if one.written]
    preset = "" if CONFIDENCE in written else " --preset report"
    return "\n".join(
        [
            *lines,
            "",
            f"not fitted: {NETWORKS}",
            f"written to {out}: {', '.join(FILES[what] for what in written)}, fit.json, fit.html; next: wayside run "
            f"drive.mcap{preset} --models {out}",
        ]
    )


def outcome_lines(one: Outcome) -> list[str]:
    """The outcome for one model, in lines."""
    lines = []
    for words, table in _described(one):
        lines.append(f"  {words}")
        widths = [max(len(row[k]) for row in table) for k in range(len(table[0]))] if table else []
        for row in table:
            cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            lines.append(f"    {'  '.join(cells)}".rstrip())
    return [f"{one.what}: {lines[0].strip()}", *lines[1:]]


def fit_page(outcomes: Sequence[Outcome], provenance: str) -> str:
    """HTML: for each model its held-out rates next to the shipped ones, and the curve of each class."""
    chapters = []
    for one in outcomes:
        figures = [page.Figure("", "", "", words, table=table) for words, table in _described(one)]
        if isinstance(one.fitted, FittedModel):
            model = one.fitted.model
            pictures = [_picture(score, model.threshold) for score in one.fitted.held.classes]
            figures.append(page.Figure("", "", "", "", pictures))
        chapters.append((one.what, figures))
    about = {"title": "Models fitted to labels", "intro": (provenance, _CURVES)}
    return render_page("figures.html", "wayside fit", **about, chapters=chapters)


def _described(one: Outcome) -> Iterator[tuple[str, Table]]:
    """What the terminal and the page say of a model: words, each with the table below them."""
    yield f"{FILES[one.what]} written" if one.written else f"not written, {one.refusal}", ()
    if (own := one.regions) is not None:
        yield f"{own.met} of {own.faces} labelled faces have a region of the segmentation", ()
    if isinstance(one.fitted, FittedConfidence):
        c = one.fitted
        yield (
            f"{c.signs} landmarks of signs, {c.others} others; log odds {c.slope:.2f} x + {c.shift:.2f}; held out: log "
            f"loss {c.before:.3f} to {c.after:.3f}, Brier score {c.brier_before:.3f} to {c.brier_after:.3f}",
            (),
        )
    elif one.fitted is not None:
        yield _rates_table(one.fitted)
        yield _class_table(one.fitted)


def _rates_table(fitted: FittedModel) -> tuple[str, Table]:
    compared: dict[str, Rates] = {f"fitted, held out ({fitted.model.space})": fitted.held}
    compared["shipped, same samples"] = fitted.shipped
    compared |= {f"in space {name}, held out": held for name, held in fitted.compared.items()}
    rows: list[Sequence[str]] = [("", "signs accepted", "correctly named", "others accepted")]
    for name, rates in compared.items():
        shares = (rates.accepted, rates.named, rates.false_rate)
        rows.append((name, *(_with_ends(value, ends) for value, *ends in shares)))
    threshold = _with_ends(fitted.model.threshold, fitted.model.threshold_interval)
    rule = f"log-likelihood ratio from {threshold}, {fitted.model.threshold_rule}"
    return f"{rule}; shares of the signs, and of {fitted.held.others} others:", rows


def _class_table(fitted: FittedModel) -> tuple[str, Table]:
    rows: list[Sequence[str]] = [("class", "signs", "views", "right name", "area")]
    for score in fitted.held.classes:
        value, *ends = score.named
        curve, shares = score.curve, [_with_ends(value, ends)]
        shares.append("-" if curve is None else _with_ends(curve.area, curve.bands.area))
        rows.append((score.name, str(score.signs), str(score.views), *shares))
    for name in fitted.kept:
        cells = str(fitted.lacking.get(name, 0)), "", "too few signs: shipped class kept", ""
        rows.append((name, *cells))
    left = [f"{name} ({n})" for name, n in fitted.lacking.items() if name not in fitted.kept]
    return f"left out, too few signs: {', '.join(left)}" if left else "classes:", rows


def _picture(score: ClassScore, threshold: float) -> page.Picture:
    words, curve = f"{score.name}: {score.signs} signs, {score.views} views", score.curve
    if curve is None:
        return page.Picture("", f"{words}, all in one stretch")
    axes = page.new_axes((0, 1), (0, 1), page.RATES, (300, 290))
    page.draw_band(axes, curve)
    page.draw_roc(axes, curve, page.INKS[0], "", used=curve.at(threshold))
    return page.svg(axes, f"{words}; area {curve.area:.2f}")


def _by_drive(drives: Sequence[LabelledDrive]) -> bool:
    return any(drive.fold is not None for drive in drives)


def _stretches(drives: Sequence[LabelledDrive]) -> int:
    return len({stretch for drive in drives for stretch in drive.stretch.values()})


def _with_ends(value: float, ends: Interval | Sequence[float] | None) -> str:
    return f"{value:.2f}" + ("" if ends is None else f" [{ends[0]:.2f} {ends[1]:.2f}]")


def fit_json(
    outcomes: Sequence[Outcome], drives: Sequence[LabelledDrive], task: Task
) -> dict[str, Any]:
    """All figures: what was learned from, per model its classes, thresholds, held-out rates and curves."""
    return {
        "provenance": task.provenance,
        "held_out": "drives" if _by_drive(drives) else "stretches of road",
        "stretches": _stretches(drives),
        "rule": f"alpha {'of the shipped model' if task.alpha is None else f'{task.alpha:g}'}",
        "models": {one.what: _outcome(one) for one in outcomes},
        "not_fitted": NETWORKS,
    }


def _outcome(one: Outcome) -> dict[str, Any]:
    body: dict[str, Any] = {
        "file": FILES[one.what] if one.written else None,
        "refusal": one.refusal or None,
        "labelled_faces": one.regions and one.regions.faces,
        "faces_with_a_region": one.regions and one.regions.met,
    }
    if isinstance(one.fitted, FittedConfidence):
        c = one.fitted
        return body | {
            "slope": c.slope,
            "shift": c.shift,
            "landmarks_of_signs": c.signs,
            "other_landmarks": c.others,
            "log_loss": {"shipped": c.before, "held_out": c.after},
            "brier_score": {"shipped": c.brier_before, "held_out": c.brier_after},
        }
    if one.fitted is None:
        return body
    f = one.fitted
    return body | {
        "space": f.model.space,
        "prior_signs": f.prior_signs,
        "held_out": {
            **_rates(f.held),
            "others": f.held.others,
            "confusion": f.held.confusion,
            "classes": {score.name: _class(score) for score in f.held.classes},
        },
        "shipped_on_the_same": {name: share[0] for name, share in _rates(f.shipped).items()},
        "fitted_on_all": {name: share[0] for name, share in _rates(f.fitted).items()},
        "other_spaces": {name: _rates(held) for name, held in f.compared.items()},
        "kept": list(f.kept),
        "too_few_signs": f.lacking,
        "threshold": f.model.threshold,
        "threshold_interval": f.model.threshold_interval,
        "threshold_rule": f.model.threshold_rule,
        "samples": {c.name: c.count for c in f.model.classes},
    }


def _rates(rates: Rates) -> dict[str, Any]:
    return {name: getattr(rates, name) for name in ("accepted", "named", "false_rate")}


def _class(one: ClassScore) -> dict[str, Any]:
    body = {"signs": one.signs, "views": one.views, "named": one.named}
    curve = one.curve
    if curve is None:
        return body | dict.fromkeys(("area", "area_interval", "curve"))
    thresholds = [round(v, 4) if np.isfinite(v) else None for v in curve.threshold.tolist()]
    return body | {
        "area": curve.area,
        "area_interval": curve.bands.area,
        "curve": {
            "threshold": thresholds,
            "true_rate": np.round(curve.tpr, 4).tolist(),
            "false_rate": np.round(curve.fpr, 5).tolist(),
        },
    }
