"""Two-pass K-means segmentation into connected regions (report chapters 2 and 3.1)."""

from wayside.stages.segmentation.palette import difference_image
from wayside.stages.segmentation.two_pass import regions_before_gate, segment, unsegmented

__all__ = [
    "difference_image",
    "regions_before_gate",
    "segment",
    "unsegmented",
]
