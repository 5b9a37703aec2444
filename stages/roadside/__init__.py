"""The ground and the painted lines beside the path: swept while the images are held, placed when the drive is over."""

from wayside.stages.roadside.profile import on_road, place_sections
from wayside.stages.roadside.sweep import HELD_IMAGES, RoadsideRecord, sweep_roadside

__all__ = ["HELD_IMAGES", "RoadsideRecord", "on_road", "place_sections", "sweep_roadside"]
