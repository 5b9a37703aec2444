import numpy as np
import pytest

from wayside.schemas.settings import LandmarkSettings
from wayside.stages.mapping.residual_scale import ResidualScale


def test_a_drive_teaches_how_far_centres_scatter():
    rng = np.random.default_rng(3)
    scale = ResidualScale(LandmarkSettings())
    for _ in range(60):
        scale.learn(0.1 * rng.chisquare(9), 9.0)
    assert scale.usual == pytest.approx(0.1, rel=0.25)
    assert scale.factor(0.1 * 9, 9.0) == pytest.approx(0.1, rel=0.2)


def test_the_first_landmarks_are_believed_half_by_what_is_assumed():
    assert ResidualScale(LandmarkSettings()).factor(0.0, 8.0) == pytest.approx(0.5)


def test_one_bad_landmark_does_not_change_the_others():
    scale = ResidualScale(LandmarkSettings())
    for _ in range(10):
        scale.learn(9.0, 9.0)
    scale.learn(1e6, 9.0)
    assert scale.usual == 1.0
    assert scale.factor(1e9, 9.0) < 10
