"""What only the report's own chain needs: colour and shape gates, SIFT matching (chapters 3 to 5)."""

from wayside.stages.report.color import classify_color
from wayside.stages.report.fourier import TERMS, fourier_descriptors
from wayside.stages.report.match import match_by_descriptors
from wayside.stages.report.outline import SAMPLES, traced_sequences
from wayside.stages.report.shape import classify_shape, outlines_of, region_descriptors
from wayside.stages.report.sift import extract_sift

__all__ = [
    "SAMPLES",
    "TERMS",
    "classify_color",
    "classify_shape",
    "extract_sift",
    "fourier_descriptors",
    "match_by_descriptors",
    "outlines_of",
    "region_descriptors",
    "traced_sequences",
]
