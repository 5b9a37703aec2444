"""Feature vectors of regions: geometry and colour, and those of the box classifier."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.stages.detection.patch_features import patch_feature_names, patch_features
from wayside.stages.imaging import Pyramid, log_chromaticity

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
"""Angular size and position, fraction of the box that the region fills, its source, its mean colour."""

_AS_LEVEL = tuple(SOURCES.index(name) for name in ("network", "external", "predicted"))
"""Sources that the classifiers know as `level`: they were learned before there were these."""


def region_features(regions: Regions, camera: Camera) -> NDArray[np.float32]:
    """Size, position and colour of each region: (n, 11). Sizes and positions are tangents of angles."""
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
        np.where(np.isin(regions.source, _AS_LEVEL), SOURCES.index("level"), regions.source),
        log_chromaticity(regions.rgb),
    ]
    return np.column_stack(columns).astype(np.float32)


def box_feature_names() -> tuple[str, ...]:
    """Names of the columns of `box_features`, in order."""
    return (*REGION_FEATURES, *patch_feature_names())


def box_features(levels: Pyramid, regions: Regions, camera: Camera) -> NDArray[np.float32]:
    """Features of the box classifier: (n, features), in the order of `box_feature_names`."""
    return np.concatenate(
        [region_features(regions, camera), patch_features(levels, regions.box)], axis=1
    )


@cache
def feature_columns(names: tuple[str, ...]) -> NDArray[np.int64]:
    """Columns (k,) of `box_features` that have these names."""
    column = {name: k for k, name in enumerate(box_feature_names())}
    return np.array([column[name] for name in names], np.int64)


def require_names(
    what: str, found: tuple[str, ...], known: tuple[str, ...], *, exact: bool = False
) -> None:
    """Refuse a model with a feature or output that is not `known`; exact: found must equal known.

    Raises
    ------
    InputError
        Naming the model (`what`), what was wanted and what was found.
    """
    unknown = sorted(set(found) - set(known))
    if exact and found != known:
        raise InputError(
            f"{what}: wanted {', '.join(known)}, found {', '.join(found)}; learn it again"
        )
    if unknown:
        raise InputError(
            f"{what}: wanted known features and classes, found {unknown[0]!r}; learn it again"
        )
