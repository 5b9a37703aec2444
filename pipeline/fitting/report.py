"""The figures of a fit in words, as JSON, and as a page with the held-out curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.fitting.fit import CONFIDENCE, FILES, Outcome
from wayside.pipeline.fitting.models import FittedConfidence, FittedModel
from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.learning.curves import RocCurve
from wayside.pipeline.learning.held_out import ClassScore, Held, Rates, Share
from wayside.pipeline.learning.page import Figure, Picture, format_page
from wayside.pipeline.learning.plots import INKS, RATES, draw_band, draw_roc, new_axes, svg
from wayside.pipeline.statistics import Interval
from wayside.schemas.models import GaussianClass

FIT_KEYS = ("provenance", "models", "held_out")
NETWORKS = (
    "network.onnx, box.onnx, front.json, back.json: too large for labels of a few roads; "
    "those that ship are used"
)
"""What cannot be fitted."""
_CHOSEN = (
    "no image is complete: what is no sign are marked regions alone, mostly such as a run let pass, of which the "
    "shipped model accepts more than of all regions and so looks worse than it is; try the result on another drive, "
    "or label complete images (--complete)"
)
_CURVES = (
    "Curves show samples that were held out. Grey: 95 % band of the true positive rate over stretches of road. Dot: "
    "the threshold in the model file; ring: the knee. Of a gate, all thresholds are chosen together."
)


def fit_json(
    outcomes: Sequence[Outcome],
    drives: Sequence[LabelledDrive],
    provenance: str,
    alpha: float | None,
) -> dict[str, Any]:
    """All figures: what was learned from, per model its classes, thresholds, held-out rates and curves."""
    return {
        "provenance": provenance,
        "held_out": "drives" if _by_drive(drives) else "stretches of road",
        "stretches": _stretches(drives),
        "rule": "knee" if alpha is None else f"alpha {alpha:g}",
        "models": {one.what: _outcome(one) for one in outcomes},
        "not_fitted": NETWORKS,
    }


def format_fit(outcomes: Sequence[Outcome], drives: Sequence[LabelledDrive], out: Path) -> str:
    """The report that the command prints."""
    lines = [
        f"{drive.name}: {len(drive.stretch)} labelled images, {len(drive.faces.sign)} boxes of "
        f"{len(set(drive.faces.sign.tolist()))} signs, {len(drive.labels.complete)} images complete"
        for drive in drives
    ]
    stretches = _stretches(drives)
    held = f"{len(drives)} drives" if _by_drive(drives) else f"{stretches} stretches of road"
    lines.append(f"held out in turn: {held}; brackets: 95 % intervals over {stretches} stretches")
    if not any(drive.labels.complete for drive in drives):
        lines.append(_CHOSEN)
    for one in outcomes:
        lines += ["", *outcome_lines(one)]
    written = [one.what for one in outcomes if one.written]
    preset = "" if CONFIDENCE in written else " --preset report"
    lines += [
        "",
        f"not fitted: {NETWORKS}",
        f"written to {out}: {', '.join(FILES[what] for what in written)}, fit.json, fit.html; next: wayside run "
        f"drive.mcap{preset} --models {out}",
    ]
    return "\n".join(lines)


def outcome_lines(one: Outcome) -> list[str]:
    """What became of one model, in lines."""
    state = f"{FILES[one.what]} written" if one.written else f"not written, {one.refusal}"
    lines = [f"{one.what}: {state}"]
    if one.faces is not None:
        lines.append(f"  {one.met} of {one.faces} labelled faces have a region of the segmentation")
    if isinstance(one.fitted, FittedConfidence):
        c = one.fitted
        lines.append(
            f"  {c.signs} landmarks of signs, {c.others} others; log odds {c.slope:.2f} x + {c.shift:.2f}; held out: "
            f"log loss {c.before:.3f} to {c.after:.3f}, Brier score {c.brier_before:.3f} to {c.brier_after:.3f}"
        )
    elif one.fitted is not None:
        lines += _model_lines(one.fitted)
    return lines


def _model_lines(fitted: FittedModel) -> list[str]:
    held, before = fitted.held, fitted.shipped
    lines = [
        f"  held out, {fitted.model.space}: accepted {_share(held.accepted)}, under the right name "
        f"{_share(held.named)}, of {held.others} others {_share(held.false_rate)}",
        f"  shipped, same samples: accepted {before.accepted.value:.2f}, right name {before.named.value:.2f}, others "
        f"{before.false_rate.value:.2f}",
    ]
    for name, other in fitted.compared.items():
        rates = f"right name {_share(other.named)}, others {_share(other.false_rate)}"
        lines.append(f"  in space {name}: {rates}")
    lines.append(
        "  class                      signs  views  right name         area               threshold"
    )
    classes = {one.name: one for one in fitted.model.classes}
    for score in held.classes:
        lines.append(
            f"  {score.name:<26} {score.signs:>5}  {score.views:>5}  {_share(score.named):<17}  "
            f"{_area(score.curve):<17}  {_threshold(classes[score.name])}"
        )
    for name in fitted.kept:
        lines.append(
            f"  {name:<26} {fitted.lacking.get(name, 0):>5}         too few signs: shipped class kept          "
            f"threshold {classes[name].threshold:.2f}"
        )
    left = [f"{name} ({n})" for name, n in fitted.lacking.items() if name not in fitted.kept]
    if left:
        lines.append(f"  left out, too few signs: {', '.join(left)}")
    return lines


def _by_drive(drives: Sequence[LabelledDrive]) -> bool:
    return any(drive.fold is not None for drive in drives)


def _stretches(drives: Sequence[LabelledDrive]) -> int:
    return len({stretch for drive in drives for stretch in drive.stretch.values()})


def _share(share: Share) -> str:
    return _with_ends(share.value, (share.low, share.high))


def _area(curve: RocCurve | None) -> str:
    return "-" if curve is None else _with_ends(curve.area, curve.area_interval)


def _threshold(one: GaussianClass) -> str:
    return _with_ends(one.threshold, one.threshold_interval)


def _with_ends(value: float, ends: Interval | tuple[float, float] | None) -> str:
    return f"{value:.2f}" + ("" if ends is None else f" [{ends[0]:.2f} {ends[1]:.2f}]")


def _outcome(one: Outcome) -> dict[str, Any]:
    body: dict[str, Any] = {
        "file": FILES[one.what] if one.written else None,
        "refusal": one.refusal or None,
        "labelled_faces": one.faces,
        "faces_with_a_region": one.met,
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
        "held_out": _held(f.held),
        "shipped_on_the_same": {name: share[0] for name, share in _rates(f.shipped).items()},
        "fitted_on_all": {name: share[0] for name, share in _rates(f.fitted).items()},
        "other_spaces": {name: _rates(held) for name, held in f.compared.items()},
        "kept": list(f.kept),
        "too_few_signs": f.lacking,
        "thresholds": {
            c.name: {
                "threshold": c.threshold,
                "interval": c.threshold_interval,
                "rule": c.threshold_rule,
                "samples": c.count,
            }
            for c in f.model.classes
        },
    }


def _rates(rates: Rates) -> dict[str, Share]:
    return {name: getattr(rates, name) for name in ("accepted", "named", "false_rate")}


def _held(held: Held) -> dict[str, Any]:
    return {
        **_rates(held),
        "others": held.others,
        "confusion": held.confusion,
        "classes": {one.name: _class(one) for one in held.classes},
    }


def _class(one: ClassScore) -> dict[str, Any]:
    curve = one.curve
    return {
        "signs": one.signs,
        "views": one.views,
        "named": one.named,
        "area": None if curve is None else curve.area,
        "area_interval": None if curve is None else curve.area_interval,
        "curve": None
        if curve is None
        else {
            "threshold": [
                round(v, 4) if np.isfinite(v) else None for v in curve.threshold.tolist()
            ],
            "true_rate": np.round(curve.tpr, 4).tolist(),
            "false_rate": np.round(curve.fpr, 5).tolist(),
        },
    }


def fit_page(outcomes: Sequence[Outcome], provenance: str) -> str:
    """HTML: for each model its held-out rates next to the shipped ones, and the curve of each class."""
    chapters = [(one.what, _figures(one)) for one in outcomes]
    return format_page("Models fitted to labels", (provenance, _CURVES), chapters)


def _figures(one: Outcome) -> tuple[Figure]:
    state = "written" if one.written else f"not written: {one.refusal}"
    if isinstance(one.fitted, FittedConfidence):
        c = one.fitted
        state = (
            f"{state}. {c.signs} landmarks of signs, {c.others} others. Held-out log loss {c.before:.3f} shipped, "
            f"{c.after:.3f} fitted; Brier score {c.brier_before:.3f}, {c.brier_after:.3f}."
        )
    if not isinstance(one.fitted, FittedModel):
        return (Figure("", "", "", state),)
    fitted = one.fitted
    compared: dict[str, Rates] = {f"fitted, held out ({fitted.model.space})": fitted.held}
    compared["shipped, same samples"] = fitted.shipped
    compared |= {f"in space {name}, held out": held for name, held in fitted.compared.items()}
    rows = [("", "signs accepted", "under the right name", "others accepted")]
    for name, rates in compared.items():
        accepted, named, false = (f"{100 * one.value:.1f} %" for one in _rates(rates).values())
        rows.append((name, accepted, named, false))
    classes = {one.name: one for one in fitted.model.classes}
    pictures = [_picture(score, classes[score.name]) for score in fitted.held.classes]
    return (Figure("", "", "", state, pictures, table=rows),)


def _picture(score: ClassScore, one: GaussianClass) -> Picture:
    words = f"{score.name}: {score.signs} signs, {score.views} views"
    curve = score.curve
    if curve is None:
        return Picture("", f"{words}, all in one stretch")
    axes = new_axes((0, 1), (0, 1), RATES, (300, 290))
    draw_band(axes, curve)
    used = curve.at(one.threshold, accept_below=True)
    draw_roc(axes, curve, INKS[0], "", used=used)
    words += f"; area {curve.area:.2f}; threshold {_threshold(one)}: {one.threshold_rule}"
    return svg(axes, words)
