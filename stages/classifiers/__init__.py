"""Learned models evaluated on many rows: networks, Gaussian classes, mixtures, evidence; their thresholds."""

from wayside.stages.classifiers.decisions import at_alpha as at_alpha
from wayside.stages.classifiers.decisions import class_distances as class_distances
from wayside.stages.classifiers.decisions import evidence_ratios as evidence_ratios
from wayside.stages.classifiers.decisions import log_normals as log_normals
from wayside.stages.classifiers.decisions import log_ratio as log_ratio
from wayside.stages.classifiers.decisions import log_ratios as log_ratios
from wayside.stages.classifiers.decisions import most_powerful as most_powerful
from wayside.stages.classifiers.decisions import nearest_class as nearest_class
from wayside.stages.classifiers.onnx_network import NetworkInput as NetworkInput
from wayside.stages.classifiers.onnx_network import OnnxNetwork as OnnxNetwork
from wayside.stages.classifiers.onnx_network import providers as providers
