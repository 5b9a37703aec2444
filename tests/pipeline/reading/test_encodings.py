import json
from itertools import product

import pytest
from mcap.records import Schema

from wayside.pipeline.reading.contents import ContentError
from wayside.pipeline.reading.layout import Channel
from wayside.pipeline.reading.messages import Decoders

IMAGE = {"frame_id": "a", "encoding": "rgb8", "data": "", "width": 8, "height": 8, "step": 24}
POINT = {"x": 0.0, "y": 0.0, "z": 0.0}
POSE = {"frame_id": "a", "pose": {"position": POINT, "orientation": {**POINT, "w": 1.0}}}
CALIBRATION = {"frame_id": "a", "width": 8, "height": 8, "K": [8, 0, 4, 0, 8, 4, 0, 0, 1]}
SOUND = {
    "foxglove.RawImage": IMAGE,
    "foxglove.PoseInFrame": POSE,
    "foxglove.CameraCalibration": CALIBRATION,
    "foxglove.LocationFix": {"latitude": 48.0, "longitude": 11.0, "altitude": 0.0},
}


def decode(name, content):
    schema = Schema(id=1, name=name, encoding="jsonschema", data=b"{}")
    channel = Channel(1, "/a", "json", 1, schema)
    text = content if isinstance(content, str) else json.dumps(content)
    return Decoders().decode(channel, memoryview(text.encode()))


BASE64 = product(("/", "\\/"), ("+", "\\u002B", "-"), ("", "\\r\\n", "\\n", " "), ("", "=="))


@pytest.mark.parametrize(
    "data", [*('"{}{}8A{}AQ{}"'.format(*one) for one in BASE64), [255, 239, 0, 1]]
)
def test_json_images_are_unpacked_however_a_serialiser_writes_them(data):
    text = f'{{"frame_id":"a", "format":"jpeg" , "data" : {data}}}'
    (image,) = decode("foxglove.CompressedImage", text)
    assert bytes(image.data) == b"\xff\xef\x00\x01"
    assert (image.frame_id, image.encoding) == ("a", "jpeg")


@pytest.mark.parametrize("name", SOUND)
def test_json_messages_are_read(name):
    assert len(decode(name, SOUND[name])) == 1


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("foxglove.RawImage", {"width": "32"}),
        ("foxglove.RawImage", {"width": 32.5}),
        ("foxglove.RawImage", {"width": None}),
        ("foxglove.RawImage", {"width": -32}),
        ("foxglove.RawImage", {"height": 1 << 40}),
        ("foxglove.RawImage", {"step": "x"}),
        ("foxglove.RawImage", {"encoding": 5}),
        ("foxglove.RawImage", {"frame_id": None}),
        ("foxglove.RawImage", {"frame_id": "\ud800"}),
        ("foxglove.RawImage", {"timestamp": {"sec": "x", "nsec": 0}}),
        ("foxglove.RawImage", {"data": "####"}),
        ("foxglove.RawImage", {"data": [256]}),
        ("foxglove.PoseInFrame", {"pose": {**POSE["pose"], "position": {"x": None}}}),
        ("foxglove.CameraCalibration", {"width": "wide"}),
        ("foxglove.CameraCalibration", {"K": ["x"] * 9}),
        ("foxglove.LocationFix", {"latitude": "48"}),
    ],
)
def test_json_with_a_value_of_another_type_is_no_message(name, wrong):
    with pytest.raises(ContentError):
        decode(name, SOUND[name] | wrong)
