import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.schemas.frame import Camera
from wayside.stages.geometry.undistortion import (
    distort_points,
    ideal_of_rays,
    ideal_points,
    rays_of_ideal,
    to_rays,
)

BROWN = Camera(1600, 1200, 1388.5, 1390.0, 806.1, 588.4, (-0.162, 0.094, -0.0005, 0.0006, -0.021))
RATIONAL = Camera(
    1600, 1200, 1388.5, 1390.0, 806.1, 588.4, (-0.1, 0.05, 0.001, 0.0, 0.01, 0.05, 0.01, 0.0)
)
pixels = st.tuples(st.floats(0, 1599), st.floats(0, 1199))


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=["brown", "rational"])
@given(points=st.lists(pixels, min_size=1, max_size=8))
def test_a_pixel_survives_undistortion_and_distortion(camera, points):
    recorded = np.array(points)
    assert np.abs(distort_points(camera, ideal_points(camera, recorded)) - recorded).max() < 1e-6


@pytest.mark.parametrize("camera", [BROWN, RATIONAL], ids=["brown", "rational"])
def test_distortion_is_that_of_opencv(camera):
    rays = np.random.default_rng(3).uniform((-0.6, -0.45), (0.6, 0.45), (50, 2))
    solid = np.c_[rays, np.ones(50)]
    expected, _ = cv2.projectPoints(
        solid, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    recorded = distort_points(camera, ideal_of_rays(camera, rays))
    np.testing.assert_allclose(recorded, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(to_rays(camera, recorded), rays, atol=1e-9)


def test_a_camera_without_distortion_changes_no_pixel():
    camera = Camera(640, 480, 500, 510, 320, 240)
    points = np.array([[0.0, 0.0], [639.0, 479.0]])
    np.testing.assert_array_equal(ideal_points(camera, points), points)
    np.testing.assert_array_equal(distort_points(camera, points), points)
    np.testing.assert_allclose(rays_of_ideal(camera, np.array([[320.0, 240.0]])), [[0.0, 0.0]])


def test_points_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"instead of \(-1, 2\)"):
        ideal_points(BROWN, np.zeros((2, 3)))
