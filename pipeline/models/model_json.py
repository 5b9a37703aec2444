"""Model files: readable, versioned JSON, never pickled.

The key `accept` bears an older name than the attribute here, the `threshold` of evidence.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.models import (
    EvidenceModel,
    GaussianClass,
    GaussianModel,
    LinearModel,
    MixtureModel,
    Model,
    NetworkSum,
    OperatingPoint,
    ScoreModel,
)

MIXTURE_ARRAYS = ("weight", "mean", "covariance")
EVIDENCE_COLUMNS = ("name", "term", "knots", "curve")
_FAULTS = (
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    RecursionError,
)


def model_to_json(model: Model) -> str:
    """The model as text, stable byte for byte."""
    if isinstance(model, GaussianModel):
        body: dict[str, Any] = {
            "space": model.space,
            "classes": [_gaussian_class(c) for c in model.classes],
        }
        body |= _curve(model.curve)
    elif isinstance(model, MixtureModel):
        body = {"space": model.space}
        body |= {name: _significant(getattr(model, name)) for name in MIXTURE_ARRAYS}
        body |= {"threshold": round(model.threshold, 4), "threshold_rule": model.threshold_rule}
        body |= {"count": model.count} | _interval(model.threshold_interval) | _curve(model.curve)
    elif isinstance(model, LinearModel):
        weights = [float(f"{w:.6g}") for w in model.weights]
        body = {"weights": dict(zip(model.features, weights, strict=True))}
    elif isinstance(model, EvidenceModel):
        columns = ([column.tolist() for column in own] for own in (model.knots, model.curves))
        rows = zip(model.features, model.terms, *columns, strict=True)
        body = {
            "features": [dict(zip(EVIDENCE_COLUMNS, row, strict=True)) for row in rows],
            "shift": model.shift,
            "accept": model.threshold,
        }
        if model.decision:
            body["decision"] = model.decision
        body |= _rule(model) | _curve(model.curve)
    else:
        body = {"threshold": model.threshold} | _rule(model)
        if model.with_network is not None:
            body["with_network"] = asdict(model.with_network)
    head = {"schema_version": 1, "kind": model.kind, "provenance": model.provenance}
    return json.dumps(head | body, separators=(",", ":"), indent=None) + "\n"


def model_from_json(text: str, name: str = "model") -> Model:
    """Read a model, every number and link of it checked; raises InputError with the name where the text is not one."""
    try:
        model = _model_of(json.loads(text))
        object.__setattr__(
            model, "text_digest", digest(text)
        )  # frozen, and no argument of its kind
    except _FAULTS as error:
        raise InputError(
            f"{name}: this is not a model file of wayside: {type(error).__name__}: {error}. Write one with the "
            "learning script, or leave the setting out to use the model that ships."
        ) from error
    return model


def _model_of(data: dict[str, Any]) -> Model:
    if data["kind"] == "gaussian":
        classes = tuple(_gaussian_class_of(c) for c in data["classes"])
        curve = _curve_of(data, len(classes))
        return GaussianModel(data["space"], classes, str(data["provenance"]), curve)
    if data["kind"] == "mixture":
        return _mixture_of(data)
    if data["kind"] == "score":
        return _score_of(data)
    if data["kind"] == "linear":
        weights = np.array([float(weight) for weight in data["weights"].values()])
        _check_shapes({"weights": weights}, ((len(weights),),))
        return LinearModel(tuple(data["weights"]), weights, str(data["provenance"]))
    if data["kind"] == "evidence":
        return _evidence_of(data)
    raise KeyError(f"kind {data['kind']!r}")


def _gaussian_class(one: GaussianClass) -> dict[str, Any]:
    content: dict[str, Any] = {
        "name": one.name,
        "mean": np.round(one.mean, 6).tolist(),
        "covariance": np.round(one.covariance, 8).tolist(),
        "threshold": round(one.threshold, 4),
        "threshold_rule": one.threshold_rule,
        "count": one.count,
    }
    return content | _interval(one.threshold_interval)


def _rule(model: ScoreModel | EvidenceModel) -> dict[str, Any]:
    """The keys of how a threshold was chosen, where that is known."""
    rule = {"threshold_rule": model.threshold_rule} if model.threshold_rule else {}
    return rule | _interval(model.threshold_interval)


def _interval(interval: tuple[float, float] | None) -> dict[str, Any]:
    """The key of a threshold's interval, where there is one."""
    return {} if interval is None else {"threshold_interval": [round(end, 4) for end in interval]}


def _interval_of(data: dict[str, Any]) -> tuple[float, float] | None:
    ends = [_finite(end, "threshold_interval") for end in data.get("threshold_interval", ())]
    if len(ends) not in (0, 2):
        raise ValueError(f"threshold_interval: {len(ends)} numbers instead of two")
    return (ends[0], ends[1]) if ends else None


