import json

import pytest

from wayside.pipeline.reading.encodings import unpack_json


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
