"""Learned models evaluated on many rows: boosted trees, networks, Gaussian classes."""

from wayside.stages.classifiers.convolution import convolved
from wayside.stages.classifiers.gaussian import check_model, nearest_class
from wayside.stages.classifiers.network import log_chances, outputs
from wayside.stages.classifiers.trees import log_odds

__all__ = [
    "check_model",
    "convolved",
    "log_chances",
    "log_odds",
    "nearest_class",
    "outputs",
]
