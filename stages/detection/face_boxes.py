"""Which boxes of an image can show the face of a sign, by size and aspect."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayside.schemas.frame import Camera

NARROWEST, WIDEST = 0.2, 6.5
"""Width over height of a face (chosen by hand)."""
SHORTEST_PX = 8
"""Height of the smallest face searched for, in images of `SHORTEST_FOCAL_PX` and more, px (chosen by hand)."""
SHORTEST_FOCAL_PX = 500.0
"""Images of a shorter focal length are seen twice as large, of half of it four times: at half size, 360 to 450 px, four
real drives gain 7 of 48 signs by it; at three quarters 1, and false rows."""


def enlargement(camera: Camera) -> int:
    """How many times as large the images of a camera are seen: 1 for most, 2, or 4 at most."""
    return next((k for k in (1, 2) if k * camera.fy >= SHORTEST_FOCAL_PX), 4)


def fits_face(box: NDArray[np.floating[Any]], camera: Camera) -> NDArray[np.bool_]:
    """Which boxes (n, 4) in images of a camera have the height and the aspect of a face."""
    wide, tall = box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]
    aspect = (wide >= NARROWEST * tall) & (wide <= WIDEST * tall)
    return np.asarray(aspect & (enlargement(camera) * tall >= SHORTEST_PX))
