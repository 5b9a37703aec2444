"""After the last frame: the path of the camera in the world frame and on the globe, and the signs on it."""

from wayside.stages.georeference.geodesy import LocalOrigin
from wayside.stages.georeference.georeferencing import georeference
from wayside.stages.georeference.linear_reference import ROUTE_REACH_M, measure_along_route
from wayside.stages.georeference.measurements import AbsoluteMeasurements, RelativeMotionChain
from wayside.stages.georeference.path import DrivePath, DriveRecord, PathPoint, StepScale, collect
from wayside.stages.georeference.placement import place_signs, scale_near
from wayside.stages.georeference.trajectory import smooth

__all__ = [
    "ROUTE_REACH_M",
    "AbsoluteMeasurements",
    "DrivePath",
    "DriveRecord",
    "LocalOrigin",
    "PathPoint",
    "RelativeMotionChain",
    "StepScale",
    "collect",
    "georeference",
    "measure_along_route",
    "place_signs",
    "scale_near",
    "smooth",
]
