"""Names of the arrays that travel through the renderer."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
"""Geometry: metres, radians, pixels."""

Singles: TypeAlias = NDArray[np.float32]
"""Light: linear RGB or premultiplied RGBA, row 0 at the top."""

Bytes: TypeAlias = NDArray[np.uint8]
"""Finished images (BGR), painted sign faces (RGB), coverage and labels."""
