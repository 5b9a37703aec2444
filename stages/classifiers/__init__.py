"""Learned models evaluated on many rows: networks, Gaussian classes."""

from wayside.stages.classifiers.gaussian import nearest_class, require_gaussian_model
from wayside.stages.classifiers.onnx_network import OnnxNetwork

__all__ = [
    "OnnxNetwork",
    "nearest_class",
    "require_gaussian_model",
]
