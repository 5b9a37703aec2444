import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.stages.geometry.path import frenet_offsets

UP = np.array([[0.0, -1.0, 0.0]])
AHEAD = np.array([0.0, 0.0, 1.0])


def straight(n):
    centres = np.array([[0.0, 0.0, 8.0 * k] for k in range(n)])
    return centres, np.repeat(UP, n, axis=0), 8.0 * np.arange(n)


@given(st.floats(-20, 20), st.floats(-5, 8), st.floats(-30, 80))
def test_offsets_of_a_straight_path_are_plain_coordinates(right, up, along):
    for cameras in (5, 1):
        found = frenet_offsets(np.array([[right, -up, along]]), *straight(cameras), AHEAD)
        np.testing.assert_allclose(found, [(along, right, up)], atol=1e-9)


def test_the_offset_on_a_curve_is_the_distance_to_the_arc():
    radius, angles = 300.0, np.linspace(0, 0.4, 16)
    centres = radius * np.stack([1 - np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    beyond = 0.2
    inner = np.array([radius - 290 * np.cos(beyond), -1.0, 290 * np.sin(beyond)])
    along = centres, np.repeat(UP, 16, axis=0), radius * angles
    (found,) = frenet_offsets(inner[None], *along, AHEAD)
    assert found.right == pytest.approx(10.0, abs=0.05)
    assert found.station == pytest.approx(radius * beyond, abs=0.1)
    assert found.above == pytest.approx(1.0)
