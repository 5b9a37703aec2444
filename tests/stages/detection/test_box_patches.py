import cv2
import numpy as np
import pytest

from wayside.stages.detection import INNER, SIDE, drawn_patches

BOX = np.array([[60, 50, 100, 90]], np.float32)
EDGE = (SIDE - INNER) // 2


def scene(seed=0):
    """A red circle that touches the sides of `BOX`, on even noise."""
    rgb = np.random.default_rng(seed).integers(95, 125, (160, 200, 3)).astype(np.uint8)
    cv2.circle(rgb, (80, 70), 20, (200, 30, 30), -1)
    return rgb


def patch(rgb, box=BOX):
    return drawn_patches(rgb, box)[0].astype(int)


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


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize(("side", "scale"), [(55, 1), (56, 2), (111, 2), (112, 4)])
def test_a_large_box_is_drawn_from_a_smaller_image(side, scale, width):
    stripes = np.repeat(np.arange(400) // width % 2 * 200, 3).astype(np.uint8)
    rgb = np.tile(stripes, (400, 1)).reshape(400, 400, 3)
    shown = patch(rgb, np.array([[100, 100, 100 + side, 120]], np.float32))
    assert (shown == 100).all() == (scale >= 2 * width)


BORDER = [(-30, -20, 10, 15), (195, 155, 201, 161), (0, 0, 200, 160), (185, 9, 205, 29)]


@pytest.mark.parametrize("box", [*BORDER, (-400, 0, -300, 90)])
def test_beyond_the_border_it_is_repeated(box):
    rgb, at = scene().repeat(4, 0).repeat(4, 1), 4 * np.array([box], np.float32)
    around = cv2.copyMakeBorder(rgb, *[1024] * 4, cv2.BORDER_REPLICATE)
    assert np.abs(drawn_patches(rgb, at).astype(int) - drawn_patches(around, at + 1024)).max() <= 1


def test_other_arrays_are_refused():
    with pytest.raises(ValueError, match="rgb"):
        drawn_patches(scene().astype(np.float32), BOX)
    with pytest.raises(ValueError, match="box"):
        drawn_patches(scene(), BOX[:, :3])
