import numpy as np
import pytest

from wayside.stages.mapping.acceptance import accept_greedily
from wayside.stages.mapping.hypotheses import Hypotheses, pair_hypotheses

FRAMES = 6


@pytest.fixture
def accepted(gap_px, window, standing):
    """Landmarks among panels (right, down, along, width, height, score) seen from six cameras."""

    def make(panels, fewest=3, noise_px=0.0):
        candidates = window(standing(panels, FRAMES), noise_px)
        pairs = [
            pair_hypotheses(candidates, a, b, gap_px)
            for b in range(FRAMES)
            for a in range(max(0, b - 3), b)
        ]
        hypotheses = Hypotheses.joined(
            [Hypotheses(one.point, one.size, np.zeros(len(one.point), bool)) for one in pairs]
        )
        free = np.ones(len(candidates.ray), bool)
        return accept_greedily(candidates, hypotheses, free, gap_px, fewest=fewest)

    return make


def test_the_best_landmark_comes_first_and_each_candidate_serves_once(accepted):
    fits = accepted([(3.5, -1.0, 60, 0.7, 0.7, 1.0), (-4, -1.0, 70, 0.7, 0.7, 3.0)])
    assert [round(f.point[2]) for f in fits] == [70, 60]
    views = [view for f in fits for view in zip(f.frames.tolist(), f.rows.tolist(), strict=True)]
    assert len(set(views)) == len(views) == 2 * FRAMES


def test_other_boxes_on_the_face_make_a_landmark_of_their_own(accepted):
    inner = (3.5, -1.0, 60, 0.55, 0.55, 0.5)
    fits = accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0), inner])
    assert [fit.rows.tolist() for fit in fits] == [[0] * FRAMES, [1] * FRAMES]


def test_noise_of_a_pixel_moves_a_landmark_as_its_covariance_says(accepted):
    (fit,) = accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], noise_px=0.7)
    gap = fit.point - [3.5, -1.0, 60]
    assert gap @ np.linalg.solve(fit.covariance, gap) < 16
    assert fit.rms_px < 2


def test_too_few_views_make_no_landmark(accepted):
    assert accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], fewest=FRAMES + 1) == []
