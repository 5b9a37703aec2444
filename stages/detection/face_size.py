"""Which boxes have the size of a sign face."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera
from wayside.schemas.settings import CandidateSettings


def enlargement(camera: Camera, settings: CandidateSettings) -> int:
    """How many times as large the images of a camera are seen: 1 for most, 2, or 4 at most."""
    return next((k for k in (1, 2) if k * camera.fy >= settings.shortest_focal_px), 4)


def fits_face(
    box: NDArray[np.floating[Any]], camera: Camera, settings: CandidateSettings
) -> NDArray[np.bool_]:
    """Which boxes (n, 4) in images of a camera have the height and the aspect of a face: (n,)."""
    wide, tall = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
    return np.asarray(
        (enlargement(camera, settings) * tall >= settings.shortest_px)
        & (wide >= settings.narrowest_aspect * tall)
        & (wide <= settings.widest_aspect * tall)
    )
