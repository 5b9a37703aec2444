"""Colour classes by Mahalanobis distance (eq. 3.1), and the gate by likelihood ratio (eq. 9.3)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis
from scipy.stats import multivariate_normal

from wayside.schemas.detections import COLORS, VERDICTS
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.report.color import classify_color
from wayside.stages.segmentation import unsegmented

from ..made_frames import made_image, made_regions


def model(threshold=0.0):
    means = {"yellow": (220.0, 180, 30), "red": (170.0, 30, 40)}
    covariance = np.array([[400.0, 200, 0], [200, 300, 50], [0, 50, 250]])
    classes = tuple(
        GaussianClass(name, np.array(mean), covariance, count)
        for (name, mean), count in zip(means.items(), (60, 40), strict=True)
    )
    greys = ((60.0, 30.0, 300), (140.0, 50.0, 100))
    background = tuple(
        GaussianClass("", np.full(3, level), np.eye(3) * sigma**2, count)
        for level, sigma, count in greys
    )
    return GaussianModel("rgb", classes, "test", background, threshold)


def segmented(rgb):
    regions = made_regions([[0, 0, 9, 9]] * len(rgb))
    regions = replace(regions, rgb=np.array(rgb, np.float32))
    return replace(unsegmented(made_image(np.zeros((9, 9, 3), np.uint8))), regions=regions)


def classify(rgb, **how):
    (classified,) = classify_color(iter([segmented(rgb)]), model=model(**how))
    return classified.candidates


def test_the_distance_is_that_of_scipy():
    rgb = np.random.default_rng(0).uniform(0, 255, (20, 3))
    candidates = classify(rgb)
    for i, color in enumerate(rgb.astype(np.float32)):
        wanted = [
            mahalanobis(color, one.mean, np.linalg.inv(one.covariance)) for one in model().classes
        ]
        assert candidates.color_distance[i] == pytest.approx(min(wanted), rel=1e-5)


def test_the_gate_is_the_ratio_of_the_likeliest_class_to_the_mixture_of_the_background():
    rgb = np.random.default_rng(0).uniform(0, 255, (50, 3))
    signs = [
        multivariate_normal(c.mean, c.covariance).logpdf(rgb) + np.log(c.count / 100)
        for c in model().classes
    ]
    dark, bright = (multivariate_normal(c.mean, c.covariance).pdf(rgb) for c in model().background)
    ratio = np.max(signs, axis=0) - np.log(0.75 * dark + 0.25 * bright)
    for threshold in (-5.0, 0.0, 5.0):
        stopped = classify(rgb, threshold=threshold).verdict == VERDICTS.index("color")
        assert stopped.tolist() == (ratio < threshold).tolist()


def test_the_nearest_class_is_taken_and_what_is_likelier_no_sign_stops_at_color():
    candidates = classify([(218, 178, 33)] * 4 + [(168, 33, 42)] * 4 + [(20, 60, 200)])
    assert [COLORS[c] for c in candidates.color[:8]] == ["yellow"] * 4 + ["red"] * 4
    assert [VERDICTS[v] for v in candidates.verdict] == ["open"] * 8 + ["color"]
    assert candidates.color_distance[8] > 3
