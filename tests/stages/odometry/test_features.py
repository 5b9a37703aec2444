import cv2
import numpy as np
import pytest

from wayside.schemas.frame import THINNED
from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry.undistortion import ideal_points
from wayside.stages.odometry.features import extract_features, tie_corners


def with_features(item, **how):
    (found,) = extract_features(iter([item]), FeatureSettings(**how))
    return found


def test_an_image_gets_corners_with_descriptors_sorted_by_row(texture, detections_of):
    features = with_features(detections_of(texture())).features
    assert len(features.corners) > 200
    assert features.corners.dtype == np.float32
    assert features.descriptors.shape == (len(features.corners), 32)
    assert (np.diff(features.corners[:, 1]) >= 0).all()


def test_a_corner_is_placed_where_it_is_in_the_full_image():
    spots = np.array([[100, 90], [301, 200], [500, 333], [222, 401]])
    grey = np.full((480, 640), 40, np.uint8)
    for spot in spots:
        cv2.circle(grey, spot.tolist(), 3, 220, -1)
    corners, _ = tie_corners(cv2.GaussianBlur(grey, (0, 0), 1.0), FeatureSettings())
    for spot in spots:
        around = corners[np.linalg.norm(corners - spot, axis=1) < 12]
        assert np.linalg.norm(around.mean(axis=0) - spot) < 1.2


def test_weak_texture_keeps_corners_beside_a_strong_one(texture):
    grey = texture(contrast=14.0)
    grey[:, :320] = texture(seed=1, contrast=70.0)[:, :320]
    corners, _ = tie_corners(grey, FeatureSettings())
    assert (corners[:, 0] > 330).sum() > 0.3 * len(corners)


@pytest.mark.parametrize("per_cell", [1, 4])
def test_no_cell_gets_more_corners_than_asked(per_cell, texture):
    corners, _ = tie_corners(texture(), FeatureSettings(corners_per_cell=per_cell))
    # at half size the finest level has 13 x 10 cells, the coarser ones fewer
    levels = 130 + 63 + 35
    assert 0 < len(corners) <= per_cell * levels


def test_a_blank_image_has_no_corners(detections_of):
    features = with_features(detections_of(np.full((480, 640), 77, np.uint8))).features
    assert features.corners.shape == (0, 2)
    assert features.descriptors.shape == (0, 32)


def test_candidates_get_their_centres_without_distortion(texture, detections_of):
    found = with_features(detections_of(texture(), [(10, 20, 31, 41), (600, 400, 621, 431)]))
    expected = ideal_points(found.frame.camera, np.array([[20.0, 30.0], [610.0, 415.0]]))
    np.testing.assert_allclose(found.candidates.ideal, expected)
    np.testing.assert_allclose(found.candidates.center, [[20.0, 30.0], [610.0, 415.0]])
    assert np.abs(found.candidates.ideal - found.candidates.center).max() > 1


def test_the_image_travels_on(texture, detections_of):
    item = detections_of(texture())
    found = with_features(item)
    assert found.image is item.image
    assert found.segmentation.rows == (100, 300)
    assert found.segmentation.labels is None


def test_a_frame_that_is_not_used_passes_without_features(detections_of):
    found = with_features(detections_of(None, status=THINNED))
    assert found.frame.status == THINNED
    assert len(found.features.corners) == 0
    assert len(found.features.sign_points) == 0
