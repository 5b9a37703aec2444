"""Bounding-box regression: the boxes of candidates moved onto the faces that they overlap.

A region covers only part of a face where the face has several colours, or where a side of it resembles the background.
A network on the features of the box and its surroundings predicts how far each side of the face lies from that of the
box (Girshick et al. 2014, appendix C).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.detections import SOURCES, Regions
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.classifiers import network_outputs
from wayside.stages.detection.feature_vectors import feature_columns

SIDES = ("left", "top", "right", "bottom")
"""Outputs of the network: how far that side of the face lies right of or below that of the box, in box sizes."""


def regressed_regions(
    network: NetworkModel,
    values: NDArray[np.float32],
    regions: Regions,
    settings: CandidateSettings,
    camera: Camera | None = None,
) -> Regions:
    """The regions (source `moved`) with the boxes that the network predicts from their `box_features`.

    Boxes end at the border of the camera's image, where one is given; those that would be too small or of an aspect
    that no face has stay as they are.
    """
    columns = np.ascontiguousarray(values[:, feature_columns(network.features)])
    box = regions.box
    size = box[:, 2:] - box[:, :2]
    offset = np.clip(
        network_outputs(network, columns), -settings.largest_offset, settings.largest_offset
    )
    moved = (box + offset * size[:, [0, 1, 0, 1]]).astype(np.float32)
    if camera is not None:
        moved = np.clip(moved, 0, np.array([camera.width, camera.height] * 2, np.float32))
    moved = np.where(settings.fits_face(moved)[:, None], moved, box)
    source = np.full(len(regions), SOURCES.index("moved"), np.uint8)
    return replace(regions, box=moved, source=source)
