"""A drive of a camera of few pixels differs from what was learned from."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import wayside
from wayside.stages.detection import proposals

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
SMALLER = 4
"""Focal length of 350 px, where the demo drive has 1,398 px."""


def halved_twice(image):
    size = image.shape[1] // SMALLER, image.shape[0] // SMALLER
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def scaled_down(calibration):
    """The calibration of these images, in place."""
    calibration.width, calibration.height = (
        side // SMALLER for side in (calibration.width, calibration.height)
    )
    for matrix, columns in ((calibration.K, 3), (calibration.P, 4)):
        for row in range(2):
            matrix[row * columns + row] /= SMALLER
            matrix[row * columns + 2] = (matrix[row * columns + 2] + 0.5) / SMALLER - 0.5


@pytest.fixture(scope="module")
def small(altered_demo, tmp_path_factory):
    """The demo drive in images of a quarter of the width and height."""
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    return altered_demo(path, halved_twice, scaled_down)


def signs_of(log):
    """How many signs a run finds."""
    return wayside.run(log).signs["status"].to_pylist().count("sign")


def test_an_image_of_few_pixels_shows_more_where_it_is_seen_enlarged(small, monkeypatch):
    enlarged = signs_of(small)
    monkeypatch.setattr(proposals, "SHORTEST_FOCAL_PX", 1.0)
    assert enlarged > signs_of(small)
