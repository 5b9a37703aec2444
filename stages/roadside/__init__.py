"""What is beside the road: the ground and the painted lines, swept while the images are held; the spacing of signs."""

from wayside.stages.roadside.profile import on_road, place_sections
from wayside.stages.roadside.spacing import measure_spacing
from wayside.stages.roadside.sweep import HELD_IMAGES, Sweep, sweep_roadside

__all__ = ["HELD_IMAGES", "Sweep", "measure_spacing", "on_road", "place_sections", "sweep_roadside"]
