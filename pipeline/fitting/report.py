"""The figures of a fit in words, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wayside.pipeline.fitting.confidence import FittedConfidence
from wayside.pipeline.fitting.fit import CONFIDENCE, FILES, Outcome
from wayside.pipeline.fitting.models import FittedModel, Rates
from wayside.pipeline.fitting.sources import LabelledDrive
from wayside.pipeline.fitting.validation import Held
from wayside.pipeline.statistics import Interval

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


def fit_json(
    outcomes: Sequence[Outcome],
    drives: Sequence[LabelledDrive],
    provenance: str,
    alpha: float | None,
) -> dict[str, Any]:
    """All figures: what was learned from, per model its classes, thresholds, held-out rates and curves."""
    by_drive = any(drive.fold is not None for drive in drives)
    return {
        "provenance": provenance,
        "held_out": "drives" if by_drive else "stretches of road",
        "stretches": len({s for drive in drives for s in drive.stretch.values()}),
        "rule": "knee" if alpha is None else f"alpha {alpha:g}",
        "models": {one.what: _outcome(one) for one in outcomes},
        "not_fitted": NETWORKS,
    }


def format_fit(outcomes: Sequence[Outcome], drives: Sequence[LabelledDrive], out: Path) -> str:
    """The report that the command prints."""
    lines = [
        f"{drive.name}: {len(drive.stretch)} labelled images, {len(drive.sign)} boxes of "
        f"{len(set(drive.sign.tolist()))} signs, {len(drive.labels.complete)} images complete"
        for drive in drives
    ]
    stretches = len({s for drive in drives for s in drive.stretch.values()})
    by_drive = any(drive.fold is not None for drive in drives)
    held = f"{len(drives)} drives" if by_drive else f"{stretches} stretches of road"
    lines.append(f"held out in turn: {held}; brackets: 95 % intervals over {stretches} stretches")
    if not any(drive.labels.complete for drive in drives):
        lines.append(_CHOSEN)
    for one in outcomes:
        lines += ["", *outcome_lines(one)]
    lines += ["", f"not fitted: {NETWORKS}"]
    written = [one.what for one in outcomes if one.written]
    lines.append(f"written to {out}: {', '.join(FILES[what] for what in written)}")
    preset = "" if CONFIDENCE in written else " --preset report"
    lines[-1] += f", fit.json, fit.html; next: wayside run drive.mcap{preset} --models {out}"
    return "\n".join(lines)


def outcome_lines(one: Outcome) -> list[str]:
    """What became of one model, in lines."""
    name = FILES[one.what]
    head = (
        f"{one.what}: {name} written" if one.written else f"{one.what}: not written, {one.refusal}"
    )
    lines = [head]
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
        f"  held out, {fitted.model.space}: accepted {_share(held.accepted, held.accepted_interval)}, under the right "
        f"name {_share(held.named, held.named_interval)}, of {held.others} others "
        f"{_share(held.false_rate, held.false_interval)}",
        f"  shipped, same samples: accepted {before.accepted:.2f}, right name {before.named:.2f}, others "
        f"{before.false_rate:.2f}",
    ]
    for name, other in fitted.compared.items():
        lines.append(
            f"  in space {name}: right name {_share(other.named, other.named_interval)}, others "
            f"{_share(other.false_rate, other.false_interval)}"
        )
    lines.append(
        "  class                      signs  views  right name         area               threshold"
    )
    thresholds = {one.name: one for one in fitted.model.classes}
    for score in held.classes:
        one = thresholds[score.name]
        area = score.curve
        words = "-" if area is None else _share(area.area, area.area_interval)
        lines.append(
            f"  {score.name:<26} {score.signs:>5}  {score.views:>5}  {_share(score.named, score.named_interval):<17}  "
            f"{words:<17}  {_share(one.threshold, one.threshold_interval)}"
        )
    for name in fitted.kept:
        found = fitted.lacking.get(name, 0)
        lines.append(
            f"  {name:<26} {found:>5}         too few signs: shipped class kept          threshold "
            f"{thresholds[name].threshold:.2f}"
        )
    left = [
        f"{name} ({count})" for name, count in fitted.lacking.items() if name not in fitted.kept
    ]
    if left:
        lines.append(f"  left out, too few signs: {', '.join(left)}")
    return lines


def _share(value: float, interval: Interval | tuple[float, float] | None) -> str:
    return f"{value:.2f}" + ("" if interval is None else f" [{interval[0]:.2f} {interval[1]:.2f}]")


def _outcome(one: Outcome) -> dict[str, Any]:
    body: dict[str, Any] = {
        "file": FILES[one.what] if one.written else None,
        "refusal": one.refusal or None,
        "labelled_faces": one.faces,
        "faces_with_a_region": one.met,
    }
    if isinstance(one.fitted, FittedConfidence):
        c = one.fitted
        body |= {
            "slope": c.slope,
            "shift": c.shift,
            "landmarks_of_signs": c.signs,
            "other_landmarks": c.others,
            "log_loss": {"shipped": c.before, "held_out": c.after},
            "brier_score": {"shipped": c.brier_before, "held_out": c.brier_after},
        }
    elif one.fitted is not None:
        f = one.fitted
        body |= {
            "space": f.model.space,
            "prior_signs": f.prior_signs,
            "held_out": _held(f.held),
            "shipped_on_the_same": _plain(f.shipped),
            "fitted_on_all": _plain(f.fitted),
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
    return body


def _plain(rates: Rates) -> dict[str, float]:
    return {
        "accepted": rates.accepted,
        "named": rates.named,
        "false_rate": rates.false_rate,
    }


def _rates(held: Held) -> dict[str, Any]:
    return {
        "accepted": [held.accepted, *held.accepted_interval],
        "named": [held.named, *held.named_interval],
        "false_rate": [held.false_rate, *held.false_interval],
    }


def _held(held: Held) -> dict[str, Any]:
    return _rates(held) | {
        "others": held.others,
        "confusion": held.confusion,
        "classes": {
            one.name: {
                "signs": one.signs,
                "views": one.views,
                "named": [one.named, *one.named_interval],
                "area": None if one.curve is None else one.curve.area,
                "area_interval": None if one.curve is None else one.curve.area_interval,
                "curve": None
                if one.curve is None
                else {
                    "threshold": _finite(one.curve.threshold),
                    "true_rate": np.round(one.curve.tpr, 4).tolist(),
                    "false_rate": np.round(one.curve.fpr, 5).tolist(),
                },
            }
            for one in held.classes
        },
    }


def _finite(values: Any) -> list[float | None]:
    return [round(float(v), 4) if np.isfinite(v) else None for v in values]
