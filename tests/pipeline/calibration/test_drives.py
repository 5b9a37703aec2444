"""`wayside calibrate` with the log of a drive."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from wayside.pipeline.calibration import drives
from wayside.pipeline.calibration.drives import (
    FOCAL_GUESSES,
    CalibratedDrive,
    calibrate_log,
    format_drive,
)
from wayside.pipeline.cli import app
from wayside.pipeline.logs.importing import import_images
from wayside.pipeline.reading.calibrations import format_camera, read_camera_file
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import Camera
from wayside.schemas.settings import Settings
from wayside.stages.calibration import DriveCalibration

DEMO = Path(__file__).parents[3] / "recordings" / "demo.mcap"
TRUE = Camera(1600, 1200, 1398.0, 1398.0, 796.0, 602.5, (-0.105, 0.048, 0.0003, 0.0002, -0.008))
WRONG = replace(TRUE, fx=1.1 * TRUE.fx, fy=1.1 * TRUE.fy)


def result(sigma, given=WRONG):
    covariance = np.diag([sigma**2, 4.0, 9.0, 1e-4, 1e-4])
    found = DriveCalibration(TRUE, np.zeros(5), covariance, 1.0, 1.0, 2, 900)
    return CalibratedDrive(Path("drive.mcap"), given, "/camera/info", 24, found)


def test_the_report_compares_with_the_calibration_given():
    words = format_drive(result(0.01))
    assert "10.0 % longer, 10.0 standard errors: it does not agree" in words
    assert "1398" in words
    assert "1537.8" in words
    assert "14" in words.split("fx", 1)[1].splitlines()[0].split()  # 1 % of 1398 px
    assert "it agrees" in format_drive(result(0.06))
    assert "no calibration was given" in format_drive(result(0.01, given=None))


def test_a_drive_that_does_not_determine_the_focal_length_is_told_with_its_error():
    result(0.029).require_determined()
    with pytest.raises(InputError, match=r"standard error of 18.20 %.*curves"):
        result(0.182).require_determined()


def test_images_without_common_points_are_refused(tmp_path):
    camera = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
    (tmp_path / "camera.yaml").write_text(format_camera(camera, "camera"))
    rng = np.random.default_rng(1)
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"{i}.png"), rng.integers(0, 255, (48, 64), np.uint8))
    log = tmp_path / "drive.mcap"
    import_images([tmp_path / f"{i}.png" for i in range(4)], tmp_path / "camera.yaml", 8.0, log)
    with pytest.raises(InputError, match=r"none of the 4 images .* points in common"):
        calibrate_log(log, Settings())


@pytest.mark.parametrize("fitting", [(), (2,), (0, 2)])
def test_a_focal_length_that_cannot_be_matched_from_leaves_the_others(monkeypatch, fitting):
    settings = Settings()
    guesses = [round(1600 * one) for one in FOCAL_GUESSES]
    costs = {guesses[k]: 1.0 + k for k in fitting}

    def matched(log, camera, principal_sigma_px, settings):
        if round(camera.fx) not in costs:
            raise InputError("found none")
        found = replace(result(0.01).calibration, camera=camera, cost=costs[round(camera.fx)])
        return 24, found

    monkeypatch.setattr(drives, "_given", lambda *_: (None, ""))
    monkeypatch.setattr(drives, "_round", matched)
    if not fitting:
        with pytest.raises(InputError, match="found none"):
            calibrate_log(DEMO, settings)
        return
    assert round(calibrate_log(DEMO, settings).calibration.camera.fx) == guesses[fitting[0]]


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
    outcome = CliRunner().invoke(app, ["calibrate", *arguments])
    assert isinstance(outcome.exception, UsageError)
    assert re.search(words, str(outcome.exception))


@pytest.mark.slow
@pytest.mark.parametrize("given", [WRONG, None])
def test_the_demo_drive_corrects_a_focal_length_off_by_a_tenth(tmp_path, given, monkeypatch):
    if given is None:  # as if the log had no calibration
        monkeypatch.setattr(drives, "_given", lambda *_: (None, ""))
        found = calibrate_log(DEMO, Settings()).calibration
        assert abs(np.log(found.camera.fx / TRUE.fx)) < 2 * found.focal_sigma < 0.1
        return
    start, out = tmp_path / "wrong.yaml", tmp_path / "camera.yaml"
    start.write_text(format_camera(given, "camera"))
    command = ["calibrate", str(DEMO), "--calibration", str(start), "-o", str(out)]
    outcome = CliRunner().invoke(app, command)
    assert outcome.exit_code == 0, outcome.output
    assert "it does not agree" in outcome.output
    assert read_camera_file(out).fx == pytest.approx(TRUE.fx, rel=0.022)
