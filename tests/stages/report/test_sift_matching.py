import cv2
import numpy as np

from wayside.stages.report.match import match_points, vote_regions


def test_matches_are_those_of_a_brute_force_matcher_with_ratio_test():
    rng = np.random.default_rng(3)
    first = rng.random((60, 128)).astype(np.float32)
    second = np.concatenate([first[20:] + rng.normal(0, 0.05, (40, 128)), rng.random((30, 128))])
    second = second.astype(np.float32)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    forward = matcher.knnMatch(first, second, k=2)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(second, first)}
    wanted = [
        (a.queryIdx, a.trainIdx)
        for a, b in forward
        if a.distance < 0.8 * b.distance and back[a.trainIdx] == a.queryIdx
    ]
    assert [tuple(pair) for pair in match_points(first, second, 0.8)] == wanted
    assert len(wanted) == 40


def test_too_few_descriptors_match_nothing():
    none, one = np.zeros((0, 128), np.float32), np.ones((1, 128), np.float32)
    assert match_points(none, one, 0.8).shape == (0, 2)
    assert match_points(one, one, 0.8).shape == (0, 2)


def test_the_majority_of_points_decides_on_regions():
    pairs = np.array([[0, 0], [1, 1], [2, 2], [3, 3]])
    first = np.array([7, 7, 8, 7], np.int32)
    second = np.array([1, 1, 1, 2], np.int32)
    assert vote_regions(pairs, first, second).tolist() == [[7, 1]]


def test_no_matched_points_match_no_regions():
    none = np.zeros(0, np.int32)
    assert vote_regions(np.zeros((0, 2), np.int64), none, none).shape == (0, 2)
