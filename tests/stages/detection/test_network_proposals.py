"""The network of `red_cells.onnx` calls a red cell of 4 x 4 pixels a yellow octagon of 16 px, a blue one a back."""

from pathlib import Path

import numpy as np
import pytest

from wayside.schemas.detections import SHAPES
from wayside.stages.detection.network_proposals import (
    CENTRE_PX,
    MAPS,
    SIDE_PX,
    DetectionNetwork,
    Maps,
    Part,
    boxes_of_maps,
)

ONNX = str(Path(__file__).parent / "red_cells.onnx")
RED, BLUE = (255, 0, 0), (0, 0, 255)


def cells(height, width, **marked):
    rgb = np.zeros((height, width, 3), np.uint8)
    for color, (row, column) in marked.items():
        rgb[4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = RED if color == "red" else BLUE
    return rgb


def best_boxes(maps, size=(64, 64), least=0.0, most=10):
    return boxes_of_maps([Part(maps, size)], size, least, most, 0.5)


def boxes_in(rgb):
    return best_boxes(DetectionNetwork(ONNX).maps(rgb), rgb.shape[:2])


def test_a_face_is_found_where_it_is_with_its_side_and_shape():
    found = boxes_in(cells(64, 96, red=(5, 7), blue=(12, 3)))
    expected = [[30 - 8, 22 - 8, 30 + 8, 22 + 8], [14 - 8, 50 - 8, 14 + 8, 50 + 8]]
    rows = np.argsort(-found.front)
    np.testing.assert_allclose(found.box[rows], expected, atol=1e-3)
    assert (found.front == found.score)[rows].tolist() == [True, False]
    assert {SHAPES[k] for k in found.shape} == {"octagon"}


@pytest.mark.parametrize(
    ("size", "cell", "box"),
    [
        ((61, 90), (5, 7), [22, 14, 38, 30]),  # padded to a multiple of the stride, not scaled
        ((50, 70), (5, 7), [22, 14, 38, 30]),
        ((64, 64), (0, 0), [0, 0, 10, 10]),  # cut at the border
    ],
)
def test_a_box_is_in_pixels_of_the_image_and_inside_it(size, cell, box):
    np.testing.assert_allclose(boxes_in(cells(*size, red=cell)).box, [box], atol=1e-3)


def maps_with(*faces):
    """Maps of 16 x 16 cells with (row, column, score, box values)."""
    maps = np.zeros((MAPS, 16, 16), np.float32)
    maps[:2] = -9
    for row, column, score, values in faces:
        maps[0, row, column] = score
        maps[2:6, row, column] = values
    return Maps.of(maps)


def test_the_middle_and_the_sides_of_a_box_are_read_from_its_cell():
    maps = maps_with((4, 6, 2.0, (0.5, -0.25, np.log(2), np.log(0.5))))
    found = best_boxes(maps)
    middle = np.array([26 + 0.5 * CENTRE_PX, 18 - 0.25 * CENTRE_PX])
    half = np.array([SIDE_PX, SIDE_PX / 4])
    np.testing.assert_allclose(found.box, [[*(middle - half), *(middle + half)]], rtol=1e-5)


def test_of_boxes_on_one_face_the_best_stays_and_the_best_are_first():
    same = (0, 0, 0, 0)
    one = (4, 4, 1.0, same), (4, 5, 3.0, same), (12, 12, 2.0, same)
    assert best_boxes(maps_with(*one)).score.tolist() == [3.0, 2.0]
    assert len(best_boxes(maps_with(*one), most=1).score) == 1
    assert len(best_boxes(maps_with(*one), least=4.0).score) == 0


def test_maps_of_a_split_last_layer_are_what_it_makes_of_its_inputs():
    rng = np.random.default_rng(2)
    features = rng.integers(0, 256, (5, 6, 8)).astype(np.uint8)
    weight, bias = (rng.normal(size=size).astype(np.float32) for size in ((8, MAPS), MAPS))
    heat = rng.normal(size=(2, 5, 6)).astype(np.float32)
    expected = np.einsum("ck,rsc->krs", weight, features.astype(np.float32))
    expected[:2] = heat
    found = Maps(heat, features, weight, bias).all()
    np.testing.assert_allclose(found, expected + bias[:, None, None], rtol=1e-5, atol=1e-3)
