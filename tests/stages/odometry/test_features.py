import cv2
import numpy as np
import pytest

from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry.undistortion import ideal_points
from wayside.stages.odometry.features import extract_features, tie_corners

from ..made_frames import detections_of, texture


def test_an_image_gets_corners_with_descriptors():
    (found,) = extract_features(iter([detections_of(texture())]), FeatureSettings())
    features = found.features
    assert len(features.corners) > 200
    assert features.corners.dtype == np.float32
    assert features.descriptors.shape == (len(features.corners), 32)


def test_a_corner_is_placed_where_it_is_in_the_full_image():
    spots = np.array([[100, 90], [301, 200], [500, 333], [222, 401]])
    grey = np.full((480, 640), 40, np.uint8)
    for spot in spots:
        cv2.circle(grey, spot.tolist(), 3, 220, -1)
    corners, _ = tie_corners(cv2.GaussianBlur(grey, (0, 0), 1.0), FeatureSettings())
    for spot in spots:
        around = corners[np.linalg.norm(corners - spot, axis=1) < 12]
        assert np.linalg.norm(around.mean(axis=0) - spot) < 1.2


def test_weak_texture_keeps_corners_beside_a_strong_one():
    grey = texture(contrast=14.0)
    grey[:, :320] = texture(seed=1, contrast=70.0)[:, :320]
    corners, _ = tie_corners(grey, FeatureSettings())
    assert (corners[:, 0] > 330).sum() > 0.3 * len(corners)


@pytest.mark.parametrize("per_cell", [1, 4])
def test_no_cell_gets_more_corners_than_asked(per_cell):
    corners, _ = tie_corners(texture(), FeatureSettings(corners_per_cell=per_cell))
    # at half size the finest level has 13 x 10 cells, the coarser ones fewer
    levels = 130 + 63 + 35
    assert 0 < len(corners) <= per_cell * levels


def test_candidates_get_their_centres_without_distortion():
    item = detections_of(texture(), [(10, 20, 31, 41), (600, 400, 621, 431)])
    (found,) = extract_features(iter([item]), FeatureSettings())
    expected = ideal_points(found.frame.camera, np.array([[20.0, 30.0], [610.0, 415.0]]))
    np.testing.assert_allclose(found.candidates.ideal, expected)
    np.testing.assert_allclose(found.candidates.center, [[20.0, 30.0], [610.0, 415.0]])
    assert np.abs(found.candidates.ideal - found.candidates.center).max() > 1
