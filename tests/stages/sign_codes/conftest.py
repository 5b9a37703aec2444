"""A landmark as the tests of this room take it."""

import numpy as np
import pytest

from ...made_landmarks import made_landmark


@pytest.fixture
def landmark():
    """One whose face nothing classified yet."""
    unknown = dict.fromkeys(("color_distance", "shape_distance"), np.nan)
    return made_landmark(views=(), height_m=0.76, color="white", shape="rectangle", **unknown)
