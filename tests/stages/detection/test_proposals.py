import dataclasses

import cv2
import numpy as np
import pytest

from wayside.schemas.detections import SOURCES, Regions, Segmentation
from wayside.schemas.errors import InputError
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.models import TreeModel
from wayside.schemas.settings import CandidateSettings
from wayside.stages.detection.feature_vectors import REGION_FEATURES
from wayside.stages.detection.proposals import bands, merge_regions, propose, propose_in_band
from wayside.stages.detection.stacked_regions import with_stacks
from wayside.stages.geometry import iou_matrix

CAMERA = Camera(800, 600, 700.0, 700.0, 399.5, 299.5)
SETTINGS = CandidateSettings()


def road(seed=0):
    """Sky, trees and road with noise."""
    rng = np.random.default_rng(seed)
    rgb = np.zeros((600, 800, 3), np.float32)
    rgb[:280] = (170, 190, 215)
    rgb[280:330] = (70, 90, 60)
    rgb[330:] = (105, 105, 100)
    return rgb + rng.normal(0, 4, rgb.shape)


def segmented(rgb, *, status=USED, camera=CAMERA, regions=None):
    pixels = np.clip(rgb, 0, 255).astype(np.uint8)
    frame = Frame(3, 0, None, status, "jpeg", b"", camera)
    used = status == USED
    image = Image(frame, pixels if used else None, pixels[..., 0] if used else None)
    table = Regions.empty() if regions is None else regions
    return Segmentation(image, table, 0, np.zeros((0, 3)), np.zeros(0), (0, 600))


def best(item, box):
    return iou_matrix(item.regions.box, np.array([box])).max()


@pytest.mark.parametrize(
    ("color", "box"),
    [
        ((180, 40, 45), (500, 290, 512, 302)),
        ((230, 190, 40), (520, 270, 545, 295)),
        ((20, 110, 70), (560, 250, 620, 290)),
        ((30, 70, 160), (250, 300, 265, 318)),
        ((225, 225, 225), (300, 290, 318, 312)),
        ((40, 40, 40), (420, 240, 470, 300)),
    ],
)
def test_faces_of_all_colours_and_sizes_have_a_box_that_fits(color, box):
    rgb = road()
    rgb[box[1] : box[3], box[0] : box[2]] = color
    (found,) = propose(iter([segmented(rgb)]), settings=SETTINGS)
    assert best(found, box) >= 0.7
    row = iou_matrix(found.regions.box, np.array([box])).argmax()
    assert SOURCES[found.regions.source[row]] == "level"
    assert np.abs(found.regions.rgb[row] - color).max() < 25


def test_a_near_face_larger_than_the_far_band_is_found_at_a_smaller_scale():
    rgb = road()
    cv2.circle(rgb, (600, 240), 70, (190, 30, 35), -1)
    (found,) = propose(iter([segmented(rgb)]), settings=SETTINGS)
    assert best(found, (530, 170, 671, 311)) >= 0.7


def test_segments_of_the_size_of_a_face_stay_and_others_go():
    box = np.array([[10, 20, 40, 50], [0, 0, 700, 20], [5, 5, 9, 9]], np.float32)
    table = Regions(
        box, np.array([800, 9000, 12]), np.zeros((3, 3), np.float32), np.zeros(3, np.uint8)
    )
    even = np.full((600, 800, 3), 90.0)
    (found,) = propose(iter([segmented(even, regions=table)]), settings=SETTINGS)
    assert found.regions.box.tolist() == [[10, 20, 40, 50]]


def test_boxes_that_overlap_come_once():
    (found,) = propose(iter([segmented(road(2))]), settings=SETTINGS)
    overlap = iou_matrix(found.regions.box, found.regions.box)
    np.fill_diagonal(overlap, 0)
    assert len(found.regions) > 20
    assert overlap.max() <= 0.7 + 1e-6


def test_no_more_regions_than_asked_for():
    few = CandidateSettings(most=9)
    (found,) = propose(iter([segmented(road())]), settings=few)
    assert len(found.regions) == 9


def test_regions_for_which_there_is_no_room_are_counted():
    (everything,) = propose(iter([segmented(road())]), settings=SETTINGS)
    assert everything.dropped.left_out == 0
    (few,) = propose(iter([segmented(road())]), settings=CandidateSettings(most=9))
    assert few.dropped.left_out == len(everything.regions) - 9
    fewest = CandidateSettings(most=9, most_compared=9)
    (fewer,) = propose(iter([segmented(road())]), settings=fewest)
    assert len(fewer.regions) == 9
    assert fewer.dropped.left_out > 9


