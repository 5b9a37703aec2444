"""What a region tells without another look at the picture: size, place and mean colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import Regions
from wayside.schemas.frame import Camera
from wayside.stages.imaging import to_space

REGION_FEATURES = (
    "log_height",
    "log_width",
    "log_aspect",
    "up",
    "right",
    "beside",
    "fill",
    "source",
    "region_brightness",
    "region_red_green",
    "region_blue_green",
)
"""Angular size and place, share of the box that the region fills, where it came from, its mean colour."""


def region_features(regions: Regions, camera: Camera) -> NDArray[np.float32]:
    """Size, place and colour of each region: (n, 11). Sizes and places are angles (tangents), whatever the camera."""
    box = regions.box.astype(np.float64)
    width, height = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
    middle = (box[:, :2] + box[:, 2:] - 1) / 2
    right = (middle[:, 0] - camera.cx) / camera.fx
    columns = [
        np.log(height / camera.fy),
        np.log(width / camera.fx),
        np.log((width / camera.fx) / (height / camera.fy)),
        (camera.cy - middle[:, 1]) / camera.fy,
        right,
        np.abs(right),
        regions.area_px / (width * height),
        regions.source,
        to_space(regions.rgb, "log_chromaticity"),
    ]
    return np.column_stack(columns).astype(np.float32)
