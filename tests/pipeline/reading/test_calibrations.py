"""Which calibration an image topic gets, and which of the matrices of its message."""

import numpy as np
import pytest

from wayside.pipeline.logs.information import format_log, inspect_log
from wayside.pipeline.reading.calibrations import (
    Region,
    is_rectified,
    make_calibration,
    make_camera,
)
from wayside.pipeline.reading.contents import ContentError
from wayside.schemas.errors import InputError

from .conftest import read

SIZE, K = (1600, 1200), (1398.0, 0.0, 796.0, 0.0, 1398.0, 602.5, 0.0, 0.0, 1.0)
LENS = ("plumb_bob", (-0.105, 0.048, 0.0003, 0.0002, -0.008))
HALF = (699.0, 0.0, 398.0, 0.0, 699.0, 301.25, 0.0, 0.0, 1.0)


def projection(k):
    return (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0)


def first_camera(path, topic=""):
    return read(path, camera=topic, spacing_m=8.0)[0][0].camera


def two_cameras(log, frames=("left_optical", "right_optical"), calibration="/right/camera_info"):
    log.add(calibration, "calibration", 0, frame=frames[1])
    log.add_image(0, topic="/left/image", frame=frames[0])
    log.add_image(0, topic="/right/image", frame=frames[1])
    return log.finish()


@pytest.mark.parametrize("frames", [("left_optical", "right_optical"), ("", ""), ("cam", "cam")])
def test_the_calibration_of_another_camera_is_refused_by_frame_or_name(new_log, frames):
    path = two_cameras(new_log("cdr"), frames)
    assert first_camera(path, "/right/image").fx == 40.0
    with pytest.raises(InputError, match=r"is of another camera.*right.*--calibration camera.yaml"):
        first_camera(path, "/left/image")
    text = format_log(inspect_log(path))
    assert "cannot be used yet: there is no calibration of /left/image" in text


@pytest.mark.parametrize(
    ("image", "calibration", "contradiction"),
    [
        (("/cam_left/image", ""), ("/cam_right/camera_info", ""), "of another camera by its name"),
        (("/cam0/image_raw", ""), ("/cam1/camera_info", ""), "of another camera by its name"),
        (("/camera/image_raw", "camera_optical"), ("/calib/x", ""), None),
        (("/camera/image_raw", ""), ("/calib/x", "camera_optical"), None),
        (("/camera/image_raw", "camera_optical_frame"), ("/calib/x", "/camera_link"), None),
        (("/camera/image_raw", "usb_cam"), ("/camera/info", "camera"), None),
    ],
)
def test_a_calibration_that_neither_frame_nor_name_contradicts_is_used(
    new_log, image, calibration, contradiction
):
    log = new_log("cdr")
    log.add(calibration[0], "calibration", 0, frame=calibration[1])
    log.add_image(0, topic=image[0], frame=image[1])
    path = log.finish()
    if contradiction is None:
        assert first_camera(path).fx == 40.0
    else:
        with pytest.raises(InputError, match=contradiction):
            first_camera(path)


def test_a_calibration_that_may_be_of_either_camera_is_refused(new_log):
    path = two_cameras(new_log("cdr"), ("", ""), "/calibration")
    with pytest.raises(InputError, match="nothing tells whether it is of this camera"):
        first_camera(path, "/left/image")


def test_calibrations_of_another_camera_on_the_same_topic_are_passed_over(new_log):
    log = new_log("cdr")
    other = [99.0, 0.0, 15.5, 0.0, 99.0, 11.5, 0.0, 0.0, 1.0]
    for index in range(4):
        log.add("/infos", "calibration", 1000 * index, frame="left")
        log.add("/infos", "calibration", 1000 * index + 1, frame="right", k=other)
        for side in ("left", "right"):
            log.add_image(index, topic=f"/{side}/image", frame=side)
    frames, _ = read(log.finish(), camera="/left/image", spacing_m=8.0)
    assert {frame.camera.fx for frame in frames} == {40.0}


def test_two_calibrations_that_differ_are_named(new_log):
    log = new_log("cdr")
    log.add("/cam/info_a", "calibration", 0)
    log.add("/cam/info_b", "calibration", 0, k=[50.0, 0, 15.5, 0, 50.0, 11.5, 0, 0, 1])
    log.add_image(0, topic="/cam/image")
    with pytest.raises(InputError, match="/cam/info_a and /cam/info_b, which differ"):
        first_camera(log.finish())


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/camera/image_rect_color/compressed", True),
        ("/CAM_FRONT/image_rect_compressed", True),
        ("/camera/infra1/image_rect_raw", True),
        ("/zed/left/rect/image", True),
        ("/camera/image_raw", False),
        ("/direct/image", False),
        ("/camera/image_unrectified", False),
    ],
)
def test_rectified_images_are_told_by_a_word_of_their_topic(topic, rectified):
    assert is_rectified(topic) is rectified


