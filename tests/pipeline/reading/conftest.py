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
TYPES = {
    f"foxglove.{t.__name__}": t
    for t in (
        CameraCalibration,
        CompressedImage,
        FrameTransform,
        FrameTransforms,
        LocationFix,
        PoseInFrame,
        PosesInFrame,
        RawImage,
    )
}


def image(index, width=WIDTH, height=HEIGHT):
    pixels = np.random.default_rng(index).integers(0, 256, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", pixels)[1].tobytes()


def read(path, **settings):
    """Frames of a log, and the report on them."""
    report = ReadReport()
    return list(read_frames(path, ReadSettings(**settings), report)), report


def chunks_of(content):
    """Offset and length of the content of each chunk, by walking the records."""
    position, found = 8, []
    while position < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 6:
            found.append((position, length))
        position += 9 + length
    return found


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value):
    return struct.pack("<I", len(value)) + value


SCHEMA = record(3, struct.pack("<H", 1) + text(b"T") + text(b"jsonschema") + text(b"{}"))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text(b"/a") + text(b"json") + text(b""))
HEAD = b"\x89MCAP0\r\n" + record(1, text(b"") + text(b""))


def diagonal(variances):
    return np.diag(variances).ravel().tolist()


def ray(position):
    return dict(zip("xyz", map(float, position), strict=True))


class Protobuf:
    encoding, schema_encoding = "protobuf", "protobuf"
    names: ClassVar = {
        "image": "foxglove.CompressedImage",
        "raw": "foxglove.RawImage",
        "calibration": "foxglove.CameraCalibration",
        "pose": "foxglove.PoseInFrame",
        "poses": "foxglove.PosesInFrame",
        "transform": "foxglove.FrameTransform",
        "transforms": "foxglove.FrameTransforms",
        "fix": "foxglove.LocationFix",
    }

    def schema(self, name):
        return build_file_descriptor_set(TYPES[name]).SerializeToString()

    def dump(self, name, content):
        return self.fill(TYPES[name](), content).SerializeToString()

    def fill(self, message, content):
        for key, value in content.items():
            if key == "timestamp":
                message.timestamp.FromNanoseconds(value)
            elif isinstance(value, dict):
                self.fill(getattr(message, key), value)
            elif isinstance(value, list) and value and isinstance(value[0], dict):
                for one in value:
                    self.fill(getattr(message, key).add(), one)
            elif isinstance(value, list):
                getattr(message, key).extend(value)
            else:
                setattr(message, key, value)
        message.SetInParent()
        return message

    def make(self, kind, t, c):
        base = {} if t is None else {"timestamp": t}
        if kind in ("image", "raw"):
            return base | {"frame_id": c.pop("frame", CAMERA)} | c
        if kind == "calibration":
            size = {"width": c.get("width", WIDTH), "height": c.get("height", HEIGHT)}
            lens = {"distortion_model": c.get("model", "plumb_bob"), "K": c.get("k", K), "D": D}
            return base | {"frame_id": c.get("frame", CAMERA)} | size | lens
        if kind in ("pose", "poses"):
            x, y, z, w = c["rotation"]
            pose = {
                "position": ray(c["position"]),
                "orientation": {"x": x, "y": y, "z": z, "w": w},
            }
            body = {"pose": pose} if kind == "pose" else {"poses": [pose]}
            return base | {"frame_id": c.get("parent", WORLD)} | body
        if kind in ("transform", "transforms"):
            x, y, z, w = c["rotation"]
            one = base | {
                "parent_frame_id": c["parent"],
                "child_frame_id": c["child"],
                "translation": ray(c["position"]),
                "rotation": {"x": x, "y": y, "z": z, "w": w},
            }
            return one if kind == "transform" else {"transforms": [one]}
        latitude, longitude, altitude = c["place"]
        return base | {
            "latitude": latitude,
            "longitude": longitude,
            "altitude": altitude,
            "position_covariance": diagonal(c.get("variances", FIX_VARIANCES)),
            "position_covariance_type": 2,
        }


