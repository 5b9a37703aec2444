import cv2
import numpy as np

from wayside.schemas.frame import THINNED
from wayside.stages.report.sift import extract_sift


def with_sift(item):
    (found,) = extract_sift(iter([item]))
    return found


def test_sift_is_found_inside_the_open_candidates_only(texture, detections_of):
    boxes = [(100, 100, 160, 160), (300, 200, 360, 260)]
    found = with_sift(detections_of(texture(), boxes, ["open", "color"]))
    features = found.features
    assert len(features.sign_points) > 3
    assert features.sign_descriptors.shape == (len(features.sign_points), 128)
    assert (features.sign_rows == 0).all()
    assert (features.sign_points > 100 - 16 - 1).all()
    assert (features.sign_points < 160 + 16).all()


def test_a_point_belongs_to_the_smallest_candidate_around_it_and_to_no_other(
    texture, detections_of
):
    boxes = [(100, 100, 200, 200), (120, 120, 180, 180)]
    features = with_sift(detections_of(texture(), boxes, ["open", "open"])).features
    # SIFT gives a place with two main directions twice, with different descriptors
    told_apart = np.hstack([features.sign_points, features.sign_descriptors])
    assert len(np.unique(told_apart, axis=0)) == len(features.sign_points)
    inner = ((features.sign_points > 120) & (features.sign_points < 179)).all(axis=1)
    assert (features.sign_rows[inner] == 1).all()
    assert (features.sign_rows == 0).any()


def test_a_blob_on_a_candidate_is_found_at_its_centre(detections_of):
    blob = np.full((480, 640), 60, np.uint8)
    cv2.circle(blob, (401, 251), 30, 220, -1)
    blob = cv2.GaussianBlur(blob, (0, 0), 3)
    found = with_sift(detections_of(blob, [(290, 140, 511, 361)]))
    distance = np.linalg.norm(found.features.sign_points - (401, 251), axis=1)
    assert distance.min() < 2


def test_an_image_without_pixels_passes_without_points(detections_of):
    found = with_sift(detections_of(None, status=THINNED))
    assert len(found.features.sign_points) == 0
