"""Learned models evaluated on many rows: boosted trees, networks, Gaussian classes."""

from wayside.stages.classifiers.convolution import convolution_output
from wayside.stages.classifiers.gaussian import nearest_class, require_gaussian_model
from wayside.stages.classifiers.network import log_probabilities, network_outputs
from wayside.stages.classifiers.trees import log_odds

__all__ = [
    "convolution_output",
    "log_odds",
    "log_probabilities",
    "nearest_class",
    "network_outputs",
    "require_gaussian_model",
]
