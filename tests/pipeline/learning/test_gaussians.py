"""Gaussian classes of what stands where."""

import numpy as np
import pytest

from wayside.pipeline.learning.gaussians import location_model, moments


def test_no_axis_of_a_class_is_narrower_than_the_floor():
    values = np.tile([1.0, 2.0], (5, 1))
    mean, covariance = moments(values, np.full(5, 0.2), np.array([0.5, 0.1]))
    assert mean.tolist() == [1, 2]
    assert (np.sqrt(np.diag(covariance)) >= [0.5, 0.1]).all()


def test_signs_stand_right_left_and_above_of_the_road():
    rng = np.random.default_rng(2)
    places = np.concatenate(
        [
            rng.normal((6, 0.5), 0.5, (50, 2)),
            rng.normal((-8, 0.5), 0.5, (20, 2)),
            [(0, 4.5), (1, 4.6), (3, 4.4), (-1, 4.5)],
        ]
    )
    model = location_model(places, "made by hand")
    named = {one.name: one for one in model.classes}
    assert list(named) == ["right", "left", "overhead"]
    assert named["right"].mean == pytest.approx([6, 0.5], abs=0.3)
