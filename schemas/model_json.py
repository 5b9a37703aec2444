"""Model files: readable, versioned JSON, never pickled.

Some keys of the files bear older names than the attributes here: `accept` is `TreeModel.threshold` and a tree's
`threshold` its `split`, `gate` is `prefilter`, `closer` is `patch_cnn`; of a convolution `near` is `tree_threshold`,
`trees_part` is `tree_weight`, `halved` is `pooled`, `farthest` is `feature_limit`, as in a network.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.models import (
    FEATURE_LIMIT,
    ConvolutionModel,
    EvidenceModel,
    GaussianClass,
    GaussianModel,
    LinearModel,
    Model,
    NetworkModel,
    TreeModel,
)

NETWORK_ARRAYS = ("mean", "scale", "hidden", "hidden_bias", "output", "output_bias")
EVIDENCE_COLUMNS = ("name", "term", "low", "high", "middle", "weight")
Part = TypeVar("Part", TreeModel, NetworkModel, ConvolutionModel)


def model_to_json(model: Model) -> str:
    """The model as text, stable byte for byte."""
    if isinstance(model, GaussianModel):
        body: dict[str, Any] = {
            "space": model.space,
            "classes": [
                {
                    "name": c.name,
                    "mean": np.round(c.mean, 6).tolist(),
                    "covariance": np.round(c.covariance, 8).tolist(),
                    "threshold": round(c.threshold, 4),
                    "threshold_rule": c.threshold_rule,
                    "count": c.count,
                }
                for c in model.classes
            ],
        }
    elif isinstance(model, LinearModel):
        weights = [float(f"{w:.6g}") for w in model.weights]
        body = {"weights": dict(zip(model.features, weights, strict=True))}
    elif isinstance(model, NetworkModel):
        body = {"features": list(model.features), "classes": list(model.classes)}
        if model.feature_limit != FEATURE_LIMIT:
            body["farthest"] = model.feature_limit
        body |= {name: _rounded(getattr(model, name)) for name in NETWORK_ARRAYS}
    elif isinstance(model, ConvolutionModel):
        body = {"features": list(model.features), "side": model.side, "near": model.tree_threshold}
        body |= {"trees_part": model.tree_weight, "farthest": model.feature_limit}
        body |= {"halved": list(model.pooled)}
        body |= {
            name: [_rounded(a) for a in getattr(model, name)] for name in ("filters", "biases")
        }
        body |= {name: _rounded(getattr(model, name)) for name in NETWORK_ARRAYS}
    elif isinstance(model, EvidenceModel):
        columns = (model.low, model.high, model.middle, model.weight)
        rows = zip(
            model.features, model.terms, *(column.tolist() for column in columns), strict=True
        )
        body = {
            "features": [dict(zip(EVIDENCE_COLUMNS, row, strict=True)) for row in rows],
            "shift": model.shift,
            "accept": model.threshold,
        }
    else:
        parts = {"gate": model.prefilter, "network": model.network, "closer": model.patch_cnn}
        body = {
            name: None if part is None else json.loads(model_to_json(part))
            for name, part in parts.items()
        }
        body |= {
            "features": list(model.features),
            "bias": model.bias,
            "accept": model.threshold,
            "trees": [
                {
                    "feature": model.feature[t].tolist(),
                    "threshold": [float(f"{v:.7g}") for v in model.split[t]],
                    "left": model.left[t].tolist(),
                    "right": model.right[t].tolist(),
                    "value": [float(f"{v:.6g}") for v in model.value[t]],
                }
                for t in range(len(model.feature))
            ],
        }
    head = {"schema_version": 1, "kind": model.kind, "provenance": model.provenance}
    return json.dumps(head | body, separators=(",", ":"), indent=None) + "\n"


def model_from_json(text: str, name: str = "model") -> Model:
    """Read a model; raises InputError with the name where the text is not one."""
    try:
        data = json.loads(text)
        if data["kind"] == "gaussian":
            return GaussianModel(
                data["space"],
                tuple(
                    GaussianClass(
                        c["name"],
                        np.array(c["mean"], np.float64),
                        np.array(c["covariance"], np.float64),
                        float(c["threshold"]),
                        c["threshold_rule"],
                        int(c["count"]),
                    )
                    for c in data["classes"]
                ),
                data["provenance"],
            )
        if data["kind"] == "trees":
            trees = data["trees"]

            def column(key: str, kind: type) -> NDArray[Any]:
                return np.array([t[key] for t in trees], kind)

            return TreeModel(
                tuple(data["features"]),
                float(data["bias"]),
                column("feature", np.int32),
                column("threshold", np.float32),
                column("left", np.int32),
                column("right", np.int32),
                column("value", np.float32),
                float(data["accept"]),
                data["provenance"],
                _part_of(TreeModel, data.get("gate"), name),
                _part_of(NetworkModel, data.get("network"), name),
                _part_of(ConvolutionModel, data.get("closer"), name),
            )
        if data["kind"] == "linear":
            weights = {str(name): float(weight) for name, weight in data["weights"].items()}
            return LinearModel(tuple(weights), np.array(list(weights.values())), data["provenance"])
        if data["kind"] == "evidence":
            return _evidence_of(data)
        if data["kind"] == "network":
            return _network_of(data)
        if data["kind"] == "convolution":
            return _convolution_of(data)
        raise KeyError(f"kind {data['kind']!r}")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: wanted a wayside model file, found {type(error).__name__}: {error}; "
            "write one with the learning script or leave the setting out for the model that ships"
        ) from error


def _part_of(kind: type[Part], data: dict[str, Any] | None, name: str) -> Part | None:
    if data is None:
        return None
    part = model_from_json(json.dumps(data), name)
    if not isinstance(part, kind):
        raise TypeError(f"a part of kind {part.kind!r}, wanted {kind.kind!r}")
    return part


def _network_of(data: dict[str, Any]) -> NetworkModel:
    arrays = {name: np.array(data[name], np.float32) for name in NETWORK_ARRAYS}
    f, c = len(data["features"]), len(data["classes"])
    h = arrays["hidden_bias"].size
    _check_shapes(arrays, ((f,), (f,), (f, h), (h,), (h, c), (c,)))
    return NetworkModel(
        tuple(data["features"]),
        tuple(data["classes"]),
        **arrays,
        provenance=data["provenance"],
        feature_limit=float(data.get("farthest", FEATURE_LIMIT)),
    )


def _evidence_of(data: dict[str, Any]) -> EvidenceModel:
    name, term, *numbers = EVIDENCE_COLUMNS
    rows = data["features"]
    return EvidenceModel(
        tuple(str(row[name]) for row in rows),
        tuple(str(row[term]) for row in rows),
        **{key: np.array([row[key] for row in rows], np.float64) for key in numbers},
        shift=float(data["shift"]),
        threshold=float(data["accept"]),
        provenance=data["provenance"],
    )


def _convolution_of(data: dict[str, Any]) -> ConvolutionModel:
    arrays = {name: np.array(data[name], np.float32) for name in NETWORK_ARRAYS}
    filters = tuple(np.array(a, np.float32) for a in data["filters"])
    biases = tuple(np.array(a, np.float32) for a in data["biases"])
    pooled, side = tuple(bool(h) for h in data["halved"]), int(data["side"])
    outs = [a.shape[-1] for a in filters]
    ins = [filters[0].shape[2], *outs[:-1]]
    for k, (array, bias) in enumerate(zip(filters, biases, strict=True)):
        named = {f"filters {k}": array, f"biases {k}": bias}
        _check_shapes(named, ((3, 3, ins[k], outs[k]), (outs[k],)))
    f, h = len(data["features"]), arrays["hidden_bias"].size
    if side % 2 ** sum(pooled) or len(pooled) != len(filters):
        raise ValueError(f"a side of {side} pooled {sum(pooled)} times in {len(filters)} layers")
    samples = (side // 2 ** sum(pooled)) ** 2 * outs[-1]
    _check_shapes(arrays, ((f,), (f,), (samples + f, h), (h,), (h,), ()))
    return ConvolutionModel(
        tuple(data["features"]),
        side,
        float(data["near"]),
        float(data["trees_part"]),
        float(data["farthest"]),
        filters,
        biases,
        pooled,
        **arrays,
        provenance=data["provenance"],
    )


def _check_shapes(
    arrays: dict[str, NDArray[np.float32]], wanted: tuple[tuple[int, ...], ...]
) -> None:
    for (name, array), shape in zip(arrays.items(), wanted, strict=True):
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name} of shape {array.shape}, wanted {shape}, finite")


def _rounded(values: NDArray[np.float32]) -> Any:
    if values.ndim == 0:
        return float(f"{values:.5g}")
    if values.ndim > 1:
        return [_rounded(row) for row in values]
    return [float(f"{v:.5g}") for v in values]


def digest(text: str) -> str:
    """SHA-256 of a model's or settings' text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()
