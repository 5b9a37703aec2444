import cv2
import numpy as np
import pytest

from wayside.pipeline.learning.camera_augmentation import retoned


@pytest.fixture
def scene():
    rgb = np.full((120, 160, 3), (120, 130, 110), np.uint8)
    cv2.rectangle(rgb, (60, 40), (99, 79), (200, 40, 40), -1)
    return rgb


def test_the_same_seed_gives_the_same_image_and_another_one_another(scene):
    one, same, other = (retoned(scene, np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_an_image_is_bright_at_times_and_dark_at_others_and_stays_as_it_was(scene):
    before = scene.copy()
    means = [retoned(scene, np.random.default_rng(seed)).mean() for seed in range(40)]
    assert min(means) < 0.7 * scene.mean()
    assert max(means) > 1.3 * scene.mean()
    np.testing.assert_array_equal(scene, before)


@pytest.mark.parametrize("seed", range(12))
def test_things_stay_where_they_are_and_a_red_face_stays_the_reddest(scene, seed):
    rgb = retoned(scene, np.random.default_rng(seed)).astype(np.float64)
    assert rgb.shape == scene.shape
    red = rgb[..., 0] - rgb[..., 1]
    inner, outer = red[46:74, 66:94].mean(), red[:30].mean()
    assert inner > outer + 15


def test_pixels_of_one_colour_stay_of_one_colour(scene):
    rgb = retoned(scene, np.random.default_rng(5))
    assert len(np.unique(rgb.reshape(-1, 3), axis=0)) == 2
