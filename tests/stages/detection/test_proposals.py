"""The network of `red_cells.onnx` calls a red cell of 4 x 4 pixels a yellow octagon of 16 px, a blue one a back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wayside.schemas.detections import SOURCES, Segmentation
from wayside.schemas.frame import THINNED, USED, Camera
from wayside.stages.detection import MAPS, STRIDE, DetectionNetwork, Maps, fits_face, propose
from wayside.stages.detection.proposals import MOST_BOXES, SAME_BOX_IOU
from wayside.stages.geometry import iou_matrix

from ..made_frames import made_image, made_regions

NETWORK = DetectionNetwork(str(Path(__file__).parent / "red_cells.onnx"))
CAMERA = Camera(640, 480, 700.0, 700.0, 319.5, 239.5)


def segmented(boxes=(), *, red=(), status=USED, camera=CAMERA):
    """A black image with red cells at (row, column), and segments of these boxes."""
    rgb = np.zeros((480, 640, 3), np.uint8)
    for row, column in red:
        rgb[4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = (255, 0, 0)
    image, table = made_image(rgb, status=status, camera=camera), made_regions(boxes)
    return Segmentation(image, table, len(table), np.zeros((0, 3)), np.zeros(0), (0, 480))


def proposed(item):
    return next(propose(iter([item.image]), network=NETWORK))


def of_network(item):
    return item.regions.select(item.regions.source == SOURCES.index("network"))


@pytest.mark.parametrize("horizon", [243.5, 223.5, 220.5, 176.0])
def test_boxes_of_the_network_are_in_pixels_of_the_image_whatever_rows_it_sees(horizon):
    camera = replace(CAMERA, cy=horizon)
    found = of_network(proposed(segmented(red=[(50, 80)], camera=camera)))
    # where the rows begin off a multiple of 4, the red cell lies in two cells of the maps
    assert np.abs(found.box[0] - [314, 194, 330, 210]).max() <= 3
    assert found.area_px[0] == pytest.approx(0.83 * 256, abs=40)  # of an octagon


def test_a_face_outside_of_the_rows_of_the_network_is_not_looked_for():
    for row, seen in ((80, True), (92, False)):  # rows end 112 below the horizon, in row 352
        assert (proposed(segmented(red=[(row, 80)])).network_score > 0).any() == seen


@pytest.mark.parametrize("row", [64, 44])
def test_a_large_face_that_is_not_seen_whole_at_full_size_has_one_box_from_half_size(row):
    item = segmented()
    item.image.rgb[row : row + 8, 320:328] = (255, 0, 0)  # rows from 64 on are seen at full size
    whole = np.array([[308, row - 12, 340, row + 20]], np.float32)
    found = of_network(proposed(item))
    overlap = iou_matrix(found.box, whole)[:, 0]
    assert overlap.max() > 0.6
    assert np.abs(found.box[overlap.argmax()] - whole[0]).max() <= 8
    assert not ((found.box[:, 1] == 64) & (found.box[:, 3] > 64)).any()


@pytest.mark.parametrize(
    ("focal", "times"), [(700, 1), (500, 1), (499, 2), (250, 2), (249, 4), (9, 4)]
)
def test_an_image_of_short_focal_length_is_seen_as_large_as_those_learned_from(focal, times):
    camera = replace(CAMERA, fx=focal, fy=focal)
    side = 4 // times  # one red cell of what the network sees
    item = segmented(camera=camera)
    item.image.rgb[220 : 220 + side, 320 : 320 + side] = (255, 0, 0)
    found = of_network(proposed(item))
    middle, half = np.array([320, 220]) + side / 2, 8 / times
    assert np.abs(found.box[0] - np.concatenate([middle - half, middle + half])).max() <= 3 / times


def test_faces_are_searched_for_as_tall_as_the_network_sees_them():
    camera = replace(CAMERA, fx=350.0, fy=350.0)
    boxes = np.array([[100, 100, 106, 104], [200, 100, 206, 103]], np.float32)
    assert fits_face(boxes, camera).tolist() == [True, False]
    assert not fits_face(boxes, CAMERA).any()


def test_no_more_boxes_of_the_network_than_asked_for():
    red = [(row, column) for row in range(20, 88, 8) for column in range(10, 150, 10)]
    found = proposed(segmented(red=red))
    assert len(of_network(found)) == MOST_BOXES < len(red)
    assert found.dropped.left_out >= len(red) - MOST_BOXES


@pytest.mark.parametrize(("status", "camera"), [(USED, None), (THINNED, CAMERA)])
def test_an_image_that_is_not_used_has_no_regions(status, camera):
    item = segmented(red=[(50, 80)], status=status, camera=camera)
    found = proposed(item)
    assert (found.image, len(found.regions), found.network_score) == (item.image, 0, None)


def test_an_image_without_rows_near_the_horizon_has_no_boxes():
    found = proposed(segmented(camera=replace(CAMERA, cy=5000.0)))
    assert (len(found.regions), len(found.network_score)) == (0, 0)


def test_a_face_that_is_seen_at_both_sizes_has_one_box():
    item = segmented(red=[(row, column) for row in (50, 51) for column in (80, 81)])
    found = of_network(proposed(item))
    overlap = iou_matrix(found.box, found.box)
    np.fill_diagonal(overlap, 0)
    assert len(found) >= 1
    assert overlap.max() <= SAME_BOX_IOU


def test_boxes_that_no_face_has_the_size_of_are_counted():
    class Wide:
        def maps(self, rgb):
            maps = np.full((MAPS, rgb.shape[0] // STRIDE, rgb.shape[1] // STRIDE), -9, np.float32)
            maps[[0, 2, 3, 4, 5], 30, 40] = 1, 0, 0, np.log(8), 0
            return Maps.of(maps)

    found = next(propose(iter([segmented().image]), network=Wide()))
    assert (len(found.regions), found.dropped.size) == (0, 2)
