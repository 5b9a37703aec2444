"""Learned numbers as readable, versioned JSON: colours, shapes, places, judges. Never pickled."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError


@dataclass(frozen=True, slots=True)
class GaussianClass:
    """One class: mean (d,), covariance (d, d), the distance up to which it is accepted, and the rule for that."""

    name: str
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    threshold: float
    threshold_rule: str
    count: int


@dataclass(frozen=True, slots=True)
class GaussianModel:
    """Classes told apart by Mahalanobis distance (report eq. 3.1), in the named space."""

    kind: ClassVar[str] = "gaussian"
    space: str
    classes: tuple[GaussianClass, ...]
    provenance: str

    def distances(self, values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Mahalanobis distance of each value (n, d) to each class: (n, classes), eq. 3.1."""
        result = np.empty((len(values), len(self.classes)))
        for j, one in enumerate(self.classes):
            gap = np.asarray(values, np.float64) - one.mean
            result[:, j] = np.sqrt(
                np.einsum("ni,ij,nj->n", gap, np.linalg.inv(one.covariance), gap)
            )
        return result


@dataclass(frozen=True, slots=True)
class TreeModel:
    """Boosted binary trees over named features; the sum over trees plus `bias` is a log odds.

    feature, left, right (trees, nodes) int32; threshold, value (trees, nodes) float32. A node with
    left < 0 is a leaf. A value goes left where it is at most the threshold, and also where it is nan.
    gate: a smaller model over cheaper features that is asked first; what it does not accept goes no further. network:
    one over the same features whose only output is added to the sum. closer: looks at the pixels of what is near enough
    to a face for it; the log odds are then those of both.
    """

    kind: ClassVar[str] = "trees"
    features: tuple[str, ...]
    bias: float
    feature: NDArray[np.int32]
    threshold: NDArray[np.float32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    value: NDArray[np.float32]
    accept: float
    provenance: str
    gate: TreeModel | None = None
    network: NetworkModel | None = None
    closer: ConvolutionModel | None = None


@dataclass(frozen=True, slots=True)
class NetworkModel:
    """Network with one hidden layer over named features: relu(z W + b) V + c, z the scaled features.

    classes (c,): what the outputs tell, or what their softmax is the chances of; mean, scale (f,):
    z = (x - mean) / scale; hidden (f, h) = W, hidden_bias (h,) = b, output (h, c) = V, output_bias (c,) = c; float32.
    """

    kind: ClassVar[str] = "network"
    features: tuple[str, ...]
    classes: tuple[str, ...]
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    hidden: NDArray[np.float32]
    hidden_bias: NDArray[np.float32]
    output: NDArray[np.float32]
    output_bias: NDArray[np.float32]
    provenance: str


@dataclass(frozen=True, slots=True)
class ConvolutionModel:
    """Convolutional network over a square patch and named features, with one output.

    side: samples of the patch each way; near: log odds of the trees from which it is asked; trees_part: what they are
    multiplied by before they are added. filters, biases: of each layer (3, 3, in, out) and (out,); halved: which are
    followed by the largest of each 2 x 2. mean, scale (f,): features enter as (x - mean) / scale, at most `farthest`
    from zero. hidden (m + f, h), hidden_bias (h,), output (h,), output_bias (): what stands behind the m samples of the
    last layer and the features; float32.
    """

    kind: ClassVar[str] = "convolution"
    features: tuple[str, ...]
    side: int
    near: float
    trees_part: float
    farthest: float
    filters: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    halved: tuple[bool, ...]
    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    hidden: NDArray[np.float32]
    hidden_bias: NDArray[np.float32]
    output: NDArray[np.float32]
    output_bias: NDArray[np.float32]
    provenance: str


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Weights (f,) float64 of named features: the value of a candidate is their weighted sum."""

    kind: ClassVar[str] = "linear"
    features: tuple[str, ...]
    weights: NDArray[np.float64]
    provenance: str

    def values(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (n,) of candidates with features (n, f)."""
        return np.asarray(features @ self.weights, np.float64)


NETWORK_ARRAYS = ("mean", "scale", "hidden", "hidden_bias", "output", "output_bias")

Model = GaussianModel | TreeModel | NetworkModel | ConvolutionModel | LinearModel
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
        body |= {name: _rounded(getattr(model, name)) for name in NETWORK_ARRAYS}
    elif isinstance(model, ConvolutionModel):
        body = {"features": list(model.features), "side": model.side, "near": model.near}
        body |= {"trees_part": model.trees_part, "farthest": model.farthest}
        body |= {"halved": list(model.halved)}
        body |= {
            name: [_rounded(a) for a in getattr(model, name)] for name in ("filters", "biases")
        }
        body |= {name: _rounded(getattr(model, name)) for name in NETWORK_ARRAYS}
    else:
        parts = {"gate": model.gate, "network": model.network, "closer": model.closer}
        body = {
            name: None if part is None else json.loads(model_to_json(part))
            for name, part in parts.items()
        }
        body |= {
            "features": list(model.features),
            "bias": model.bias,
            "accept": model.accept,
            "trees": [
                {
                    "feature": model.feature[t].tolist(),
                    "threshold": [float(f"{v:.7g}") for v in model.threshold[t]],
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
        tuple(data["features"]), tuple(data["classes"]), **arrays, provenance=data["provenance"]
    )


def _convolution_of(data: dict[str, Any]) -> ConvolutionModel:
    arrays = {name: np.array(data[name], np.float32) for name in NETWORK_ARRAYS}
    filters = tuple(np.array(a, np.float32) for a in data["filters"])
    biases = tuple(np.array(a, np.float32) for a in data["biases"])
    halved, side = tuple(bool(h) for h in data["halved"]), int(data["side"])
    outs = [a.shape[-1] for a in filters]
    ins = [filters[0].shape[2], *outs[:-1]]
    for k, (array, bias) in enumerate(zip(filters, biases, strict=True)):
        named = {f"filters {k}": array, f"biases {k}": bias}
        _check_shapes(named, ((3, 3, ins[k], outs[k]), (outs[k],)))
    f, h = len(data["features"]), arrays["hidden_bias"].size
    if side % 2 ** sum(halved) or len(halved) != len(filters):
        raise ValueError(f"a side of {side} halved {sum(halved)} times in {len(filters)} layers")
    samples = (side // 2 ** sum(halved)) ** 2 * outs[-1]
    _check_shapes(arrays, ((f,), (f,), (samples + f, h), (h,), (h,), ()))
    return ConvolutionModel(
        tuple(data["features"]),
        side,
        float(data["near"]),
        float(data["trees_part"]),
        float(data["farthest"]),
        filters,
        biases,
        halved,
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
