import cv2
import numpy as np

from wayside.schemas.detections import Candidates, Detections, Regions, Segmentation, verdict_code
from wayside.schemas.frame import THINNED, USED, Camera, Frame, Image
from wayside.schemas.settings import SiftSettings
from wayside.stages.report.sift import extract_sift

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


def look_of(item):
    (look,) = extract_sift(iter([item]), settings=SiftSettings())
    return look


def test_sift_is_found_inside_the_open_candidates_only():
    boxes = [(100, 100, 160, 160), (300, 200, 360, 260)]
    look = look_of(judged(texture(), boxes, ["open", "color"]))
    features = look.features
    assert len(features.sign_points) > 3
    assert features.sign_descriptors.shape == (len(features.sign_points), 128)
    assert (features.sign_rows == 0).all()
    assert (features.sign_points > 100 - 16 - 1).all()
    assert (features.sign_points < 160 + 16).all()


def test_a_point_belongs_to_the_smallest_candidate_around_it_and_to_no_other():
    boxes = [(100, 100, 200, 200), (120, 120, 180, 180)]
    features = look_of(judged(texture(), boxes, ["open", "open"])).features
    # SIFT gives a place with two main directions twice, with different descriptors
    told_apart = np.hstack([features.sign_points, features.sign_descriptors])
    assert len(np.unique(told_apart, axis=0)) == len(features.sign_points)
    inner = ((features.sign_points > 120) & (features.sign_points < 179)).all(axis=1)
    assert (features.sign_rows[inner] == 1).all()
    assert (features.sign_rows == 0).any()


def test_a_blob_on_a_candidate_is_found_at_its_centre():
    blob = np.full((480, 640), 60, np.uint8)
    cv2.circle(blob, (401, 251), 30, 220, -1)
    blob = cv2.GaussianBlur(blob, (0, 0), 3)
    look = look_of(judged(blob, [(290, 140, 511, 361)]))
    distance = np.linalg.norm(look.features.sign_points - (401, 251), axis=1)
    assert distance.min() < 2


def test_an_image_without_pixels_passes_without_points():
    look = look_of(judged(None, status=THINNED))
    assert len(look.features.sign_points) == 0
