"""Learned models evaluated on many rows: networks, Gaussian classes, mixtures, evidence; their thresholds."""

from wayside.stages.classifiers.evidence import evidence_ratios
from wayside.stages.classifiers.gaussian import (
    class_distances,
    log_density,
    nearest_class,
    require_gaussian_model,
)
from wayside.stages.classifiers.onnx_network import NetworkInput, OnnxNetwork
from wayside.stages.classifiers.operating_points import at_alpha, most_powerful

__all__ = [
    "NetworkInput",
    "OnnxNetwork",
    "at_alpha",
    "class_distances",
    "evidence_ratios",
    "log_density",
    "most_powerful",
    "nearest_class",
    "require_gaussian_model",
]
