"""Scores made log odds."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from wayside.pipeline.learning.score_calibration import platt


def test_scores_that_part_both_kinds_have_finite_log_odds():
    scores = np.array([[-2.0], [-1.0], [1.0], [2.0]])
    (slope,), shift = platt(scores, scores[:, 0] > 0)
    assert 0 < slope < 10
    assert shift == pytest.approx(0, abs=1e-6)


def test_with_many_samples_the_log_odds_are_those_of_scikit_learn():
    random = np.random.default_rng(3)
    scores = random.normal(0, 2, (5000, 2))
    positive = random.random(5000) < 1 / (1 + np.exp(-(scores @ [0.5, 1.5] - 1)))
    slopes, shift = platt(scores, positive)
    wanted = LogisticRegression(C=np.inf, tol=1e-8).fit(scores, positive)
    assert (*slopes, shift) == pytest.approx((*wanted.coef_[0], *wanted.intercept_), abs=0.01)
