"""Model files: readable, versioned JSON, never pickled. The keys are the fields of the model's class.

Three things are written for people: operating points as rows of numbers, weights by the name of their feature, and
evidence as one object a feature. `accept` is the `threshold` of evidence, whose older name it is.
"""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from wayside.pipeline.files.parsing import CONTENT_FAULTS
from wayside.schemas import models
from wayside.schemas.errors import InputError

_KINDS: dict[str, type[Any]] = {kind.kind: kind for kind in get_args(models.Model)}
_EVIDENCE = {"name": "features", "term": "terms", "knots": "knots", "curve": "curves"}
"""Field of each key of a feature of evidence."""


def model_to_json(model: models.Model) -> str:
    """The model as text, every number in full, stable byte for byte."""
    body = _plain(model)
    if isinstance(model, models.LinearModel):
        body = body | {"weights": dict(zip(body.pop("features"), body["weights"], strict=True))}
    elif isinstance(model, models.EvidenceModel):
        rows = zip(*(body.pop(field) for field in _EVIDENCE.values()), strict=True)
        features = [dict(zip(_EVIDENCE, row, strict=True)) for row in rows]
        named = {"accept" if field == "threshold" else field: body[field] for field in body}
        body = {"features": features} | named
    head = {"schema_version": 1, "kind": model.kind, "provenance": body.pop("provenance")}
    return json.dumps(head | body, separators=(",", ":")) + "\n"


def _plain(value: Any) -> Any:
    """A value in types of JSON; fields with their default are left out."""
    if isinstance(value, models.OperatingPoint):
        return [value.false_alarm, value.power, value.threshold, *(value.interval or ())]
    if is_dataclass(value):
        known = [(f, getattr(value, f.name)) for f in fields(value) if f.init]
        return {f.name: _plain(v) for f, v in known if f.default is MISSING or v != f.default}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def model_from_json(text: str, name: str = "model") -> models.Model:
    """Read a model, every number and link of it checked; raises InputError with the name where the text is not one."""
    try:
        data = json.loads(text)
        kind = _KINDS[data["kind"]]
        if kind is models.LinearModel:
            names, weights = zip(*data["weights"].items(), strict=True)
            data |= {"features": names, "weights": weights}
        elif kind is models.EvidenceModel:
            columns = {
                field: [row[k] for row in data["features"]] for k, field in _EVIDENCE.items()
            }
            data |= columns | {"threshold": data["accept"]}
        model: models.Model = _built(kind, data)
        # frozen, and no argument of its kind
        object.__setattr__(model, "text_digest", digest(text))
    except (*CONTENT_FAULTS, RecursionError) as error:
        raise InputError(
            f"{name}: this is not a model file of wayside: {type(error).__name__}: {error}. Write one with the "
            "learning script, or leave the setting out to use the model that ships."
        ) from error
    return model


def _built(kind: type[Any], data: dict[str, Any]) -> Any:
    """A model, or a part of one; raises one of `CONTENT_FAULTS` for anything else."""
    names = {field.name for field in fields(kind) if field.init}
    made = kind(**{name: _READERS[name](value) for name, value in data.items() if name in names})
    if kind in _CHECKS:
        _CHECKS[kind](made)
    return made


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} is not finite")
    return number


def _array(value: Any) -> NDArray[np.float64]:
    array = np.array(value, np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    return array


def _interval(value: Any) -> tuple[float, float]:
    low, high = map(_finite, value)
    return low, high


def _point(row: Any) -> models.OperatingPoint:
    """Of two rates, the threshold, then both ends of its interval or none."""
    false_alarm, power, threshold, *ends = map(_finite, row)
    if len(ends) not in (0, 2) or not 0 <= false_alarm <= 1 >= power >= 0:
        raise ValueError(f"curve: {row} is not two rates, a threshold, and its interval")
    return models.OperatingPoint(false_alarm, power, threshold, _interval(ends) if ends else None)


def _tuple_of(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda values: tuple(read(value) for value in values)


_READERS: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("name", "space", "provenance", "threshold_rule"), str),
    **dict.fromkeys(("threshold", "shift", "decision", "own", "network"), _finite),
    **dict.fromkeys(("mean", "covariance", "weight", "weights"), _array),
    **dict.fromkeys(("features", "terms"), _tuple_of(str)),
    **dict.fromkeys(("knots", "curves"), _tuple_of(_array)),
    **dict.fromkeys(("count", "signs"), int),
    "threshold_interval": _interval,
    "with_network": lambda data: _built(models.NetworkSum, data),
    **dict.fromkeys(
        ("classes", "background"), _tuple_of(lambda data: _built(models.GaussianClass, data))
    ),
    "curve": _tuple_of(_point),
}
"""How each field is read; a name means the same in every model."""


def _check_mixture(model: models.MixtureModel) -> None:
    k, d = model.mean.shape
    _check_covariance(model.covariance, (k, d, d))
    sums = [model.weight[: model.signs].sum(), model.weight[model.signs :].sum()]
    if model.weight.shape != (k,) or not ((model.weight > 0).all() and np.allclose(sums, 1)):
        raise ValueError("the weights are not positive numbers of sum 1 on both sides")


def _check_evidence(model: models.EvidenceModel) -> None:
    for knots, curve in zip(model.knots, model.curves, strict=True):
        if knots.shape != curve.shape or len(knots) < 2 or not (np.diff(knots) > 0).all():
            raise ValueError("a feature without two ascending knots and a value at each")


def _check_covariance(covariance: NDArray[np.float64], shape: tuple[int, ...]) -> None:
    symmetric = covariance.shape == shape and np.allclose(covariance, covariance.swapaxes(-1, -2))
    if not (covariance.size and symmetric and (np.linalg.eigvalsh(covariance) > 0).all()):
        raise ValueError(f"a covariance is not positive definite, of shape {shape}")


_CHECKS: dict[type[Any], Callable[[Any], None]] = {
    models.GaussianClass: lambda one: _check_covariance(one.covariance, 2 * one.mean.shape),
    models.MixtureModel: _check_mixture,
    models.EvidenceModel: _check_evidence,
}


def digest(text: str) -> str:
    """SHA-256 of a model's or settings' text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()