def test_rectified_images_have_the_projection_without_distortion():
    p = projection((1350.0, *K[1:4], 1370.0, *K[5:]))
    content = make_calibration(0, "", SIZE, K, p, LENS, Region())
    camera = content.camera_for(SIZE, rectified=True)
    assert (camera.fx, camera.fy, camera.distortion) == (1350.0, 1370.0, ())
    assert content.camera_for(SIZE, rectified=False).distortion == LENS[1]
    fisheye = make_calibration(0, "", SIZE, K, p, ("equidistant", LENS[1][:4]), Region())
    assert fisheye.camera_for(SIZE, rectified=True) == camera
    assert fisheye.camera_for(SIZE, rectified=False) is None


def test_without_a_projection_rectified_images_need_a_matrix_without_distortion():
    content = make_calibration(0, "", SIZE, K, (0.0,) * 12, LENS, Region())
    assert content.camera_for(SIZE, rectified=True) is None
    assert "no P" in content.why_rectified
    own = make_calibration(0, "", SIZE, K, (), ("plumb_bob", (0.0,) * 5), Region())
    assert own.camera_for(SIZE, rectified=True).fx == K[0]


REGION = Region(0, 100, 1600, 900)
CUT = (*K[:5], 502.5, *K[6:])


@pytest.mark.parametrize(
    ("size", "k", "region", "images", "found"),
    [
        (SIZE, K, Region(bin_x=2, bin_y=2), (800, 600), HALF),
        ((800, 600), HALF, Region(bin_x=2, bin_y=2), (800, 600), HALF),
        (SIZE, K, Region(bin_x=2, bin_y=2), SIZE, K),
        (SIZE, K, REGION, (1600, 900), CUT),
        (SIZE, K, REGION._replace(bin_x=2, bin_y=2), (800, 450), (*HALF[:5], 251.25, *HALF[6:])),
    ],
)
def test_binning_and_region_are_applied_to_the_matrix_of_the_full_sensor(
    size, k, region, images, found
):
    content = make_calibration(0, "", size, k, projection(k), LENS, region)
    for rectified in (False, True):
        camera = content.camera_for(images, rectified=rectified)
        assert (camera.width, camera.height) == images
        np.testing.assert_allclose(camera.matrix.ravel(), found)


@pytest.mark.parametrize(
    ("k", "region", "why"),
    [
        (HALF, Region(bin_x=2, bin_y=2), "is not that of the full sensor"),
        (CUT, REGION, "is not that of the full sensor"),
        (K, Region(0, 400, 1600, 900), "reaches beyond its 1600 x 1200"),
        ((0.0,) * 9, Region(bin_x=2, bin_y=2), "not calibrated"),
    ],
)
def test_a_matrix_that_is_not_of_the_full_sensor_is_refused(k, region, why):
    content = make_calibration(0, "", SIZE, k, (), LENS, region)
    images = region.width // region.bin_x or 800, region.height // region.bin_y or 600
    assert content.camera_for(images, rectified=False) is None
    assert why in content.why


NO_LENS = [(k, 0, 0, 0, 0) for k in (1e10, -1e10, 100.0, -1.0)]
NO_LENS += [(0, 0, 1000.0, 0, 0), (0, 0, 0, -3.0), (0.1, 0, 0, 0, 0, -3.0, 0, 0)]
"""Distortions that fold or tear the image."""


@pytest.mark.parametrize(
    ("k", "model", "coefficients", "why"),
    [
        *((K, "", d, "fits no lens") for d in NO_LENS),
        *(
            (K, model, d, f"lens model {model} is not supported")
            for model in ("equidistant", "fisheye", "Kannala_Brandt", "omni")
            for d in ((0.0,) * 4, ())
        ),
        ((*K[:4], 139.8, *K[5:]), "", (), r"focal lengths 1398 and 139\.8"),
    ],
)
def test_a_lens_that_cannot_be_is_refused(k, model, coefficients, why):
    with pytest.raises(ContentError, match=why):
        make_camera(SIZE, k, model, coefficients)


KITTI = (903.7596, 0, 695.7519, 0, 901.9653, 224.2509, 0, 0, 1)
"""Unrectified: its map turns back a hundredth before the corners."""


@pytest.mark.parametrize(
    ("size", "k", "d"),
    [
        ((1392, 512), KITTI, (-0.3639558, 0.1788651, 6.029694e-4, -3.922424e-4, -0.0538246)),
        (
            (1280, 720),
            (1156.0, 0, 672.2, 0, 1150.6, 388.6, 0, 0, 1),
            (-0.248, -0.0195, -6e-4, 2e-4, 8.6e-3),
        ),
        ((1280, 720), (800.0, 0, 639.5, 0, 800.0, 359.5, 0, 0, 1), (-0.168, 0, 0, 0, 0)),
        ((640, 480), (9000.0, 0, 320.0, 0, 9000.0, 240.0, 0, 0, 1), (5.0, 0, 0, 0)),  # telescope
        (SIZE, (*K[:4], 699.0, *K[5:]), ()),  # pixels twice as wide as high
    ],
)
def test_lenses_that_exist_are_read(size, k, d):
    assert make_camera(size, k, "plumb_bob", d).distortion == d


@pytest.mark.parametrize("model", ["", "none", "pinhole", "Plumb Bob", "inverse_brown_conrady"])
def test_a_pinhole_has_many_names(model):
    assert make_camera(SIZE, K, model, (0.0,) * 5).distortion == ()
