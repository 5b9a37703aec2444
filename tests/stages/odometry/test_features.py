import cv2
import numpy as np
import pytest

from wayside.schemas.detections import Candidates, Detections, Regions, Segmentation, verdict_code
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.settings import FeatureSettings
from wayside.stages.geometry.undistortion import ideal_points
from wayside.stages.odometry.features import extract_features, tie_corners

CAMERA = Camera(640, 480, 560.0, 560.0, 320.0, 240.0, (-0.15, 0.08, 0.0, 0.0005, -0.02))


def texture(height=480, width=640, seed=0, contrast=60.0):
    noise = np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.clip(128 + contrast * blurred / blurred.std(), 0, 255).astype(np.uint8)


def judged(grey, boxes=(), verdicts=(), scores=(), camera=CAMERA, status=USED):
    box = np.array(boxes, np.float32).reshape(-1, 4)
    n = len(box)
    area = ((box[:, 2] - box[:, 0]) * (box[:, 3] - box[:, 1])).astype(np.int32)
    regions = Regions(box, area, np.zeros((n, 3), np.float32), np.zeros(n, np.uint8))
    candidates = Candidates.of(regions)
    if len(verdicts):
        candidates.verdict[:] = [verdict_code(name) for name in verdicts]
    if len(scores):
        candidates.score[:] = scores
    frame = Frame(3, 0, None, status, "jpeg", b"", camera, 640, 480)
    rgb = None if grey is None else np.dstack([grey] * 3)
    image = Image(frame, rgb, grey)
    empty = np.zeros((0, 3), np.float32)
    return Detections(
        Segmentation(image, regions, n, empty, np.zeros(0, np.float32), (100, 300)), candidates
    )


def look_of(item, **how):
    (look,) = extract_features(iter([item]), FeatureSettings(**how))
    return look


def test_an_image_gets_corners_with_descriptors_sorted_by_row():
    features = look_of(judged(texture())).features
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


def test_a_blank_image_has_no_corners():
    features = look_of(judged(np.full((480, 640), 77, np.uint8))).features
    assert features.corners.shape == (0, 2)
    assert features.descriptors.shape == (0, 32)


def test_candidates_get_their_centres_without_distortion():
    look = look_of(judged(texture(), [(10, 20, 31, 41), (600, 400, 621, 431)]))
    expected = ideal_points(CAMERA, np.array([[20.0, 30.0], [610.0, 415.0]]))
    np.testing.assert_allclose(look.candidates.ideal, expected)
    np.testing.assert_allclose(look.candidates.center, [[20.0, 30.0], [610.0, 415.0]])
    assert np.abs(look.candidates.ideal - look.candidates.center).max() > 1


def test_the_image_travels_on():
    item = judged(texture())
    look = look_of(item)
    assert look.image is item.image
    assert look.segmentation.rows == (100, 300)
    assert look.segmentation.labels is None


def test_a_frame_that_is_not_used_passes_without_features():
    look = look_of(judged(None, status=THINNED))
    assert look.frame.status == THINNED
    assert len(look.features.corners) == 0
    assert len(look.features.sign_points) == 0
