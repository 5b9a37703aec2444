"""Drives repeat byte for byte, their truth is what a camera would see, and their logs can be read by others."""

import base64
import hashlib
import json
import re
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyproj
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

pytest.importorskip("foxglove_schemas_protobuf", reason="needs: pip install -e '.[drives]'")

from recordings.drives.__main__ import main
from recordings.drives.alignment import build_alignment
from recordings.drives.geodesy import geodetic
from recordings.drives.logs import write_log
from recordings.drives.poses import drive_poses
from recordings.drives.produce import RenderedDrive, render
from recordings.drives.spec_file import SPECS, load_spec
from recordings.drives.stamps import Output, is_complete
from wayside.schemas.errors import UsageError

RECORDINGS = Path(__file__).parents[2] / "recordings"
TINY = """
name = "tiny"
seed = 5
frames = 3

[camera]
width = 320
height = 240
fx = 280.0
fy = 282.0
cx = 160.0
cy = 119.0
distortion = [-0.1, 0.05, 0.001, -0.002, 0.0]

[road]
segments = [[30.0, 0.0], [200.0, 300.0]]

[scene]
trees = 0.2
weeds = 0.5

[signs]
spacing_m = 11.0
first_m = 14.0
groups = { speed = 1, warning = 1, stop = 1, destination = 2 }
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    path = tmp_path_factory.mktemp("spec") / "tiny.toml"
    path.write_text(TINY)
    return load_spec(path)


@pytest.fixture(scope="module")
def rendered(tiny, tmp_path_factory):
    output = Output(tmp_path_factory.mktemp("one"), masks=True)
    render(tiny, output, jobs=1)
    return output


@pytest.fixture(scope="module")
def truth(rendered):
    return json.loads((rendered.folder / "tiny.truth.json").read_text())


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def topics_of(log, indexed=True):
    with log.open("rb") as stream:
        reader = make_reader(stream) if indexed else NonSeekingReader(stream)
        return Counter(channel.topic for _, channel, _ in reader.iter_messages())


def write_spec(folder, text):
    path = folder / "odd.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_two_processes_give_the_bytes_of_one(tiny, rendered, tmp_path):
    render(tiny, replace(rendered, folder=tmp_path), jobs=2)
    assert contents(tmp_path) == contents(rendered.folder)
    files = [*(f"masks/{i:04d}.png" for i in range(3)), "mcap", "stamp", "truth.json"]
    assert sorted(contents(tmp_path)) == [f"tiny.{name}" for name in files]


def camera_of(truth, frame):
    """What OpenCV needs to project world points into a frame, from the truth alone."""
    camera, pose = truth["camera"], truth["frames"][frame]
    to_world = Rotation.from_quat(pose["quaternion"]).as_matrix()
    rows = [camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]
    turn, _ = cv2.Rodrigues(to_world.T)
    shift = -to_world.T @ np.array(pose["position"])
    lens = turn, shift, np.array(rows), np.array(camera["distortion"])
    return SimpleNamespace(
        project=lambda points: cv2.projectPoints(np.array(points, float), *lens)[0].reshape(-1, 2),
        depth=lambda point: float((to_world.T @ point + shift)[2]),
    )


def corners_of(sign):
    """World corners of the box around a panel, from its place, normal, roll and size."""
    normal, roll = np.array(sign["normal"]), np.radians(sign["roll_deg"])
    level = np.cross(-normal, [0, 0, 1.0])
    level /= np.linalg.norm(level)
    down = np.cross(-normal, level)
    right = np.cos(roll) * level + np.sin(roll) * down
    down = np.cross(-normal, right)
    half = right * sign["width_m"] / 2, down * sign["height_m"] / 2
    return np.array([sign["centre"] + a * half[0] + b * half[1] for a in (-1, 1) for b in (-1, 1)])


def test_boxes_enclose_the_projected_corners_of_rectangular_signs(truth):
    checked = 0
    for sign in truth["signs"]:
        if sign["shape"] != "rectangle":
            continue
        for view in sign["frames"]:
            pixels = camera_of(truth, view["frame"]).project(corners_of(sign))
            box = [*pixels.min(axis=0), *pixels.max(axis=0)]
            # Corners are rounded, so a turned panel falls short of its corners by a part of the radius.
            slack = 0.02 * truth["camera"]["fx"] / view["range_m"] + 0.1
            np.testing.assert_allclose(view["box"], box, atol=slack)
            checked += 1
    assert checked >= 3


def test_boxes_are_the_extent_of_the_polygons_around_the_projected_centres(truth):
    views = [(sign["centre"], view) for sign in truth["signs"] for view in sign["frames"]]
    assert views
    for centre, view in views:
        points = np.concatenate([np.array(polygon) for polygon in view["polygons"]])
        low, high = points.min(axis=0), points.max(axis=0)
        assert view["box"] == [*low, *high]
        camera = camera_of(truth, view["frame"])
        assert ((low < camera.project([centre])) & (camera.project([centre]) < high)).all()
        assert camera.depth(centre) == pytest.approx(view["range_m"], abs=0.25)


def test_masks_show_the_signs_inside_their_boxes(truth, rendered):
    seen = 0
    for index in range(3):
        file = rendered.folder / f"tiny.masks/{index:04d}.png"
        mask = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        assert mask.shape == (240, 320)
        for sign in truth["signs"]:
            rows, columns = np.nonzero(mask == sign["id"])
            if len(rows) == 0:
                continue
            view = next(view for view in sign["frames"] if view["frame"] == index)
            left, top, right, bottom = view["box"]
            assert left - 1 <= columns.min() <= columns.max() <= right + 1
            assert top - 1 <= rows.min() <= rows.max() <= bottom + 1
            assert view["visible_fraction"] > 0
            seen += 1
    assert seen >= 3


def written(folder, spec, images):
    """Log of a drive with other images than the rendered ones."""
    poses = drive_poses(spec, build_alignment(spec.road, spec.path.heading_deg))
    write_log(folder / "odd.mcap", spec, poses, images)
    return folder / "odd.mcap"


def protobuf_fields(channel, schema, data):
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode is not None
    message = decode(data)
    return {field.name: value for field, value in message.ListFields()}


def json_fields(channel, schema, data):
    assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
    fields = json.loads(data)
    assert set(fields) == set(json.loads(schema.data)["properties"])
    return {**fields, "data": base64.b64decode(fields.get("data", ""))}


def ros2_fields(channel, schema, data):
    assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(schema.data.decode(), schema.name))
    message = types.deserialize_cdr(data, schema.name)
    return {name.upper() if len(name) == 1 else name: v for name, v in vars(message).items()}


READERS = {"protobuf": protobuf_fields, "json": json_fields, "ros2": ros2_fields}
FOXGLOVE_TOPICS = {"/camera/image", "/camera/calibration", "/pose", "/gps"}
ROS2_TOPICS = {"/front/camera_info", "/odom", "/fix"}


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("dialect", READERS)
def test_every_dialect_says_the_same_in_a_way_that_others_can_read(tiny, tmp_path, dialect, raw):
    content = np.arange(240 * 320 * 3).astype(np.uint8).reshape(240, 320, 3)
    if not raw:
        content = cv2.imencode(".jpg", content)[1].tobytes()
    spec = replace(tiny, log=replace(tiny.log, dialect=dialect, raw=raw))
    log = written(tmp_path, spec, [content] * 3)
    with log.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    ros2_image = "/front/image_raw" if raw else "/front/image_raw/compressed"
    topics = {ros2_image, *ROS2_TOPICS} if dialect == "ros2" else FOXGLOVE_TOPICS
    assert Counter(channel.topic for _, channel, _ in messages) == dict.fromkeys(topics, 3)
    found = {}
    for schema, channel, message in messages:
        assert schema is not None
        found |= {channel.topic: READERS[dialect](channel, schema, message.data)}
    (image,) = (fields for topic, fields in found.items() if "image" in topic)
    assert bytes(image["data"]) == (content.tobytes() if raw else content)
    (info,) = (fields for fields in found.values() if "K" in fields)
    assert list(info["K"]) == [280, 0, 160, 0, 282, 119, 0, 0, 1]
    assert list(info["D"]) == [-0.1, 0.05, 0.001, -0.002, 0]
    (fix,) = (fields for fields in found.values() if "latitude" in fields)
    assert fix["latitude"] == pytest.approx(38.5, abs=0.001)  # 0.001 deg: 111 m


def test_a_point_of_the_tangent_plane_is_where_proj_puts_it():
    origin = (38.5, -97.25, 430.0)
    there = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={origin[0]} +lon_0={origin[1]} +h_0={origin[2]}"
    )
    latitude, longitude, height = geodetic(origin, np.array([8000.0, 16000.0, 30.0]))
    back = there.transform(longitude, latitude, height)
    np.testing.assert_allclose(back, [8000.0, 16000.0, 30.0], atol=1e-6)


def test_a_drive_longer_than_its_road_is_refused(tiny):
    with pytest.raises(UsageError, match="m long, but the road only"):
        RenderedDrive(replace(tiny, frames=300))


def test_messages_are_logged_later_than_they_were_stamped(tiny, truth, rendered):
    with (rendered.folder / "tiny.mcap").open("rb") as stream:
        messages = [m for _, _, m in make_reader(stream).iter_messages(topics=["/camera/image"])]
    assert [m.publish_time for m in messages] == [f["time_ns"] for f in truth["frames"]]
    assert [m.log_time for m in messages] == [f["log_time_ns"] for f in truth["frames"]]
    assert messages[0].log_time - messages[0].publish_time == tiny.log.latency_ms * 1e6


def test_a_log_may_hold_images_and_calibration_alone_and_no_index(tiny, tmp_path):
    bare = replace(tiny.log, poses=False, fixes=False, index=False, compression="lz4")
    log = written(tmp_path, replace(tiny, log=bare), [b"image"] * 3)
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is None or not summary.chunk_indexes
    assert topics_of(log, indexed=False) == {"/camera/image": 3, "/camera/calibration": 3}


@pytest.mark.parametrize("path", sorted(SPECS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_specification_parses_and_is_described(path):
    assert load_spec(path).name == path.stem
    assert re.match(r"# \S+ \S+ .*\.\n", path.read_text()), "its first line says what the drive is"


def test_the_specifications_cover_every_dialect_and_packing():
    logs = [load_spec(path).log for path in SPECS.glob("*.toml")]
    assert {log.dialect for log in logs} == {"protobuf", "ros2", "json"}
    assert {log.compression for log in logs} == {"zstd", "lz4", "none"}
    assert {log.index for log in logs} == {log.raw for log in logs} == {True, False}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("seed = 5", "seed = 5\nsede = 6"), "unknown setting sede; did you mean seed"),
        (("seed = 5", ""), "seed is missing"),
        (("fx = 280.0", "fx = 'wide'"), r"camera\.fx: must be float, but is 'wide'"),
        (("[road]", "[road]\nkind = 'two_lanes'"), "must be one of two_lane, four_lane"),
        (("speed = 1", "sped = 1"), "unknown sign group sped; did you mean speed"),
        (("-0.002, 0.0]", "-0.002]"), r"camera\.distortion: must be tuple"),
        (("frames = 3", "frames = 0"), "frames: must be at least 1, but is 0"),
        (('"tiny"', '"../tiny"'), "cannot name files"),
        (("[scene]", "[scene"), "cannot be read as TOML"),
    ],
)
def test_a_specification_that_cannot_be_meant_is_refused(tmp_path, change, message):
    assert change[0] in TINY
    with pytest.raises(UsageError, match=message):
        load_spec(write_spec(tmp_path, TINY.replace(*change)))


def run(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["drives", *map(str, arguments)])
    return main()


def test_missing_drives_alone_are_rendered_and_with_another_seed_another_drive(
    tmp_path, monkeypatch, capsys
):
    spec, out = write_spec(tmp_path, TINY), tmp_path / "out"
    for _ in range(2):
        assert run(monkeypatch, spec, "-o", out, "--frames", 1, "--missing") == 0
    assert capsys.readouterr().err.splitlines() == ["tiny: 1 frames rendered", "tiny: complete"]
    assert sorted(contents(out)) == ["tiny.mcap", "tiny.stamp", "tiny.truth.json"]
    assert run(monkeypatch, spec, "-o", out, "--frames", 1, "--reseed", 500) == 0
    first, again = (json.loads((out / f"{n}.truth.json").read_text()) for n in ("tiny", "tiny_500"))
    assert len(again["frames"]) == 1
    assert again["seed"] == first["seed"] + 500
    assert again["signs"] != first["signs"]
    assert run(monkeypatch, "nowhere", "-o", out) == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith("nowhere is neither a TOML file nor")
    assert "there are curve, demo" in told


def test_a_drive_is_incomplete_when_a_part_or_a_setting_differs(tiny, rendered, tmp_path):
    assert is_complete(tiny, rendered)
    assert is_complete(tiny, replace(rendered, masks=False))
    assert not is_complete(tiny, replace(rendered, pictures=True))
    assert not is_complete(tiny, replace(rendered, folder=tmp_path))
    assert not is_complete(replace(tiny, seed=6), rendered)


def test_posts_vary_without_another_sign_in_another_place(tiny):
    varied = replace(tiny, signs=replace(tiny.signs, varied_posts=True))
    plain, other = (RenderedDrive(spec).scene.signs for spec in (tiny, varied))
    places = [[one.quad.origin.tolist() for one in signs] for signs in (plain, other)]
    assert places[0] == places[1]
    assert {(one.post_width, one.posts > 0) for one in plain} == {(0.0, True)}
    assert len({(one.post, one.post_width) for one in other}) == len({s.assembly_id for s in other})
    assert all(0.04 < one.post_width < 0.4 for one in other)


def test_a_render_that_breaks_off_leaves_the_older_drive(tiny, tmp_path, monkeypatch):
    (tmp_path / "tiny.mcap").write_bytes(b"older")
    monkeypatch.setattr("recordings.drives.produce.drive_truth", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        render(replace(tiny, frames=1), Output(tmp_path))
    assert contents(tmp_path) == {"tiny.mcap": b"older"}


@pytest.mark.parametrize("name", ["demo.mcap", "demo.truth.json"])
def test_the_demo_drive_is_what_its_readme_says(name):
    content = (RECORDINGS / name).read_bytes()
    lines = (RECORDINGS / "README.md").read_text().splitlines()
    row = next(line for line in lines if line.startswith(f"| `{name}` |"))
    assert row.split("|")[3].strip() == str(len(content))
    assert row.split("`")[3] == hashlib.sha256(content).hexdigest()


def test_the_demo_drive_holds_a_message_of_every_kind_for_every_frame():
    count = load_spec(SPECS / "demo.toml").frames
    assert topics_of(RECORDINGS / "demo.mcap") == dict.fromkeys(FOXGLOVE_TOPICS, count)
    assert len(json.loads((RECORDINGS / "demo.truth.json").read_text())["frames"]) == count
