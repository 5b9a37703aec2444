import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.reading.calibrations import format_camera, parse_camera, read_camera_file
from wayside.schemas.errors import InputError
from wayside.schemas.frame import Camera

# as camera_calibration of ROS writes it
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [438.78, 0., 305.59, 0., 437.35, 243.74, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
"""
CAMERA = Camera(
    640, 480, 438.78, 437.35, 305.59, 243.74, (-0.361976, 0.110510, 0.001014, 0.000505, 0.0)
)


# camchain-imucam.yaml as kalibr_calibrate_cameras writes it
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.361976, 0.110510, 0.001014, 0.000505]
  distortion_model: radtan
  intrinsics: [438.78, 437.35, 305.59, 243.74]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""
MATRIX = "  rows: 3\n  cols: 3\n  data: [438.78, 0., 305.59, 0., 437.35, 243.74, 0., 0., 1.]"


@pytest.mark.parametrize(
    ("text", "distortion"),
    [
        (ROS, CAMERA.distortion),
        (
            ROS.replace(MATRIX, "  [[438.78, 0, 305.59], [0, 437.35, 243.74], [0, 0, 1]]"),
            CAMERA.distortion,
        ),
        (ROS.replace("438.78, 0.,", "438.78, 1e-12,"), CAMERA.distortion),  # a skew of rounding
        (KALIBR, CAMERA.distortion[:4]),
        (re.sub("coeffs: .*", "coeffs: []", KALIBR.replace("radtan", "none")), ()),
    ],
)
def test_calibrations_of_ros_and_kalibr_are_read(tmp_path, text, distortion):
    (tmp_path / "camera.yaml").write_text(text)
    assert read_camera_file(tmp_path / "camera.yaml") == replace(CAMERA, distortion=distortion)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "no named entries"),
        ("just text", "no named entries"),
        ("a: [1, 2", "not valid YAML"),
        (ROS.replace("image_height", "height"), "no image_height"),
        (ROS.replace("640", "wide"), "wide"),
        (ROS.replace("438.78", "0"), "not calibrated"),
        (ROS.replace("plumb_bob", "equidistant"), "equidistant"),
        (ROS.replace(", 0.000505, 0.000000]", "]"), "3 coefficients"),
        (ROS.replace("438.78, ", ""), "no focal length"),
        (ROS.replace("438.78", "1.0e-9"), "angle of view of 180 degrees"),
        (ROS.replace("437.35", "1.0e+9"), "angle of view"),
        (ROS.replace("305.59", "1.0e+9"), "lies far outside"),
        (ROS.replace("243.74", "-500"), "lies far outside"),
        (ROS.replace("640", "30000").replace("480", "30000"), "is not plausible"),
        (ROS.replace("640", "9" * 5000), ""),
        (ROS.replace("640", ".inf"), "infinity"),
        (ROS.replace("438.78", "[" * 30_000), "nested too deeply"),
        (ROS.replace("438.78", ".nan"), "no focal length"),
        (ROS + "#" * 70_000, "over 65536 characters"),
        (ROS.replace("438.78, 0.,", "438.78, 0.3,"), "skew (0.3 px)"),
        (ROS.replace("243.74, 0., 0., 1.]", "243.74, 0., 0.01, 1.]"), "not of the form"),
        *(("camera_matrix: " + bracket * 60_000, "too deeply") for bracket in "[{"),
        (KALIBR.replace("radtan", "equidistant"), "equidistant"),
        (KALIBR.replace("pinhole", "omni"), "camera model omni"),
        (KALIBR.replace("intrinsics: [", "intrinsics: [1.0, "), "with 5 numbers"),
        (KALIBR.replace("resolution", "size"), "cam0 has no resolution"),
        (KALIBR.replace("[640, 480]", "[640]"), ""),
        ("cam0: 1", "no named entries"),
        ("%YAML:1.0\n---\n" + ROS.replace("image_width", "w"), "no image_width"),
        ("%YAML:1.0\n---\nfisheye_model: 1\n" + ROS, "fisheye"),
        ("%YAML:1.0\n---\ncamera_matrix: !!python/object:os.system []\n", "not valid YAML"),
    ],
)
def test_what_is_no_calibration_says_why(text, found):
    with pytest.raises(InputError, match=r"camera.yaml: this is not a camera calibration") as error:
        parse_camera(text, "camera.yaml")
    assert found in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"camera.yaml.*Check the name"):
        read_camera_file(tmp_path / "camera.yaml")


small = st.floats(-5e-3, 5e-3)


@st.composite
def cameras(draw):
    side, focal = draw(st.integers(1, 9999)), st.floats(50, 100)
    center, length = st.floats(0, side), draw(st.sampled_from((4, 5, 8)))
    lens = draw(st.lists(small, min_size=length, max_size=length))
    lengths = side * draw(focal), side * draw(focal)
    return Camera(side, side, *lengths, draw(center), draw(center), tuple(lens))


@given(camera=cameras(), name=st.text(max_size=20))
def test_a_written_camera_is_read_back_as_it_was(camera, name):
    text = format_camera(camera, name, ["a line", "fx 3 +- 1: # [x]"])
    assert parse_camera(text, "camera.yaml") == (
        camera if any(camera.distortion) else replace(camera, distortion=())
    )


@pytest.mark.parametrize(
    "keys",
    [
        ("image_width", "image_height", "camera_matrix", "distortion_coefficients"),
        ("image_Width", "image_Height", "Camera_Matrix", "Distortion_Coefficients"),
        ("width", "height", "K", "D"),
    ],
)
@pytest.mark.parametrize("coefficients", [5, 8, 14])
def test_a_file_that_opencv_wrote_is_read(tmp_path, keys, coefficients):
    path = tmp_path / "camera.yml"
    distortion = np.random.default_rng(coefficients).normal(0, 0.01, (coefficients, 1))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Thu 14 May 2009 10:31:07 AM")
    storage.write(keys[0], 640)
    storage.write(keys[1], 480)
    storage.write(keys[2], CAMERA.matrix)
    storage.write(keys[3], distortion)
    storage.release()
    head, rest = path.read_text().split("\n", 1)
    assert head == "%YAML 1.2"  # OpenCV 5
    for first_line in (head, "%YAML:1.0"):  # OpenCV to version 4
        path.write_text(f"{first_line}\n{rest}")
        wanted = replace(CAMERA, distortion=tuple(distortion.ravel().tolist()))
        assert read_camera_file(path) == wanted
