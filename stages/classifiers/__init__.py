"""Learned models evaluated on many rows: networks, Gaussian classes."""

from wayside.stages.classifiers.gaussian import nearest_class, require_gaussian_model
from wayside.stages.classifiers.onnx_network import NetworkInput, OnnxNetwork

__all__ = [
    "NetworkInput",
    "OnnxNetwork",
    "nearest_class",
    "require_gaussian_model",
]
