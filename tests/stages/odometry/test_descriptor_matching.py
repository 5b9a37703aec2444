import cv2
import numpy as np
import pytest

from wayside.stages.odometry.descriptor_matching import match_in_bands


def corners(count, seed):
    generator = np.random.default_rng(seed)
    points = generator.uniform((0, 0), (800, 600), (count, 2))
    return points, generator.integers(0, 256, (count, 32), dtype=np.uint8)


def bands_round(points, length=0.0, width=20.0, direction=(1.0, 0.0)):
    n = len(points)
    return np.c_[points, np.tile(direction, (n, 1)), np.full(n, length), np.full(n, width)]


def match(bands, descriptors, points, others, ratio=0.9):
    bands = np.ascontiguousarray(bands)
    return match_in_bands(bands, descriptors, points, others, 64, ratio)


def test_with_wide_bands_the_matches_are_those_of_opencv():
    points, descriptors = corners(150, 3)
    others = descriptors ^ np.packbits(np.random.default_rng(4).random((150, 256)) < 0.1, axis=1)
    pairs = match(bands_round(points, width=2000.0), descriptors, points, others, ratio=0.8)
    two = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(descriptors, others, k=2)
    clear = [a for a, b in two if a.distance <= 64 and a.distance < 0.8 * b.distance]
    assert sorted(map(tuple, pairs.tolist())) == sorted([(a.queryIdx, a.trainIdx) for a in clear])


def test_nothing_outside_a_band_is_matched():
    descriptors = np.zeros((1, 32), np.uint8)
    bands = bands_round(np.array([[100.0, 100.0]]), length=50.0, width=5.0, direction=(0.0, 1.0))
    for *place, expected in (
        (104, 140, 1),
        (107, 140, 0),
        (100, 156, 0),
        (100, 154, 1),
        (100, 94, 0),
    ):
        assert len(match(bands, descriptors, np.array([place], float), descriptors)) == expected
    points, descriptors = corners(50, 5)
    for outside in ((-5000.0, 0.0), (5000.0, 0.0), (0.0, -5000.0), (0.0, 5000.0)):
        assert len(match(bands_round(points + outside), descriptors, points, descriptors)) == 0


@pytest.mark.parametrize(("second", "pairs"), [((103.0, 101.0), [[0, 0]]), ((115.0, 100.0), [])])
def test_the_same_corner_at_two_sizes_is_no_rival_of_itself_and_two_places_are(second, pairs):
    points, others = np.array([[100.0, 100.0], second]), np.full((2, 32), 7, np.uint8)
    assert match(bands_round(points[:1]), others[:1], points, others).tolist() == pairs


def test_of_two_corners_that_want_the_same_one_the_closer_gets_it():
    descriptors = np.zeros((2, 32), np.uint8)
    descriptors[0, 0] = 1
    points = np.array([[100.0, 100.0], [101.0, 100.0]])
    pairs = match(bands_round(points), descriptors, points[:1], np.zeros((1, 32), np.uint8))
    assert pairs.tolist() == [[1, 0]]


def test_no_corners_give_no_matches():
    points, descriptors = corners(4, 6)
    assert match(bands_round(points), descriptors, points[:0], descriptors[:0]).shape == (0, 2)


def test_descriptors_of_another_length_are_refused():
    points, descriptors = corners(4, 7)
    with pytest.raises(ValueError, match="descriptors"):
        match(bands_round(points), descriptors[:, :16], points, descriptors)
