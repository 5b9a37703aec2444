"""A camera without colour gives no colour, and no code that rests on one; a colour camera in fog stays one."""

from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer

import wayside
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.settings import ReadSettings

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
REAL = Path(__file__).parents[2] / "shared" / "data" / "real"
NOTE = "the camera sees no colour"
UNTIL_S = 2.0


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


def is_grey(log):
    """What reading says of the camera, in a note and of its images."""
    report = ReadReport()
    frames = read_frames(log, ReadSettings(), report)
    grey = {frame.grey for frame in islice(frames, 3)}
    assert grey == {any(NOTE in note for note in report.notes)}
    return grey == {True}


@pytest.mark.parametrize(
    ("look", "expected"),
    [(three_channels, True), (one_channel, True), (infrared, True), (fog, False)],
)
def test_what_the_images_show_tells_whether_the_camera_sees_colour(
    altered_demo, tmp_path, look, expected
):
    assert is_grey(altered_demo(tmp_path / "log.mcap", look)) == expected


def test_the_recorded_drive_is_in_colour():
    assert not is_grey(DEMO)


@pytest.mark.parametrize("encoding", ["png", "mono8"])
def test_grey_images_of_other_encodings_are_grey(tmp_path, encoding):
    assert is_grey(other_encoding(tmp_path / "log.mcap", encoding))


def other_encoding(path, encoding):
    """The demo drive in grey PNG images, or raw ones."""
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    with DEMO.open("rb") as source, path.open("wb") as sink:
        writer = Writer(sink)
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in islice(reader.iter_decoded_messages(), 32):
            written = content
            if schema is not None and schema.name == "foxglove.CompressedImage":
                grey = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_GRAYSCALE)
                if encoding == "png":
                    content.format, content.data = "png", cv2.imencode(".png", grey)[1].tobytes()
                else:
                    height, width = grey.shape
                    written = RawImage(
                        frame_id=content.frame_id,
                        width=width,
                        height=height,
                        step=width,
                        encoding=encoding,
                        data=grey.tobytes(),
                    )
                    written.timestamp.seconds = content.timestamp.seconds
                    written.timestamp.nanos = content.timestamp.nanos
            writer.write_message(channel.topic, written, message.log_time, message.publish_time)
        writer.finish()
    return path


@pytest.fixture(scope="module")
def grey_demo(altered_demo, tmp_path_factory):
    return altered_demo(tmp_path_factory.mktemp("grey") / "grey.mcap", infrared)


def colorless(found):
    names = [name for name in found.signs.column_names if name.startswith("color")]
    tables = [found.signs[name].null_count == len(found.signs) for name in names]
    return "color" in names and all(tables)


def test_no_sign_of_a_grey_camera_has_a_colour(grey_demo):
    found = wayside.run(grey_demo, settings={"read.until_s": UNTIL_S})
    assert "sign" in found.signs["status"].to_pylist()
    assert colorless(found)


def test_nor_by_the_colour_gate_of_the_report(grey_demo):
    found = wayside.run(grey_demo, preset="report", settings={"read.until_s": UNTIL_S})
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
