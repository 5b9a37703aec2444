"""What the road and its signs are like together: how far signs of one type stand apart, and how the road curves."""

from wayside.stages.roadside.spacing import measure_spacing

__all__ = ["measure_spacing"]
