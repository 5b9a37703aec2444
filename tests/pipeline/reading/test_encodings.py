import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayside.pipeline.reading.encodings import unpack_json
from wayside.pipeline.reading.image_headers import format_word, read_image_header


@pytest.mark.parametrize(
    "text",
    [
        '{"frame_id":"a","data":"/+8AAQ==","format":"jpeg"}',
        '{"frame_id":"a", "format":"jpeg" , "data" : "/+8AAQ=="}',
        '{"data": "\\/+8AAQ==", "frame_id":"a","format":"jpeg"}',
        '{"data": [255, 239, 0, 1], "frame_id":"a","format":"jpeg"}',
    ],
)
def test_json_images_are_unpacked_however_they_are_written(text):
    message, data = unpack_json(memoryview(text.encode()))
    assert bytes(data) == b"\xff\xef\x00\x01"
    assert (message.frame_id, message.format) == ("a", "jpeg")


def test_json_without_data_has_no_bytes():
    message, data = unpack_json(memoryview(json.dumps({"pose": {"y": 1.5}}).encode()))
    assert message.pose.y == 1.5
    assert len(data) == 0


@pytest.mark.parametrize("shape", [(1, 1), (24, 32), (700, 900)])
@pytest.mark.parametrize(
    ("suffix", "options", "name"),
    [
        (".jpg", [], "jpeg"),
        (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2], "jpeg"),
        (".png", [], "png"),
    ],
)
def test_the_size_of_an_image_is_read_from_its_header(shape, suffix, options, name):
    data = cv2.imencode(suffix, np.zeros((*shape, 3), np.uint8), options)[1].tobytes()
    assert read_image_header(memoryview(data)) == (name, shape[1], shape[0])


@given(st.binary(max_size=80), st.sampled_from([b"", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"]))
def test_no_bytes_make_the_header_reader_fail(content, begin):
    header = read_image_header(begin + content)
    assert header is None or (header.width > 0 and header.height > 0)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("jpeg", "jpeg"),
        ("jpg", "jpeg"),
        ("bgr8; jpeg compressed bgr8", "jpeg"),
        ("image/png", "png"),
        ("16UC1; compressedDepth", "16UC1; compressedDepth"),
    ],
)
def test_the_format_is_found_in_free_text(text, word):
    assert format_word(text) == word


@pytest.mark.parametrize("ends", ["", "=="])
@pytest.mark.parametrize("break_at", ["", "\\r\\n", "\\n", " "])
@pytest.mark.parametrize("plus", ["+", "\\u002B", "-"])
def test_base64_is_read_however_a_serialiser_writes_it(plus, break_at, ends):
    text = f'{{"data": "/{plus}8A{break_at}AQ{ends}"}}'
    _, data = unpack_json(memoryview(text.encode()))
    assert bytes(data) == b"\xff\xef\x00\x01"


@pytest.mark.parametrize(
    "fields",
    [
        {"width": "32"},
        {"width": 32.0},
        {"width": None},
        {"width": -32},
        {"width": True},
        {"height": 1 << 40},
        {"step": "x"},
        {"encoding": 5},
        {"frame_id": None},
        {"frame_id": "\ud800"},
        {"timestamp": {"sec": "1", "nsec": 0}},
        {"timestamp": {"sec": 1, "nsec": -1}},
        {"data": "####"},
        {"data": [256]},
        {"pose": {"position": {"x": True}}},
        {"latitude": "48"},
    ],
)
def test_json_with_a_value_of_another_type_is_no_message(fields):
    with pytest.raises(ValueError):  # noqa: PT011
        unpack_json(memoryview(json.dumps(fields).encode()))
