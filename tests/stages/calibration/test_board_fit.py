"""Corners of boards, projected by OpenCV through an equidistant lens, which no lens model describes."""

import re

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayside.stages.calibration import Board, CalibrationError, board_fit, calibrate_boards

BOARD, SIZE, FOCAL, NOISE_PX = Board(9, 6, float("nan")), (1280, 960), 520.0, 0.1


@pytest.fixture(scope="module")
def views():
    """Twelve boards, out to 60 degrees off the axis of a lens of 140 degrees."""
    rng, found = np.random.default_rng(0), []
    matrix = np.array([[FOCAL, 0, 640], [0, FOCAL, 480], [0, 0, 1.0]])
    lens = np.array([-0.02, 0.005, -0.003, 0.0005])
    points = BOARD.points.astype(np.float64)
    while len(found) < 12:
        angles = [*rng.uniform(-40, 40, 2), rng.uniform(-10, 10)]
        turn = Rotation.from_euler("xyz", angles, degrees=True)
        off, round_axis = np.radians(rng.uniform(0, 60)), rng.uniform(0, 2 * np.pi)
        aside = np.sin(off) * np.array([np.cos(round_axis), 0.7 * np.sin(round_axis)])
        centre = rng.uniform(6, 14) * np.array([*aside, np.cos(off)])
        placed = turn.apply(points - points.mean(axis=0)) + centre
        pixels, _ = cv2.fisheye.projectPoints(
            placed[:, None], np.zeros(3), np.zeros(3), matrix, lens
        )
        pixels = pixels[:, 0]
        if placed[:, 2].min() > 0.5 and (pixels > 5).all() and (pixels < np.array(SIZE) - 5).all():
            found.append(pixels + rng.normal(0, NOISE_PX, pixels.shape))
    return found


def test_a_fisheye_needs_the_rational_model_and_a_refusal_says_the_residual_of_each(
    views, monkeypatch
):
    monkeypatch.setattr(board_fit, "LARGEST_SIGMA", 0.001)
    with pytest.raises(CalibrationError, match="Residuals by lens model") as refused:
        calibrate_boards(views, BOARD, SIZE, "plumb_bob")
    monkeypatch.undo()
    told = dict(re.findall(r"(plumb_bob|rational) (\d+\.\d+)", str(refused.value)))
    found = calibrate_boards(views, BOARD, SIZE, "rational")
    assert found.camera.fx == pytest.approx(FOCAL, rel=0.003)
    assert found.rms_px == pytest.approx(found.by_model["rational"])
    assert float(told["rational"]) < 1.1 * NOISE_PX * np.sqrt(2)
    for model in (told, found.by_model):
        assert float(model["plumb_bob"]) > 5 * float(model["rational"])
