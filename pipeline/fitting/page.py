"""One page with the held-out curves of a fit, without script and without anything from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from wayside.pipeline.fitting.confidence import FittedConfidence
from wayside.pipeline.fitting.fit import Outcome
from wayside.pipeline.fitting.models import FittedModel
from wayside.pipeline.fitting.validation import ClassScore
from wayside.pipeline.roc.curves import RocCurve
from wayside.schemas.models import GaussianClass

SIDE, EDGE = 220, 34
_STYLE = """body{font:15px/1.5 system-ui,sans-serif;margin:1.5em auto;max-width:70em;padding:0 1em;color:#222}
h2{margin-top:2em}figure{display:inline-block;margin:0 1em 1em 0;vertical-align:top}
figcaption{max-width:250px;font-size:13px}table{border-collapse:collapse}
td,th{padding:.15em .8em;text-align:left;border-bottom:1px solid #ddd}svg text{font-size:11px;fill:#555}
.band{fill:#dfe7f1}.line{fill:none;stroke:#1d5fae;stroke-width:2}.axis{fill:none;stroke:#999}.point{fill:#c0392b}"""


def fit_page(outcomes: Sequence[Outcome], provenance: str) -> str:
    """HTML: for each model its held-out rates beside the shipped ones, and the curve of each class."""
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8>",
        "<meta name=viewport content='width=device-width'><title>wayside fit</title>",
        f"<style>{_STYLE}</style><h1>Models fitted to labels</h1><p>{escape(provenance)}</p>",
        "<p>Curves show samples that were held out. Grey: 95 % band of the true positive rate over stretches of road. "
        "Red: the threshold in the model file. Of a gate, all thresholds are chosen together.</p>",
    ]
    for one in outcomes:
        state = "written" if one.written else f"not written: {one.refusal}"
        parts.append(f"<h2>{escape(one.what)}</h2><p>{escape(state)}</p>")
        if isinstance(one.fitted, FittedModel):
            parts.append(_model(one.fitted))
        elif isinstance(one.fitted, FittedConfidence):
            c = one.fitted
            parts.append(
                f"<p>{c.signs} landmarks of signs, {c.others} others. Held-out log loss {c.before:.3f} shipped, "
                f"{c.after:.3f} fitted; Brier score {c.brier_before:.3f}, {c.brier_after:.3f}.</p>"
            )
    return "\n".join(parts) + "\n</html>\n"


def _model(fitted: FittedModel) -> str:
    held, shipped = fitted.held, fitted.shipped
    rows = [
        (f"fitted, held out ({fitted.model.space})", held.accepted, held.named, held.false_rate),
        ("shipped, same samples", shipped.accepted, shipped.named, shipped.false_rate),
        *(
            (f"in space {name}, held out", other.accepted, other.named, other.false_rate)
            for name, other in fitted.compared.items()
        ),
    ]
    table = "".join(
        f"<tr><td>{escape(name)}"
        + "".join(f"<td>{100 * value:.1f} %" for value in (accepted, named, false))
        for name, accepted, named, false in rows
    )
    head = "<tr><th><th>signs accepted<th>under the right name<th>others accepted"
    classes = {one.name: one for one in fitted.model.classes}
    figures = "".join(_figure(score, classes[score.name]) for score in held.classes)
    return f"<table>{head}{table}</table><p>{figures}"


def _figure(score: ClassScore, one: GaussianClass) -> str:
    words = f"{score.name}: {score.signs} signs, {score.views} views"
    if score.curve is None:
        return f"<figure><figcaption>{escape(words)}, all in one stretch</figcaption></figure>"
    curve = score.curve
    low, high = one.threshold_interval or (one.threshold, one.threshold)
    words += f"; area {curve.area:.2f}; threshold {one.threshold:.2f} [{low:.2f} {high:.2f}]: {one.threshold_rule}"
    return (
        f"<figure>{_drawing(curve, one.threshold)}<figcaption>{escape(words)}</figcaption></figure>"
    )


def _drawing(curve: RocCurve, threshold: float) -> str:
    x, y = np.append(curve.fpr, 1.0), np.append(curve.tpr, 1.0)
    band = ""
    if curve.tpr_band is not None:
        low, high = (np.append(curve.tpr_band[:, k], 1.0) for k in (0, 1))
        edge = [*_points(x, high), *_points(x, low)[::-1]]
        band = f"<polygon class=band points='{' '.join(edge)}'/>"
    at = curve.at(threshold, accept_below=True)
    (dot,) = _points(x[at : at + 1], y[at : at + 1])
    across, down = dot.split(",")
    total, bottom = SIDE + EDGE + 8, SIDE + 8
    return (
        f"<svg width={total} height={SIDE + EDGE + 8} role=img aria-label='ROC'>{band}"
        f"<path class=axis d='M{EDGE} 8V{bottom}H{EDGE + SIDE}'/>"
        f"<polyline class=line points='{' '.join(_points(x, y))}'/>"
        f"<circle class=point r=4 cx={across} cy={down} />"
        f"<text x={EDGE} y={bottom + 16}>0</text><text x={EDGE + SIDE - 8} y={bottom + 16}>1</text>"
        f"<text x={EDGE + 40} y={bottom + 28}>false positive rate</text>"
        f"<text x=2 y=20>1</text><text transform='translate(14 {SIDE - 30}) rotate(-90)'>true positive rate</text>"
        "</svg>"
    )


def _points(x: np.ndarray, y: np.ndarray) -> list[str]:
    return [
        f"{EDGE + SIDE * u:.1f},{8 + SIDE * (1 - v):.1f}"
        for u, v in zip(x.tolist(), y.tolist(), strict=True)
    ]
