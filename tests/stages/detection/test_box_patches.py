import cv2
import numpy as np
import pytest

from wayside.stages.detection import INNER, SIDE, drawn_patches
from wayside.stages.imaging import pyramid

BOX = np.array([[60, 50, 100, 90]], np.float32)
EDGE = (SIDE - INNER) // 2


def scene(seed=0):
    """A red circle that touches the sides of `BOX`, on even noise."""
    rgb = np.random.default_rng(seed).integers(95, 125, (160, 200, 3)).astype(np.uint8)
    cv2.circle(rgb, (80, 70), 20, (200, 30, 30), -1)
    return rgb


def patch(rgb, box=BOX):
    return drawn_patches(pyramid(rgb), box)[0].astype(int)


def test_a_patch_is_the_box_with_its_surroundings():
    rgb = np.random.default_rng(0).integers(60, 80, (240, 320, 3)).astype(np.uint8)
    rgb[100:160, 200:240] = 250
    shown = patch(rgb, np.array([[200, 100, 240, 160]], np.float32))
    assert shown.shape == (SIDE, SIDE, 3)
    inside = slice(EDGE + 1, -EDGE - 1)  # samples at the edge are blended with what is outside
    assert (shown[inside, inside] == 250).all()
    assert (shown[EDGE:-EDGE, EDGE:-EDGE] > 200).all()
    assert shown[0].max() < 80


def test_a_mirrored_image_has_mirrored_patches():
    flipped = np.ascontiguousarray(scene()[:, ::-1])
    box = np.array([[200 - 100, 50, 200 - 60, 90]], np.float32)
    assert np.abs(patch(scene()) - patch(flipped, box)[:, ::-1]).max() <= 1


@pytest.mark.parametrize(("side", "level"), [(2 * INNER - 1, 0), (2 * INNER, 1), (4 * INNER, 2)])
def test_a_large_box_is_drawn_from_a_smaller_image(side, level):
    levels = [np.full((400 >> k, 400 >> k, 3), 50 * (k + 1), np.uint8) for k in range(3)]
    shown = drawn_patches(tuple(levels), np.array([[100, 100, 100 + side, 120]], np.float32))
    assert (shown == 50 * (level + 1)).all()


@pytest.mark.parametrize(
    "box", [(-30, -20, 10, 15), (190, 150, 260, 200), (0, 0, 200, 160), (50, 50, 51, 51)]
)
def test_beyond_the_border_it_is_repeated(box):
    levels, table = pyramid(scene()), np.array([box], np.float32)
    around = [
        cv2.copyMakeBorder(level, *[128 >> k] * 4, cv2.BORDER_REPLICATE)
        for k, level in enumerate(levels)
    ]
    found, wanted = drawn_patches(levels, table), drawn_patches(tuple(around), table + 128)
    assert np.abs(found.astype(int) - wanted).max() <= 1


def test_other_arrays_are_refused():
    good = pyramid(scene())
    with pytest.raises(ValueError, match="levels"):
        drawn_patches((good[0].astype(np.float32), *good[1:]), BOX)
    with pytest.raises(ValueError, match="box"):
        drawn_patches(good, BOX[:, :3])
