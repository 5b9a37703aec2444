"""Where a face ends: the boxes of candidates moved onto the face that they lie on.

A region shows only part of a face where the face has several colours, or where a side of it looks like what stands
behind. A network that sees the box and its surroundings says how far each side of the face lies from that of the box
(bounding-box regression: Girshick et al. 2014, appendix C).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera
from wayside.schemas.models import NetworkModel
from wayside.stages.classifiers import outputs
from wayside.stages.detection.proposals import NARROWEST, SHORTEST_PX, WIDEST

SIDES = ("left", "top", "right", "bottom")
"""What the network tells: how far that side of the face lies right of or below that of the box, in box sizes."""

FARTHEST = 1.5
"""Sides farther away, in box sizes, are neither taught nor believed."""


def check_box_network(network: NetworkModel, names: tuple[str, ...]) -> None:
    """Refuse a network that looks at other features than `names` or does not tell the sides; raises InputError."""
    strange = sorted(set(network.features) - set(names))
    if strange or network.classes != SIDES:
        raise InputError(
            f"box network: wanted known features and the outputs {', '.join(SIDES)}, found "
            f"{strange[0] if strange else ', '.join(network.classes)}; learn it again"
        )


def moved_boxes(
    network: NetworkModel,
    values: NDArray[np.float32],
    box: NDArray[np.float32],
    camera: Camera | None = None,
) -> NDArray[np.float32]:
    """The boxes (n, 4) where the network sees the face; those that would be no box of a face any more stay.

    values (n, features) float32: what the network looks at, its columns. Moved boxes end at the border of the camera's
    picture, where one is given.
    """
    size = box[:, 2:] - box[:, :2]
    by = np.clip(outputs(network, values), -FARTHEST, FARTHEST)
    moved = (box + by * size[:, [0, 1, 0, 1]]).astype(np.float32)
    if camera is not None:
        moved = np.clip(moved, 0, np.array([camera.width, camera.height] * 2, np.float32))
    wide, tall = moved[:, 2] - moved[:, 0], moved[:, 3] - moved[:, 1]
    fits = (tall >= SHORTEST_PX) & (wide >= NARROWEST * tall) & (wide <= WIDEST * tall)
    return np.where(fits[:, None], moved, box)
