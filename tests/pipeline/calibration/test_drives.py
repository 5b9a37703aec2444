"""`wayside calibrate` with the log of a drive."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from wayside.pipeline.calibration import drives
from wayside.pipeline.calibration.drives import (
    FOCAL_GUESSES,
    CalibratedDrive,
    calibrate_log,
    format_drive,
)
from wayside.pipeline.logs.importing import ImportOptions, import_images
from wayside.pipeline.reading.calibrations import format_camera
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import Settings
from wayside.stages.calibration import DriveCalibration

from ..results import invoke

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
TRUE = Camera(1600, 1200, 1398.0, 1398.0, 796.0, 602.5, (-0.105, 0.048, 0.0003, 0.0002, -0.008))
WRONG = replace(TRUE, fx=1.1 * TRUE.fx, fy=1.1 * TRUE.fy)


def result(lens=(0.0, 0.0), sigma=0.01, source="/camera/info"):
    """A calibration that changes the logarithm of the focal length and k1 of the wrong camera."""
    covariance = np.diag([sigma**2, 4.0, 9.0, 1e-4, 1e-4])
    change = np.array([lens[0], 0.0, 0.0, lens[1], 0.0])
    found = DriveCalibration(WRONG, change, covariance, 1.0, 1.0, 2, 900)
    return CalibratedDrive(Path("drive.mcap"), source, found)


def test_every_parameter_decides_whether_the_calibration_given_can_be_right():
    focal, distortion = format_drive(result((-np.log(1.1), 0.0))), format_drive(result((0.0, 0.12)))
    for words in (focal, distortion):
        assert "(/camera/info) cannot be right" in words
        assert "k1" in words
    assert "fx 1398 ± 14 (given 1538)" in focal
    assert "k1 0.015 ± 0.01 (given -0.105)" in distortion
    assert "agrees with the motion in the images" in format_drive(result((0.005, 0.01)))
    assert "agrees" in format_drive(result((-0.02, 0.0), sigma=0.001))  # sure, but too little
    assert "no calibration was given" in format_drive(result(source=""))


def test_a_drive_that_does_not_determine_the_focal_length_is_told_with_its_error():
    result(sigma=0.029).require_determined()
    with pytest.raises(InputError, match=r"standard error of 18.2 %.*curves"):
        result(sigma=0.182).require_determined()


def test_images_without_common_points_are_refused(tmp_path):
    camera = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
    (tmp_path / "camera.yaml").write_text(format_camera(camera, "camera"))
    rng = np.random.default_rng(1)
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"{i}.png"), rng.integers(0, 255, (48, 64), np.uint8))
    log = tmp_path / "drive.mcap"
    import_images(
        [tmp_path / f"{i}.png" for i in range(4)], tmp_path / "camera.yaml", log, ImportOptions(8.0)
    )
    with pytest.raises(InputError, match="too few points in common"):
        calibrate_log(log, Settings())


@pytest.mark.parametrize("fitting", [(), (2,), (0, 2)])
def test_a_focal_length_that_cannot_be_matched_from_leaves_the_others(monkeypatch, fitting):
    guesses = [round(1600 * one) for one in FOCAL_GUESSES]
    costs = {guesses[k]: 1.0 + k for k in fitting}

    def matched(log, camera, settings):
        cost = costs.get(round(camera.fx))
        return None if cost is None else replace(result().calibration, given=camera, cost=cost)

    monkeypatch.setattr(drives, "_source", lambda *_: "")
    monkeypatch.setattr(drives, "_estimate", matched)
    if not fitting:
        with pytest.raises(InputError, match="too few points in common"):
            calibrate_log(DEMO, Settings())
        return
    assert round(calibrate_log(DEMO, Settings()).calibration.camera.fx) == guesses[fitting[0]]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["drive.mcap", "--square", "25mm"], "--board 9x6"),
        (["boards", "--board", "9x6", "--spacing", "8m"], "options of a log"),
        (["a.mcap", "b.mcap"], "2 logs"),
        (
            ["boards", "--board", "9x6", "--model", "fisheye"],
            r"no lens model fisheye.* plumb_bob .* --model rational .* remap",
        ),
    ],
)
def test_options_of_boards_and_of_logs_are_not_mixed(arguments, words):
    with pytest.raises(UsageError, match=words):
        invoke("calibrate", *arguments)


@pytest.mark.slow
def test_a_drive_without_calibration_is_calibrated(monkeypatch):
    monkeypatch.setattr(drives, "_source", lambda *_: "")
    found = calibrate_log(DEMO, Settings()).calibration
    assert abs(np.log(found.camera.fx / TRUE.fx)) < 2 * found.focal_sigma < 0.1
