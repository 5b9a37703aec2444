"""Learned models evaluated on many rows: networks, Gaussian classes, mixtures, evidence; their thresholds."""

from wayside.stages.classifiers.decisions import (
    at_alpha,
    class_distances,
    evidence_ratios,
    log_normals,
    log_ratio,
    log_ratios,
    most_powerful,
    nearest_class,
)
from wayside.stages.classifiers.onnx_network import NetworkInput, OnnxNetwork, providers

__all__ = [
    "NetworkInput",
    "OnnxNetwork",
    "at_alpha",
    "class_distances",
    "evidence_ratios",
    "log_normals",
    "log_ratio",
    "log_ratios",
    "most_powerful",
    "nearest_class",
    "providers",
]
