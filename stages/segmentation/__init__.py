"""Two-pass K-means segmentation into connected regions (report chapters 2 and 3.1)."""

from wayside.stages.segmentation.palette import nearest_centers as nearest_centers
from wayside.stages.segmentation.two_pass import FACE_ROWS as FACE_ROWS
from wayside.stages.segmentation.two_pass import regions_before_gate as regions_before_gate
from wayside.stages.segmentation.two_pass import segment as segment
from wayside.stages.segmentation.two_pass import unsegmented as unsegmented
