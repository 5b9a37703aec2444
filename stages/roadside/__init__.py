"""The roadside: the ground and the painted lines, swept while the images are held, and the spacing of signs."""

from wayside.stages.roadside.profile import on_road as on_road
from wayside.stages.roadside.profile import place_sections as place_sections
from wayside.stages.roadside.spacing import measure_spacing as measure_spacing
from wayside.stages.roadside.sweep import HELD_IMAGES as HELD_IMAGES
from wayside.stages.roadside.sweep import Sweep as Sweep
from wayside.stages.roadside.sweep import sweep_roadside as sweep_roadside
