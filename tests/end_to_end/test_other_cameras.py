"""A drive of a camera of few pixels, and one where traffic keeps left: both differ from what was learned from."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer

import wayside

DEMO = Path(__file__).parents[2] / "recordings" / "demo.mcap"
SMALLER = 4
"""Focal length of 350 px, where the demo drive has 1,398 px."""


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo drive in images of a quarter of the width and height."""
    path = tmp_path_factory.mktemp("small") / "small.mcap"
    with DEMO.open("rb") as source, path.open("wb") as sink:
        writer = Writer(sink)
        reader = make_reader(source, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages():
            if schema.name == "foxglove.CompressedImage":
                image = cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)
                size = image.shape[1] // SMALLER, image.shape[0] // SMALLER
                image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
                quality = (cv2.IMWRITE_JPEG_QUALITY, 90)
                content.data = cv2.imencode(".jpg", image, quality)[1].tobytes()
            if schema.name == "foxglove.CameraCalibration":
                content.width, content.height = content.width // SMALLER, content.height // SMALLER
                for matrix, rows in ((content.K, 3), (content.P, 4)):
                    for row in range(2):
                        matrix[row * rows + row] /= SMALLER
                        matrix[row * rows + 2] = (matrix[row * rows + 2] + 0.5) / SMALLER - 0.5
            writer.write_message(
                channel.topic,
                content,
                log_time=message.log_time,
                publish_time=message.publish_time,
            )
        writer.finish()
    return path


def signs_of(log: Path, **settings: float) -> int:
    """How many signs a run finds."""
    found = wayside.run(log, settings={k.replace("__", "."): v for k, v in settings.items()})
    return found.signs["status"].to_pylist().count("sign")


def test_an_image_of_few_pixels_shows_more_where_it_is_seen_enlarged(small: Path) -> None:
    enlarged, as_it_is = signs_of(small), signs_of(small, candidates__shortest_focal_px=1)
    assert enlarged >= as_it_is + 2


@pytest.mark.parametrize(
    ("settings", "noted"),
    [
        ({}, False),
        ({"verdict.left_traffic": 99}, True),
        ({"track.matching": "sift", "verdict.left_traffic": 99}, False),
    ],
)
def test_a_note_says_that_places_were_mirrored(settings: dict[str, object], noted: bool) -> None:
    found = wayside.run(DEMO, settings={"read.until_s": 1.1, **settings})
    assert any("traffic keeps left" in note for note in found.about["notes"]) == noted