def _curve(curve: Sequence[OperatingPoint]) -> dict[str, Any]:
    """The key of a curve, where there is one: rates, thresholds and both ends of their intervals, a row a point."""
    rows = [
        [round(rate, 6) for rate in (one.false_alarm, one.power)]
        + [round(value, 4) for value in (*one.thresholds, *chain.from_iterable(one.intervals))]
        for one in curve
    ]
    return {"curve": rows} if rows else {}


def _curve_of(data: dict[str, Any], classes: int) -> tuple[OperatingPoint, ...]:
    return tuple(_operating_point_of(point, classes) for point in data.get("curve", ()))


def _operating_point_of(data: list[Any], classes: int) -> OperatingPoint:
    false_alarm, power, *values = (_finite(value, "curve") for value in data)
    if len(values) not in (classes, 3 * classes) or not (0 <= false_alarm <= 1 and 0 <= power <= 1):
        raise ValueError(
            f"curve: {data} is not two rates, {classes} thresholds, and both or no ends of their intervals"
        )
    ends = values[classes:]
    intervals = tuple(zip(ends[::2], ends[1::2], strict=True))
    return OperatingPoint(false_alarm, power, tuple(values[:classes]), intervals)


def _gaussian_class_of(data: dict[str, Any]) -> GaussianClass:
    mean = np.array(data["mean"], np.float64)
    covariance = np.array(data["covariance"], np.float64)
    d = mean.size
    _check_shapes({"mean": mean, "covariance": covariance}, ((d,), (d, d)))
    if not (d and np.allclose(covariance, covariance.T) and np.linalg.eigvalsh(covariance)[0] > 0):
        raise ValueError(f"the covariance of {data['name']!r} is not positive definite")
    return GaussianClass(
        str(data["name"]),
        mean,
        covariance,
        _finite(data["threshold"], "threshold"),
        str(data["threshold_rule"]),
        int(data["count"]),
        _interval_of(data),
    )


def _mixture_of(data: dict[str, Any]) -> MixtureModel:
    arrays = {name: np.array(data[name], np.float64) for name in MIXTURE_ARRAYS}
    (k, d), covariance = arrays["mean"].shape, arrays["covariance"]
    _check_shapes(arrays, ((k,), (k, d), (k, d, d)))
    if not (np.allclose(covariance, covariance.swapaxes(1, 2), atol=0) and k and d):
        raise ValueError("a covariance is not symmetric")
    if not (np.linalg.eigvalsh(covariance) > 0).all():
        raise ValueError("a covariance is not positive definite")
    if not ((arrays["weight"] > 0).all() and abs(arrays["weight"].sum() - 1) < 1e-6):
        raise ValueError("the weights are no positive numbers of sum 1")
    return MixtureModel(
        str(data["space"]),
        **arrays,
        threshold=_finite(data["threshold"], "threshold"),
        threshold_rule=str(data["threshold_rule"]),
        count=int(data["count"]),
        provenance=str(data["provenance"]),
        threshold_interval=_interval_of(data),
        curve=_curve_of(data, 1),
    )


def _score_of(data: dict[str, Any]) -> ScoreModel:
    return ScoreModel(
        _finite(data["threshold"], "threshold"),
        str(data["provenance"]),
        _network_sum_of(data["with_network"]) if data.get("with_network") else None,
        str(data.get("threshold_rule", "")),
        _interval_of(data),
    )


def _network_sum_of(data: dict[str, Any]) -> NetworkSum:
    return NetworkSum(*(_finite(data[f.name], f.name) for f in fields(NetworkSum)))


def _evidence_of(data: dict[str, Any]) -> EvidenceModel:
    name, term, *numbers = EVIDENCE_COLUMNS
    rows = data["features"]
    knots, curves = (tuple(np.array(row[key], np.float64) for row in rows) for key in numbers)
    for own, curve in zip(knots, curves, strict=True):
        _check_shapes({"knots": own, "curve": curve}, ((len(own),), (len(own),)))
        if len(own) < 2 or not (np.diff(own) > 0).all():
            raise ValueError("a feature without two ascending knots")
    return EvidenceModel(
        tuple(str(row[name]) for row in rows),
        tuple(str(row[term]) for row in rows),
        knots,
        curves,
        shift=_finite(data["shift"], "shift"),
        threshold=_finite(data["accept"], "accept"),
        provenance=str(data["provenance"]),
        decision=_finite(data.get("decision", 0.0), "decision"),
        threshold_rule=str(data.get("threshold_rule", "")),
        threshold_interval=_interval_of(data),
        curve=_curve_of(data, 1),
    )


def _finite(value: Any, name: str) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}")
    return number


def _check_shapes(arrays: Mapping[str, NDArray[Any]], wanted: tuple[tuple[int, ...], ...]) -> None:
    for (name, array), shape in zip(arrays.items(), wanted, strict=True):
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name}: not finite numbers of shape {shape}, but of {array.shape}")


def _significant(values: NDArray[np.float64]) -> Any:
    """Nested lists with eight significant digits: covariances of small numbers stay positive definite."""
    if values.ndim:
        return [_significant(row) for row in values]
    return float(f"{values:.8g}")


def digest(text: str) -> str:
    """SHA-256 of a model's or settings' text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()
