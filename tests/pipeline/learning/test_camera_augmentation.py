from dataclasses import replace

import cv2
import numpy as np
import pytest

from wayside.pipeline.learning.camera_augmentation import altered, through_other_cameras
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image


@pytest.fixture
def scene():
    rgb = np.full((120, 160, 3), (120, 130, 110), np.uint8)
    cv2.rectangle(rgb, (60, 40), (99, 79), (200, 40, 40), -1)
    return rgb


def images(rgb, count=40):
    camera = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
    for index in range(count):
        frame = Frame(index, index, None, USED, "jpeg", b"", camera, 160, 120)
        yield Image(frame, rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def test_some_images_are_altered_and_the_others_stay_as_they_are(scene):
    shown = list(through_other_cameras(images(scene), seed=1, fraction=0.5))
    same = [np.array_equal(image.rgb, scene) for image in shown]
    assert 8 <= sum(same) <= 32
    assert [image.frame.index for image in shown] == list(range(40))


def test_the_same_seed_shows_the_same_images_a_second_time(scene):
    first = [p.rgb for p in through_other_cameras(images(scene), seed=3)]
    reread = [p.rgb for p in through_other_cameras(images(scene), seed=3)]
    other = [p.rgb for p in through_other_cameras(images(scene), seed=4)]
    assert all(np.array_equal(a, b) for a, b in zip(first, reread, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_grey_is_that_of_the_altered_image(scene):
    for image in through_other_cameras(images(scene, 8), seed=2, fraction=1.0):
        assert np.array_equal(image.grey, cv2.cvtColor(image.rgb, cv2.COLOR_RGB2GRAY))


@pytest.mark.parametrize("seed", range(12))
def test_things_stay_where_they_are_and_a_red_face_stays_the_reddest(scene, seed):
    rgb = altered(scene, np.random.default_rng(seed)).astype(np.float64)
    assert rgb.shape == scene.shape
    red = rgb[..., 0] - rgb[..., 1]
    inner, outer = red[46:74, 66:94].mean(), red[:30].mean()
    assert inner > outer + 15


def test_images_that_are_not_used_pass_untouched(scene):
    unused = [
        replace(p, rgb=None, grey=None, frame=replace(p.frame, status=THINNED))
        for p in images(scene, 2)
    ]
    shown = list(through_other_cameras(iter(unused), seed=1, fraction=1.0))
    assert all(a is b for a, b in zip(shown, unused, strict=True))
