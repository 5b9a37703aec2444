"""After the last frame: the path of the camera in the world frame and on the globe, and the signs on it."""

from wayside.stages.georeference.geodesy import LocalOrigin as LocalOrigin
from wayside.stages.georeference.georeferencing import georeference as georeference
from wayside.stages.georeference.linear_reference import ROUTE_REACH_M as ROUTE_REACH_M
from wayside.stages.georeference.linear_reference import measure_along_route as measure_along_route
from wayside.stages.georeference.linear_reference import measures_on_lines as measures_on_lines
from wayside.stages.georeference.measurements import AbsoluteMeasurements as AbsoluteMeasurements
from wayside.stages.georeference.measurements import RelativeMotionChain as RelativeMotionChain
from wayside.stages.georeference.path import DrivePath as DrivePath
from wayside.stages.georeference.path import DriveRecord as DriveRecord
from wayside.stages.georeference.path import PathPoint as PathPoint
from wayside.stages.georeference.path import StepScale as StepScale
from wayside.stages.georeference.path import collect as collect
from wayside.stages.georeference.placement import place_signs as place_signs
from wayside.stages.georeference.placement import scale_near as scale_near
from wayside.stages.georeference.trajectory import smooth as smooth
