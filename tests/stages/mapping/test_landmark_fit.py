from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping.association import Hypotheses, pair_hypotheses
from wayside.stages.mapping.landmark_fit import accept_greedily

from .made_windows import GAP_PX, fitted, standing, window

FRAMES = 6


def accepted(panels, fewest=3, noise_px=0.0):
    """Landmarks among panels (right, down, along, width, height, score) seen from six cameras."""
    candidates = window(standing(panels, FRAMES), noise_px)
    pairs = [(range(max(0, k - 3), k), k) for k in range(1, FRAMES)]
    found = [pair_hypotheses(candidates, *pair, GAP_PX)[1] for pair in pairs]
    free = np.ones(len(candidates.table), bool)
    settings = replace(TrackSettings(), fewest_views=fewest)
    return accept_greedily(candidates, Hypotheses.joined(found), free, settings)


def test_the_best_landmark_comes_first_and_each_candidate_serves_once():
    fits = accepted([(3.5, -1.0, 60, 0.7, 0.7, 1.0), (-4, -1.0, 70, 0.7, 0.7, 3.0)])
    assert [round(f.point[2]) for f in fits] == [70, 60]
    views = [view for f in fits for view in zip(f.frames.tolist(), f.rows.tolist(), strict=True)]
    assert len(set(views)) == len(views) == 2 * FRAMES


def test_other_boxes_on_the_face_make_a_landmark_of_their_own():
    inner = (3.5, -1.0, 60, 0.55, 0.55, 0.5)
    fits = accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0), inner])
    assert [fit.rows.tolist() for fit in fits] == [[0] * FRAMES, [1] * FRAMES]


def test_noise_of_a_pixel_moves_a_landmark_as_its_covariance_says():
    (fit,) = accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], noise_px=0.7)
    gap = fit.point - [3.5, -1.0, 60]
    assert gap @ np.linalg.solve(fit.covariance, gap) < 16
    assert fit.rms_px < 2


def test_a_length_that_the_kernels_would_run_over_is_refused():
    candidates, nothing = window(standing([], 3)), Hypotheses(*np.empty((2, 0, 3)), np.empty(0))
    with pytest.raises(ValueError, match="free"):
        accept_greedily(candidates, nothing, np.ones(2, bool), TrackSettings())


def test_too_few_views_make_no_landmark():
    assert accepted([(3.5, -1.0, 60, 0.7, 0.7, 2.0)], fewest=FRAMES + 1) == []


def test_the_size_is_the_median_of_the_nearest_whole_views():
    wide = (0.8, 0.8, 0.8, 0.7, 0.71, 0.72, 0.73, 0.74, 0.75, 0.6)
    candidates = window([[(3.5, -1.0, 100.0 - 8 * k, w, 0.5, 1.0)] for k, w in enumerate(wide)])
    candidates.table["whole"][-1] = False
    fit = fitted(candidates)
    assert len(fit.frames) == len(wide)
    assert fit.metric == pytest.approx([0.725, 0.5])
    assert (fit.spread > 0).all()


def test_nearly_parallel_rays_make_no_landmark():
    assert fitted(window(standing([(3.5, -1.0, 5e6, 1e5, 1e5, 1.0)], 2))) is None
