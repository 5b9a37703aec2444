import numpy as np
import pytest

from wayside.stages.mapping.landmark_fit import fit_views, metric_size

FRAMES = 6


def test_the_size_is_the_median_of_the_nearest_whole_views():
    sizes = np.array([[0.9, 0.9], [0.7, 0.5], [0.72, 0.5], [0.3, 0.2]])
    depth = np.array([40.0, 24.0, 16.0, 8.0])
    whole = np.array([True, True, True, False])
    middle, scatter = metric_size(sizes, depth, whole)
    assert middle == pytest.approx([0.72, 0.5])
    assert (scatter > 0).all()


def test_nearly_parallel_rays_make_no_landmark(window, standing):
    candidates = window(standing([(3.5, -1.0, 5e6, 1e5, 1e5, 1.0)], FRAMES))
    assert fit_views(candidates, np.arange(FRAMES), np.arange(FRAMES), nearest=2) is None
