"""Small real logs, written by the stock writers."""

import base64
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.settings import ReadSettings

START = 1_700_000_000 * 10**9
STEP = 10**9 // 4
LATENCY = 12_000_000
WIDTH, HEIGHT = 32, 24
K = [40.0, 0.0, 15.5, 0.0, 41.0, 11.5, 0.0, 0.0, 1.0]
D = [-0.1, 0.01, 0.001, -0.002, 0.003]
FIX_VARIANCES = (4.0, 9.0, 16.0)
CAMERA, WORLD = "camera_optical", "world"
KINDS = {
    "image": CompressedImage,
    "raw": RawImage,
    "calibration": CameraCalibration,
    "pose": PoseInFrame,
    "poses": PosesInFrame,
    "transform": FrameTransform,
    "transforms": FrameTransforms,
    "fix": LocationFix,
}
TYPES = {kind.DESCRIPTOR.full_name: kind for kind in KINDS.values()}
TOPICS = {"calibration": "/camera/calibration", "image": "/camera/image", "fix": "/gps"}
"""Topics of some kinds; of the others the kind is the topic."""


def image(index, width=WIDTH, height=HEIGHT):
    pixels = np.random.default_rng(index).integers(0, 256, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def read(path, **settings):
    """Frames of a log, and the report on them."""
    report = ReadReport()
    return list(read_frames(path, ReadSettings(**settings), report)), report


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value):
    return struct.pack("<I", len(value)) + value


SCHEMA = record(3, struct.pack("<H", 1) + text(b"T") + text(b"jsonschema") + text(b"{}"))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text(b"/a") + text(b"json") + text(b""))
HEAD = b"\x89MCAP0\r\n" + record(1, text(b"") + text(b""))


def diagonal(variances):
    return np.diag(variances).ravel().tolist()


def parts(names, values):
    return dict(zip(names, map(float, values), strict=True))


def pose_of(content, position="position", rotation="orientation"):
    place, turn = content["position"], content["rotation"]
    return {position: parts("xyz", place), rotation: parts("xyzw", turn)}


def fix_of(content):
    place = parts(("latitude", "longitude", "altitude"), content["place"])
    covariance = diagonal(content.get("variances", FIX_VARIANCES))
    return place | {"position_covariance": covariance, "position_covariance_type": 2}


class Protobuf:
    encoding, schema_encoding, seconds = "protobuf", "protobuf", ("seconds", "nanos")
    names: ClassVar = {kind: made.DESCRIPTOR.full_name for kind, made in KINDS.items()}

    def schema(self, name):
        return build_file_descriptor_set(TYPES[name]).SerializeToString()

    def dump(self, name, content):
        return TYPES[name](**content).SerializeToString()

    def make(self, kind, t, c):
        base = {"timestamp": dict(zip(self.seconds, divmod(t, 10**9), strict=True))} if t else {}
        if kind in ("image", "raw"):
            return base | {"frame_id": c.pop("frame", CAMERA)} | c
        if kind == "calibration":
            size = {"width": c.get("width", WIDTH), "height": c.get("height", HEIGHT)}
            lens = {"distortion_model": c.get("model", "plumb_bob"), "K": c.get("k", K), "D": D}
            return base | {"frame_id": c.get("frame", CAMERA)} | size | lens
        if kind in ("pose", "poses"):
            body = {"pose": pose_of(c)} if kind == "pose" else {"poses": [pose_of(c)]}
            return base | {"frame_id": c.get("parent", WORLD)} | body
        if kind in ("transform", "transforms"):
            one = base | {"parent_frame_id": c["parent"], "child_frame_id": c["child"]}
            one |= pose_of(c, "translation", "rotation")
            return one if kind == "transform" else {"transforms": [one]}
        return base | fix_of(c)


class Json(Protobuf):
    encoding, schema_encoding, seconds = "json", "jsonschema", ("sec", "nsec")

    def schema(self, name):
        return json.dumps({"title": name, "type": "object"}).encode()

    def dump(self, name, content):
        return json.dumps(content, default=lambda data: base64.b64encode(data).decode()).encode()