@pytest.mark.parametrize("most", [9, 4000])
def test_every_region_has_a_row_or_is_counted_with_its_reason(most):
    settings = CandidateSettings(most_compared=most, stack_rounds=0)
    rgb = np.clip(road(), 0, 255).astype(np.uint8)
    found = [propose_in_band(*band, settings) for band in bands(rgb, CAMERA, settings)]
    boxes = np.array([[10, 10, 22, 22], [10, 10, 22, 23], [0, 0, 700, 9]], np.float32)
    segments = Regions(
        boxes, np.full(3, 90, np.int32), np.zeros((3, 3), np.float32), np.zeros(3, np.uint8)
    )
    regions, dropped = merge_regions(segments, found, settings)
    unfit = 1 + sum(part.unfit for part in found)
    assert dropped.size == unfit > 1
    assert dropped.merged > 0
    given = sum(len(part.regions) for part in found) + len(segments)
    assert len(regions) + dropped.merged + dropped.left_out + 1 == given


def test_stacks_that_no_face_has_the_size_of_are_counted():
    boxes = np.array([[0, 0, 90, 12], [0, 13, 90, 25], [0, 26, 90, 38]], np.float32)
    table = Regions(
        boxes, np.full(3, 900, np.int32), np.zeros((3, 3), np.float32), np.zeros(3, np.uint8)
    )
    stacked, dropped = with_stacks(table, SETTINGS)
    pairs = len(stacked) - len(table) + sum(dropped)
    assert pairs == 2
    narrow = dataclasses.replace(SETTINGS, widest_aspect=2.0)
    same, dropped = with_stacks(table, narrow)
    assert len(same) == len(table)
    assert dropped == (2, 0, 0)


def by_width(features=REGION_FEATURES):
    """A ranking by which what is at least .1 rad wide is likelier a face than the rest."""
    column = REGION_FEATURES.index("log_width")
    return TreeModel(
        features,
        0.0,
        np.array([[column, 0, 0]], np.int32),
        np.array([[np.log(0.1), 0, 0]], np.float32),
        np.array([[1, -1, -1]], np.int32),
        np.array([[2, -1, -1]], np.int32),
        np.array([[0, -1, 1]], np.float32),
        0.0,
        "made by hand",
    )


def test_the_likeliest_by_the_ranking_stay_in_the_order_they_came():
    (everything,) = propose(iter([segmented(road())]), settings=SETTINGS)
    wide = everything.regions.box[:, 2] - everything.regions.box[:, 0] > 0.1 * CAMERA.fx
    assert 5 < wide.sum() < len(wide) - 5
    few = CandidateSettings(most=int(wide.sum()))
    (found,) = propose(iter([segmented(road())]), settings=few, ranking=by_width())
    np.testing.assert_array_equal(found.regions.box, everything.regions.box[wide])


def test_a_ranking_by_something_else_is_refused():
    strange = by_width(("smell", *REGION_FEATURES[1:]))
    with pytest.raises(InputError, match=r"found smell"):
        next(propose(iter([segmented(road())]), settings=SETTINGS, ranking=strange))


def test_the_same_image_gives_the_same_regions():
    one, other = propose(iter([segmented(road(5)), segmented(road(5))]), settings=SETTINGS)
    assert one.regions.box.tobytes() == other.regions.box.tobytes()
    assert one.regions.rgb.tobytes() == other.regions.rgb.tobytes()


def test_an_image_that_is_not_used_travels_untouched():
    item = segmented(road(), status=THINNED)
    assert next(propose(iter([item]), settings=SETTINGS)) is item


def test_an_image_without_rows_near_the_horizon_keeps_its_segments():
    looking_up = Camera(800, 600, 700.0, 700.0, 399.5, 5000.0)
    (found,) = propose(iter([segmented(road(), camera=looking_up)]), settings=SETTINGS)
    assert len(found.regions) == 0


def test_a_face_in_two_colours_is_put_together_from_its_halves():
    rgb = road()
    rgb[240:262, 520:580] = (235, 235, 235)
    rgb[262:284, 520:580] = (240, 150, 20)
    (found,) = propose(iter([segmented(rgb)]), settings=SETTINGS)
    overlap = iou_matrix(found.regions.box, np.array([(520, 240, 580, 284)]))[:, 0]
    assert overlap.max() >= 0.8


def test_stripes_stand_in_for_the_striped_face():
    table = Regions(
        np.array(
            [[100, 50, 112, 60], [100, 62, 112, 72], [100, 73, 113, 84], [300, 50, 312, 60]],
            np.float32,
        ),
        np.array([100, 100, 100, 100], np.int32),
        np.array([[200, 40, 40], [240, 240, 240], [200, 40, 40], [0, 0, 0]], np.float32),
        np.zeros(4, np.uint8),
    )
    stacked, _ = with_stacks(with_stacks(table, SETTINGS)[0], SETTINGS)
    assert iou_matrix(stacked.box, np.array([(100, 50, 113, 84)])).max() > 0.9
    row = int(iou_matrix(stacked.box, np.array([(100, 50, 112, 72)]))[:, 0].argmax())
    assert SOURCES[stacked.source[row]] == "stack"
    assert stacked.rgb[row].tolist() == [220, 140, 140]
    assert stacked.area_px[row] == 200
    assert not (stacked.box[4:, 2] > 200).any()
