"""`wayside calibrate` with images of a chessboard."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from wayside.pipeline.calibration.boards import calibrate_images, format_boards, parse_board
from wayside.pipeline.calibration.command import calibrate_by_boards
from wayside.pipeline.logs.importing import ImportOptions, import_images
from wayside.pipeline.reading.calibrations import read_camera_file
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError, OutputError, UsageError
from wayside.schemas.settings import ReadSettings
from wayside.stages.calibration import Board

from ..conftest import with_exif
from ..results import invoke
from .conftest import board_poses

REAL = Path(__file__).parents[4] / "shared" / "data" / "real" / "checkerboard_9x6"
BOARD = Board(9, 6, 0.0254)


@pytest.fixture(scope="module")
def boards(renderer, tmp_path_factory):
    """Nine rendered views of a board, and what else lies in such a folder."""
    folder = tmp_path_factory.mktemp("boards")
    for i, (rotation, shift) in enumerate(board_poses(9, 32.0)):
        cv2.imwrite(str(folder / f"board{i}.png"), renderer(rotation, shift, i))
    cut = cv2.imread(str(folder / "board0.png"), cv2.IMREAD_GRAYSCALE)
    corners = cv2.findChessboardCornersSB(cut, (9, 6))[1].reshape(-1, 2)
    cut[:, int(np.median(corners[:, 0])) :] = 200
    cv2.imwrite(str(folder / "cut.png"), cut)
    cv2.imwrite(str(folder / "empty.png"), np.full((360, 480), 128, np.uint8))
    cv2.imwrite(str(folder / "small.png"), np.full((240, 320), 128, np.uint8))
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff no image")
    (folder / "gone.png").symlink_to(folder / "none.png")
    return folder


@pytest.fixture(scope="module")
def found(boards):
    return calibrate_images([boards], BOARD, "plumb_bob")


def test_the_known_camera_of_rendered_boards_is_recovered(found, renderer):
    camera, true = found.calibration.camera, renderer.camera
    assert camera.fx == pytest.approx(true.fx, rel=0.003)
    assert camera.fy == pytest.approx(true.fy, rel=0.003)
    assert (camera.cx, camera.cy) == pytest.approx((true.cx, true.cy), abs=0.6)
    assert camera.distortion[:2] == pytest.approx(true.distortion[:2], abs=0.005)
    assert camera.distortion[4] == 0.0
    assert found.calibration.rms_px < 0.08
    truth = (true.fx, true.fy, true.cx, true.cy, *true.distortion)
    for one, value in zip(found.calibration.parameters, truth, strict=False):
        assert 0 < one.sigma
        assert abs(one.value - value) < 4 * max(one.sigma, one.spread), one.name


def test_images_that_are_not_used_are_named_with_the_reason(found):
    why = {image.path.name: image.why for image in found.failed}
    assert sorted(why) == ["broken.jpg", "cut.png", "empty.png", "gone.png", "small.png"]
    assert "decoded" in why["broken.jpg"]
    assert why["gone.png"] == "cannot be read: No such file or directory"
    assert "cut off" in why["cut.png"]
    assert "no board of 9 x 6" in why["empty.png"]
    assert "320 x 240 pixels, while most have 480 x 360" in why["small.png"]
    report = format_boards(found)
    assert all(f"{name}" in report and words in report for name, words in why.items())


def test_boards_that_are_to_be_shown_turned_are_refused(boards, tmp_path):
    data = cv2.imencode(".jpg", cv2.imread(str(boards / "board0.png")))[1].tobytes()
    (tmp_path / "board.jpg").write_bytes(with_exif(data, orientation=8))
    files = [*boards.glob("board*.png"), tmp_path / "board.jpg"]
    with pytest.raises(InputError, match=r"board\.jpg: .* turned by 90 degrees counterclockwise"):
        calibrate_images(files, BOARD, "plumb_bob")


@pytest.mark.slow
def test_a_view_with_wrong_corners_is_left_out(renderer, boards, tmp_path):
    names = [f"board{i}.png" for i in range(8)]
    for name in names:
        (tmp_path / name).write_bytes((boards / name).read_bytes())
    bent = cv2.imread(str(boards / "board3.png"), cv2.IMREAD_GRAYSCALE)
    v, u = np.mgrid[:360, :480].astype(np.float32)
    bent = cv2.remap(bent, u, v + 6 * np.sin(u / 40), cv2.INTER_LINEAR)  # the board is not flat
    cv2.imwrite(str(tmp_path / "board3.png"), bent)
    found = calibrate_images([tmp_path], BOARD, "plumb_bob")
    assert [image.path.name for image, view in found.seen if not view.used] == ["board3.png"]
    assert found.calibration.camera.fx == pytest.approx(renderer.camera.fx, rel=0.005)
    assert "left out" in format_boards(found)


def test_boards_parallel_to_the_image_are_refused(renderer, tmp_path):
    for i, (rotation, shift) in enumerate(board_poses(4, 0.0)):
        cv2.imwrite(str(tmp_path / f"{i}.png"), renderer(rotation, shift, i))
    with pytest.raises(InputError, match=r"focal length.*standard error.*tilted by"):
        calibrate_images([tmp_path], BOARD, "plumb_bob")


def test_too_few_boards_are_refused_with_every_reason(boards):
    files = [boards / name for name in ("board0.png", "board1.png", "empty.png")]
    with pytest.raises(InputError, match=r"4 views.*there are 2(.|\n)*empty.png: no board"):
        calibrate_images(files, BOARD, "plumb_bob")


def test_images_of_two_cameras_are_refused_with_their_names(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((480, 640), np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((240, 320), np.uint8))
    with pytest.raises(InputError, match=r"640 x 480: a.png; 320 x 240: b.png"):
        calibrate_images([tmp_path], BOARD, "plumb_bob")


def test_the_camera_file_serves_import_and_run(renderer, boards, tmp_path):
    out, images = tmp_path / "camera.yaml", [boards / f"board{i}.png" for i in range(5)]
    out.write_text("of before")
    said = invoke("calibrate", *images, "--board", "9x6", "-o", out, "--overwrite")
    words = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "distance squares", str(out))
    assert all(word in said for word in words)
    camera = read_camera_file(out)
    assert camera.fx == pytest.approx(renderer.camera.fx, rel=0.005)
    assert cv2.imread(str(tmp_path / "camera.coverage.png")).shape[1] == 1200
    assert sorted(p.name for p in tmp_path.iterdir()) == ["camera.coverage.png", "camera.yaml"]
    import_images(images[:2], out, tmp_path / "drive.mcap", ImportOptions(8.0))
    for settings in (ReadSettings(), ReadSettings(calibration=str(out))):
        frames = list(read_frames(tmp_path / "drive.mcap", settings, ReadReport()))
        assert {frame.camera for frame in frames} == {camera}


def test_existing_files_and_missing_folders_are_refused_before_any_work(tmp_path):
    out = tmp_path / "camera.yaml"
    out.write_text("mine")

    how = {"model": "plumb_bob", "name": "a", "coverage": None, "overwrite": False}
    with pytest.raises(OutputError, match=r"camera.yaml.*--overwrite"):
        calibrate_by_boards([], BOARD, out=out, **how)
    assert out.read_text() == "mine"
    with pytest.raises(OutputError, match="Make it first"):
        calibrate_by_boards([], BOARD, out=tmp_path / "none" / "camera.yaml", **how)


@pytest.mark.parametrize("text", ["9", "9x", "2x6", "x", "9x6x3", "-9x6"])
def test_a_board_that_is_none_is_refused(text):
    with pytest.raises(UsageError, match="inner corners"):
        parse_board(text, 1.0)


@pytest.mark.skipif(not REAL.is_dir(), reason="the real boards are not there")
@pytest.mark.slow
def test_real_boards_are_calibrated():
    found = calibrate_images([REAL], BOARD, "plumb_bob")
    camera = found.calibration.camera
    sigma = {one.name: max(one.sigma, one.spread) for one in found.calibration.parameters}
    published = {"fx": 1154.2, "fy": 1148.2, "cx": 671.6, "cy": 386.0}  # a fit to the same boards
    for name, value in published.items():
        assert abs(getattr(camera, name) - value) < 2 * sigma[name]
    failed = {image.path.stem: image.why for image in found.failed}
    assert sorted(failed) == ["calibration1", "calibration15", "calibration5", "calibration7"]
    assert "1281 x 721" in failed["calibration7"]
    assert "cut off" in failed["calibration1"]
