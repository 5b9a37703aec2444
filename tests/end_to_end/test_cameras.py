"""Cameras unlike those that were learned from: without colour, out of balance, of few pixels, or of a wrong lens."""

from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

import wayside
from wayside.pipeline.calibration.drives import calibrate_log
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.reading.calibrations import format_camera
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.frame import Camera
from wayside.schemas.settings import ReadSettings
from wayside.stages.calibration import describe_calibration
from wayside.stages.detection import proposals

from .conftest import altered_demo

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
REAL = Path(__file__).parents[2] / "shared" / "data" / "real"
NOTE = "the camera sees no colour"
UNTIL_S = 1.1


def three_channels(image):
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)


def infrared(image):
    """Nearly grey: a pink cast, and noise of each channel of its own."""
    noise = np.random.default_rng(int(image.sum())).normal(0, 5, image.shape)
    seen = three_channels(image) * np.array([1.04, 1.0, 1.06]) * 0.8 + noise
    return np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def fog(image):
    return np.rint(0.15 * image + 0.85 * 200).astype(np.uint8)


def one_channel(image):
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def grey_png(content):
    """The message of an image as grey PNG."""
    grey = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_GRAYSCALE)
    content.format, content.data = "png", cv2.imencode(".png", grey)[1].tobytes()
    return content


def grey_raw(content):
    """The message of an image as raw image without colour."""
    grey = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_GRAYSCALE)
    (height, width), stamp = grey.shape, content.timestamp
    raw = RawImage(frame_id=content.frame_id, width=width, height=height, step=width)
    raw.encoding, raw.data = "mono8", grey.tobytes()
    raw.timestamp.seconds, raw.timestamp.nanos = stamp.seconds, stamp.nanos
    return raw


def is_grey(log):
    """What reading says of the camera, in a note and of its images."""
    report = ReadReport()
    frames = read_frames(log, ReadSettings(), report)
    grey = {frame.grey for frame in islice(frames, 3)}
    assert grey == {any(NOTE in note for note in report.notes)}
    return grey == {True}


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ({"image": three_channels}, True),
        ({"image": one_channel}, True),
        ({"image": infrared}, True),
        ({"message": grey_png}, True),
        ({"message": grey_raw}, True),
        ({"image": fog}, False),
        ({"image": lambda image: image}, False),
    ],
)
def test_what_the_images_show_tells_whether_the_camera_sees_colour(tmp_path, how, expected):
    assert is_grey(altered_demo(tmp_path / "log.mcap", most=12, **how)) == expected


@pytest.fixture(scope="module")
def grey_demo(tmp_path_factory):
    return altered_demo(tmp_path_factory.mktemp("grey") / "grey.mcap", infrared, most=20)


def colorless(found):
    names = [name for name in found.signs.column_names if name.startswith("color")]
    tables = [found.signs[name].null_count == len(found.signs) for name in names]
    return "color" in names and all(tables)


@pytest.mark.parametrize(("preset", "until_s"), [("default", 0.7), ("report", 9.0)])
def test_no_sign_of_a_grey_camera_has_a_colour(grey_demo, preset, until_s):
    found = wayside.run(grey_demo, preset=preset, settings={"read.until_s": until_s})
    assert "sign" in found.signs["status"].to_pylist()
    assert colorless(found)


def test_a_real_grey_drive_has_no_colours_and_no_wrong_codes():
    log = REAL / "de_residential_kitti03a.mcap"
    if not log.is_file():
        pytest.skip(f"{log} is not here: KITTI, for tests only")
    found = wayside.run(log)
    rows = found.signs.to_pylist()
    assert len(rows) >= 3
    assert colorless(found)
    right = {"circle": {None, "C"}, "rectangle": {None, "E", "E14"}}  # no parking; parking
    assert all(row["mutcd"] is None and row["vienna"] in right[row["shape"]] for row in rows)


CAST = np.array([0.72, 1.0, 1.25])
"""Of blue, green, red."""


def signs_of(log):
    """Colour and shape of the signs at the start of a drive, in order."""
    found = wayside.run(log, settings={"read.until_s": UNTIL_S})
    rows = found.signs.filter(np.array(found.signs["status"]) == "sign")
    return list(zip(rows["color"].to_pylist(), rows["shape"].to_pylist(), strict=True))


def with_cast(image):
    return np.uint8(np.clip(np.rint(image * CAST), 0, 255))


def test_a_cast_of_the_camera_changes_no_colour(tmp_path):
    recorded, warm = signs_of(DEMO), altered_demo(tmp_path / "warm.mcap", with_cast, most=20)
    assert len({color for color, _ in recorded}) >= 3
    assert signs_of(warm) == recorded


SMALLER = 4
"""Focal length of 350 px, where the demo drive has 1,398 px."""


def halved_twice(image):
    size = image.shape[1] // SMALLER, image.shape[0] // SMALLER
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def scaled_down(calibration):
    """The calibration of these images, in place."""
    calibration.width //= SMALLER
    calibration.height //= SMALLER
    for matrix, columns in ((calibration.K, 3), (calibration.P, 4)):
        for row in range(2):
            matrix[row * columns + row] /= SMALLER
            matrix[row * columns + 2] = (matrix[row * columns + 2] + 0.5) / SMALLER - 0.5


def test_an_image_of_few_pixels_shows_more_where_it_is_seen_enlarged(tmp_path, monkeypatch):
    small = altered_demo(tmp_path / "small.mcap", halved_twice, scaled_down)
    enlarged = signs_of(small)
    monkeypatch.setattr(proposals, "SHORTEST_FOCAL_PX", 1.0)
    assert len(enlarged) > len(signs_of(small))


@pytest.mark.slow
def test_a_run_notes_a_lens_that_cannot_be_right_and_the_one_that_the_images_ask_for(
    run_demo, default_demo, true_boxes, tmp_path
):
    pq.write_table(pa.Table.from_pylist(true_boxes), tmp_path / "boxes.parquet")
    true = default_demo.about["camera"]
    wrong, boxes = tmp_path / "wrong.yaml", ("--detections", str(tmp_path / "boxes.parquet"))
    lens = {"fx": 1.1 * true["fx"], "fy": 1.1 * true["fx"], "distortion": true["distortion"][:2]}
    lens["distortion"] += [0.0, 0.0, 0.0]
    wrong.write_text(format_camera(Camera(**true | lens), "camera"))
    result = run_demo(*boxes, *("--calibration", str(wrong)))
    calibrated = calibrate_log(DEMO, load_settings(options={"read.calibration": str(wrong)})[0])
    same = calibrated.calibration.parameters["fx"]
    assert result.about["calibration"]["parameters"]["fx"] == same._asdict()
    assert abs(same.value / true["fx"] - 1) < 0.03
    words = describe_calibration(calibrated.calibration, str(wrong))
    assert any(note.startswith(words) for note in result.about["notes"])
    corrected = run_demo(*boxes, *("--calibration", str(wrong)), "--self-calibrate")
    assert corrected.about["camera"]["fx"] == pytest.approx(same.value)
    assert not corrected.about["calibration"]["refutes_given"]