class Ros2:
    encoding, schema_encoding = "cdr", "ros2msg"
    names: ClassVar = {
        "image": "sensor_msgs/msg/CompressedImage",
        "raw": "sensor_msgs/msg/Image",
        "calibration": "sensor_msgs/msg/CameraInfo",
        "pose": "geometry_msgs/msg/PoseStamped",
        "odometry": "nav_msgs/msg/Odometry",
        "transforms": "tf2_msgs/msg/TFMessage",
        "fix": "sensor_msgs/msg/NavSatFix",
    }

    def __init__(self, store=Stores.ROS2_HUMBLE):
        self.store = get_typestore(store)

    def schema(self, name):
        return self.store.generate_msgdef(name, ros_version=2)[0].encode()

    def dump(self, name, content):
        return bytes(self.store.serialize_cdr(self.message(name, content), name))

    def message(self, name, content):
        """A message of this type; what of it is not in the content is zero or empty."""
        _, fields = self.store.fielddefs[name]
        values = [self.value(kind, content.get(field.lower())) for field, kind in fields]
        return self.store.types[name](*values)

    def value(self, kind, content):
        node, of = kind
        if node == Nodetype.BASE:
            return ("" if of[0] == "string" else 0) if content is None else content
        if node == Nodetype.NAME:
            return self.message(of, content or {})
        (inner, name), length = of
        if inner == Nodetype.NAME:
            return [self.message(name, one) for one in content]
        return np.array(np.zeros(length) if content is None else content, name[0])

    def make(self, kind, t, c):
        stamp = dict(zip(("sec", "nanosec"), divmod(t or 0, 10**9), strict=True))
        frame = c.get("frame", CAMERA) if kind in ("image", "raw", "calibration") else "gps"
        header = {"header": {"stamp": stamp, "frame_id": c.get("parent", frame)}}
        if kind in ("image", "raw"):
            return header | c | {"data": np.frombuffer(c["data"], np.uint8)}
        if kind == "calibration":
            lens = {"distortion_model": c.get("model", "plumb_bob"), "d": D, "k": c.get("k", K)}
            size = {"height": c.get("height", HEIGHT), "width": c.get("width", WIDTH)}
            region = ("x_offset", "y_offset", "height", "width")
            roi = dict(zip(region, c.get("roi", (0, 0, 0, 0)), strict=True))
            bins = dict(zip(("binning_x", "binning_y"), c.get("binning", (0, 0)), strict=True))
            return header | size | lens | bins | {"r": np.eye(3).ravel(), "roi": roi}
        if kind == "transforms":
            one = header | {"child_frame_id": c["child"]}
            return {"transforms": [one | {"transform": pose_of(c, "translation", "rotation")}]}
        if kind == "fix":
            return header | {"status": {"status": c.get("status", 0), "service": 1}} | fix_of(c)
        header["header"]["frame_id"] = c.get("parent", WORLD)
        if kind == "pose":
            return header | {"pose": pose_of(c)}
        covariance = diagonal(c.get("variances", [0.04] * 3 + [0.0001] * 3))
        pose = {"pose": pose_of(c), "covariance": covariance}
        return header | {"child_frame_id": c.get("child", CAMERA), "pose": pose}


DIALECTS = {"protobuf": Protobuf, "json": Json, "cdr": Ros2}


@dataclass
class Log:
    """Writes one log; times in nanoseconds after START."""

    path: Path
    dialect: Protobuf | Ros2
    options: dict = field(default_factory=dict)

    def __post_init__(self):
        self.stream = self.path.open("wb")
        self.writer = Writer(self.stream, **self.options)
        self.writer.start(library="tests")
        self.channels = {}
        self.counts = {}

    def add(self, topic, kind, time, *, late=LATENCY, header=True, sequence=None, **content):
        name = self.dialect.names[kind]
        if topic not in self.channels:
            schema = self.writer.register_schema(
                name, self.dialect.schema_encoding, self.dialect.schema(name)
            )
            self.channels[topic] = self.writer.register_channel(
                topic, self.dialect.encoding, schema
            )
        stamp = START + time if header else None
        data = self.dialect.dump(name, self.dialect.make(kind, stamp, dict(content)))
        self.add_bytes(topic, START + time + late, data, sequence)

    def add_bytes(self, topic, log_time, data, sequence=None):
        self.counts[topic] = self.counts.get(topic, 0) + 1
        number = self.counts[topic] if sequence is None else sequence
        self.writer.add_message(self.channels[topic], log_time, data, log_time, number)

    def add_image(
        self, index, time=None, topic="/camera/image", width=WIDTH, height=HEIGHT, **more
    ):
        more = {"format": "jpeg", "data": image(index, width, height)} | more
        self.add(topic, "image", index * STEP if time is None else time, **more)

    def drive(self, count, **streams):
        """Fills the log: of each kind its content, or that by number; None: no message."""
        streams = {"calibration": {}} | streams | {"image": streams.pop("image", {})}
        for index in range(count):
            for kind, content in streams.items():
                made = content(index) if callable(content) else content
                if kind == "image" and made is not None:
                    self.add_image(index, **made)
                elif made is not None:
                    topic = TOPICS.get(kind, f"/{kind}")
                    self.add(topic, kind, **{"time": index * STEP} | made)
        return self.finish()

    def calibrated(self, **content):
        self.add("/camera/calibration", "calibration", 0, **content)
        return self

    def finish(self):
        self.writer.finish()
        self.stream.close()
        return self.path


@pytest.fixture(params=DIALECTS)
def dialect(request):
    return request.param


PARTS = "repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"
BARE = {"index_types": IndexType.NONE} | dict.fromkeys(PARTS, False)
"""Options of a writer of a log without summary and index."""
PACKINGS = {
    "plain": {"use_chunking": False},
    "plain without index": {"use_chunking": False, **BARE},
    "plain with checksum": {"use_chunking": False, "enable_data_crcs": True},
    "none": {"compression": CompressionType.NONE, "chunk_size": 3000},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 3000},
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 3000},
    "zstd without index": {"compression": CompressionType.ZSTD, "chunk_size": 3000, **BARE},
}


@pytest.fixture(params=sorted(PACKINGS))
def packing(request):
    return PACKINGS[request.param]


@pytest.fixture
def new_log(tmp_path):
    """Make a log to fill: new_log(dialect="protobuf", **writer options)."""
    made = []

    def make(dialect="protobuf", name="drive.mcap", **options):
        made.append(Log(tmp_path / name, DIALECTS[dialect](), options))
        return made[-1]

    yield make
    for log in made:
        log.stream.close()
