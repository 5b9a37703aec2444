import numpy as np
import pytest

from wayside.stages.mapping.residual_scale import Scatter


def test_a_drive_teaches_how_far_centres_scatter():
    rng = np.random.default_rng(3)
    scatter = Scatter()
    for _ in range(60):
        scatter.learn(0.1 * rng.chisquare(9), 9.0)
    assert scatter.usual == pytest.approx(0.1, rel=0.25)
    assert scatter.factor(0.1 * 9, 9.0) == pytest.approx(0.1, rel=0.2)


def test_the_first_places_are_believed_half_by_what_is_assumed():
    assert Scatter().factor(0.0, 8.0) == pytest.approx(0.5)


def test_one_bad_place_does_not_change_the_others():
    scatter = Scatter()
    for _ in range(10):
        scatter.learn(9.0, 9.0)
    scatter.learn(1e6, 9.0)
    assert scatter.usual == 1.0
    assert scatter.factor(1e9, 9.0) < 10
