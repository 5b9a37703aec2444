import cv2
import numpy as np
import pytest

from wayside.stages.detection.patch_features import OUTLINES, patch_feature_names, patch_features
from wayside.stages.imaging import pyramid

BOX = np.array([[60, 50, 100, 90]], np.float32)


def scene(draw, seed=0):
    rgb = np.random.default_rng(seed).integers(95, 125, (160, 200, 3)).astype(np.uint8)
    draw(rgb)
    return rgb


def values(rgb, box=BOX):
    return dict(zip(patch_feature_names(), patch_features(pyramid(rgb), box)[0], strict=True))


def polygon(*points):
    corners = [(60 + 39 * x, 50 + 39 * y) for x, y in points]
    return lambda rgb: cv2.fillPoly(rgb, [np.array(corners, np.int32)], (200, 30, 30))


SHAPES = {
    "rectangle": lambda rgb: cv2.rectangle(rgb, (60, 50), (99, 89), (200, 30, 30), -1),
    "circle": lambda rgb: cv2.circle(rgb, (80, 70), 20, (200, 30, 30), -1),
    "diamond": polygon((0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)),
    "triangle_up": polygon((0.5, 0), (1, 1), (0, 1)),
    "triangle_down": polygon((0, 0), (1, 0), (0.5, 1)),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_inside_and_outside_differ_most_along_the_outline_that_is_drawn(shape):
    found = values(scene(SHAPES[shape]))
    steps = {name: found[f"{name}_worst"] for name in OUTLINES if name != "octagon"}
    assert max(steps, key=lambda name: steps[name]) == shape


def test_an_octagon_fits_better_than_a_square_or_a_diamond():
    a = 1 - 1 / np.sqrt(2)
    cut = a / (2 * a + np.sqrt(2) * a) * 2 / 2
    points = [
        (cut, 0),
        (1 - cut, 0),
        (1, cut),
        (1, 1 - cut),
        (1 - cut, 1),
        (cut, 1),
        (0, 1 - cut),
        (0, cut),
    ]
    found = values(scene(polygon(*points)))
    assert found["octagon_worst"] > max(found["rectangle_worst"], found["diamond_worst"])


def test_a_mirrored_image_has_mirrored_cells():
    rgb = scene(SHAPES["triangle_up"])
    flipped = np.ascontiguousarray(rgb[:, ::-1])
    box = np.array([[200 - 100, 50, 200 - 60, 90]], np.float32)
    one, other = values(rgb), values(flipped, box)
    for row in range(8):
        for column in range(8):
            mine, theirs = f"cell_{row}_{column}_red_green", f"cell_{row}_{7 - column}_red_green"
            assert one[mine] == pytest.approx(other[theirs], abs=0.03)


def test_an_image_of_twice_the_size_looks_the_same():
    rgb = scene(SHAPES["diamond"])
    large = cv2.resize(rgb, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    one = patch_features(pyramid(rgb), BOX)[0]
    other = patch_features(pyramid(large), BOX * 2)[0]
    # The larger one is drawn from its half size, which is the smaller one.
    assert np.abs(one - other).max() < 0.02


def test_half_the_light_changes_the_brightness_and_little_else():
    rgb = scene(SHAPES["circle"])
    one, other = values(rgb), values(rgb // 2)
    assert one["inside_mean_brightness"] - other["inside_mean_brightness"] > 0.5
    for name in ("circle_mean", "gradient_total", "cell_3_3_brightness"):
        assert other[name] == pytest.approx(one[name], rel=0.25, abs=0.2)


def test_an_even_image_has_no_gradient_and_no_step():
    found = values(np.full((160, 200, 3), 90, np.uint8))
    assert found["gradient_total"] == 0
    assert max(found[f"{outline}_mean"] for outline in OUTLINES) < 1e-3


@pytest.mark.parametrize(
    "box", [(-30, -20, 10, 15), (190, 150, 260, 200), (0, 0, 200, 160), (50, 50, 51, 51)]
)
def test_boxes_at_and_beyond_the_border_have_finite_features(box):
    rgb, table = scene(SHAPES["circle"]), np.array([box], np.float32)
    assert np.isfinite(patch_features(pyramid(rgb), table)).all()


def test_no_boxes_give_a_table_without_rows():
    levels, none = pyramid(scene(SHAPES["circle"])), np.zeros((0, 4), np.float32)
    assert patch_features(levels, none).shape == (0, len(patch_feature_names()))


def test_wrong_images_are_refused_at_the_door():
    good = pyramid(scene(SHAPES["circle"]))
    for levels in (good[:2], (good[0].astype(np.float32), *good[1:]), (good[0][:0], *good[1:])):
        with pytest.raises(ValueError, match="levels"):
            patch_features(levels, BOX)