class Json(Protobuf):
    encoding, schema_encoding = "json", "jsonschema"

    def schema(self, name):
        return json.dumps({"title": name, "type": "object"}).encode()

    def dump(self, name, content):
        def convert(value, key=""):
            if key == "timestamp":
                return {"sec": value // 10**9, "nsec": value % 10**9}
            if isinstance(value, bytes):
                return base64.b64encode(value).decode()
            if isinstance(value, dict):
                return {k: convert(v, k) for k, v in value.items()}
            return [convert(v) for v in value] if isinstance(value, list) else value

        return json.dumps(convert(content)).encode()


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

    def __init__(self):
        self.store = get_typestore(Stores.ROS2_HUMBLE)
        self.types = self.store.types

    def schema(self, name):
        return self.store.generate_msgdef(name, ros_version=2)[0].encode()

    def dump(self, name, content):
        return bytes(self.store.serialize_cdr(content, name))

    def new(self, name, *values):
        return self.types[name](*values)

    def header(self, t, frame):
        time = self.new("builtin_interfaces/msg/Time", *divmod(t or 0, 10**9))
        return self.new("std_msgs/msg/Header", time, frame)

    def pose_of(self, c):
        point = self.new("geometry_msgs/msg/Point", *map(float, c["position"]))
        turn = self.new("geometry_msgs/msg/Quaternion", *map(float, c["rotation"]))
        return self.new("geometry_msgs/msg/Pose", point, turn)

    def make(self, kind, t, c):
        name = self.names[kind]
        if kind == "image":
            pixels = np.frombuffer(c["data"], np.uint8)
            return self.new(name, self.header(t, c.get("frame", CAMERA)), c["format"], pixels)
        if kind == "raw":
            pixels = np.frombuffer(c["data"], np.uint8)
            shape = c["height"], c["width"], c["encoding"], 0, c["step"]
            return self.new(name, self.header(t, c.get("frame", CAMERA)), *shape, pixels)
        if kind == "calibration":
            roi = self.new("sensor_msgs/msg/RegionOfInterest", *c.get("roi", (0, 0, 0, 0)), False)
            return self.new(
                name,
                self.header(t, c.get("frame", CAMERA)),
                c.get("height", HEIGHT),
                c.get("width", WIDTH),
                c.get("model", "plumb_bob"),
                np.array(D),
                np.array(c.get("k", K)),
                np.eye(3).ravel(),
                np.zeros(12),
                *c.get("binning", (0, 0)),
                roi,
            )
        if kind == "pose":
            return self.new(name, self.header(t, c.get("parent", WORLD)), self.pose_of(c))
        if kind == "odometry":
            covariance = np.diag(c.get("variances", [0.04] * 3 + [0.0001] * 3)).ravel()
            still = self.new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
            twist = self.new("geometry_msgs/msg/Twist", still, still)
            return self.new(
                name,
                self.header(t, c.get("parent", WORLD)),
                c.get("child", CAMERA),
                self.new("geometry_msgs/msg/PoseWithCovariance", self.pose_of(c), covariance),
                self.new("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
            )
        if kind == "transforms":
            shift = self.new("geometry_msgs/msg/Vector3", *map(float, c["position"]))
            turn = self.new("geometry_msgs/msg/Quaternion", *map(float, c["rotation"]))
            transform = self.new("geometry_msgs/msg/Transform", shift, turn)
            stamped = self.new(
                "geometry_msgs/msg/TransformStamped",
                self.header(t, c["parent"]),
                c["child"],
                transform,
            )
            return self.new(name, [stamped])
        status = self.new("sensor_msgs/msg/NavSatStatus", c.get("status", 0), 1)
        covariance = np.array(diagonal(c.get("variances", FIX_VARIANCES)))
        return self.new(name, self.header(t, "gps"), status, *c["place"], covariance, 2)


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

    def add_images(self, count, **more):
        for index in range(count):
            self.add_image(index, **more)

    def calibrated(self, **content):
        self.add("/camera/calibration", "calibration", 0, **content)
        return self

    def finish(self):
        self.writer.finish()
        self.stream.close()
        return self.path


@pytest.fixture(params=["protobuf", "json", "cdr"])
def dialect(request):
    return {"protobuf": Protobuf, "json": Json, "cdr": Ros2}[request.param]()


BARE = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}
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
        if isinstance(dialect, str):
            dialect = {"protobuf": Protobuf, "json": Json, "cdr": Ros2}[dialect]()
        made.append(Log(tmp_path / name, dialect, options))
        return made[-1]

    yield make
    for log in made:
        log.stream.close()
