"""The log for Foxglove, read by the stock reader together with its drive."""

import dataclasses

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from wayside.pipeline.exporting.export import export
from wayside.pipeline.files.settings_file import load_settings
from wayside.pipeline.results.result import log_fingerprint
from wayside.pipeline.reviewing.entries import MISSING, Reviewed
from wayside.pipeline.reviewing.matching import NO_REVIEW, Review
from wayside.schemas.errors import InputError
from wayside.schemas.tables import FRAMES

from ..results import frame_rows, observation_row, sign_row, write_tables

AHEAD = [0.5, -0.5, 0.5, -0.5]
"""Camera that looks along x, with z up: camera axes right, down, ahead in the world."""
IMAGES = 3


def write_result(folder, log, world):
    """A result of one sign and a rejected box, seen in the second of three images."""
    quaternion = dict(zip(("qx", "qy", "qz", "qw"), AHEAD, strict=True))
    frames = frame_rows(log, 2.0, y=0.0, z=1.5, **quaternion)
    for row, (_, _, message, _) in zip(frames, decoded(log, ["/camera/image"]), strict=True):
        row["header_time_ns"] = message.publish_time - 12_000_000
    place = {"x": 12.0, "y": -3.0, "z": 2.5, "color": "red", "shape": "octagon"}
    size = {"panel_width_m": 0.76, "panel_height_m": 0.75, "facing_deg": 90.0}
    boxes = [
        observation_row(1, 0, box=[4, 5, 14, 15], sign_id="d-0001"),
        observation_row(1, 1, box=[20, 5, 24, 9], verdict="moving"),
    ]
    about = {"log": log.name, "log_path": str(log), "log_fingerprint": log_fingerprint(log)}
    about |= {"world": world, "settings": dataclasses.asdict(load_settings()[0])}
    return write_tables(folder, [sign_row("d-0001", **place | size)], boxes, frames, **about)


def drive(new_log, motion):
    """A log of three images whose camera moves by poses, by transforms, or by the poses of a body it is mounted on."""

    def moving(parent, **more):
        return lambda index: {"parent": parent, "position": (2.0 * index, 0, 1.5)} | turned | more

    turned = {"rotation": AHEAD}
    still = {"position": (1.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0)}
    poses = {"pose": moving("map")}
    streams = {
        "poses": poses,
        "mount": {"transform": {"parent": "base", "child": "camera_optical"} | still} | poses,
        "transforms": {"transform": moving("map", child="camera_optical")},
        "fixes": {"fix": lambda index: {"place": (50.0 + 1e-5 * index, 10.0, 100.0)}},
    }
    return new_log().drive(IMAGES, **streams[motion])


def decoded(path, topics=None):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        yield from reader.iter_decoded_messages(topics)


def export_log(new_log, tmp_path, motion="poses", world="log", review=NO_REVIEW):
    out = write_result(tmp_path / "out", drive(new_log, motion), world)
    export(out, review, tmp_path / "signs.mcap", "mcap")
    found = {}
    for schema, channel, message, content in decoded(tmp_path / "signs.mcap"):
        topic = channel.topic.removeprefix("/wayside/camera/image/")
        found.setdefault((topic, schema.name), []).append((message.log_time, content))
    return found


def test_boxes_have_the_times_of_the_images_they_lie_on(new_log, tmp_path):
    found = export_log(new_log, tmp_path)
    read = decoded(tmp_path / "drive.mcap", ["/camera/image"])
    images = [(m.log_time, content.timestamp.ToNanoseconds()) for _, _, m, content in read]
    shown = {}
    for topic, words in (("signs", "d-0001 red octagon"), ("rejected", "moving")):
        messages = found[topic, "foxglove.ImageAnnotations"]
        assert [(time, one.timestamp.ToNanoseconds()) for time, one in messages] == images
        assert [len(content.points) for _, content in messages] == [0, 1, 0]
        assert [text.text for text in messages[1][1].texts] == [words]
        (shown[topic],) = messages[1][1].points
    sign = shown["signs"]
    assert [(p.x, p.y) for p in sign.points] == [(4, 5), (14, 5), (14, 15), (4, 15)]
    assert (sign.type, sign.outline_color.r > 0.7) == (sign.LINE_LOOP, True)


def test_a_panel_stands_in_the_frame_of_the_poses_turned_as_it_faces(new_log, tmp_path):
    found = export_log(new_log, tmp_path)
    ((time, scene),) = found["scene", "foxglove.SceneUpdate"]
    assert time == found["camera", "foxglove.FrameTransform"][0][0]
    path, sign = scene.entities
    assert [(p.x, p.z) for p in path.lines[0].points] == [(0, 1.5), (2, 1.5), (4, 1.5)]
    assert (sign.id, sign.frame_id, sign.texts[0].text) == ("d-0001", "map", "d-0001 red octagon")
    cube, turn = sign.cubes[0], sign.cubes[0].pose.orientation
    assert (cube.pose.position.x, cube.pose.position.y, cube.pose.position.z) == (12, -3, 2.5)
    assert (cube.size.x, cube.size.y) == pytest.approx((0.76, 0.75))
    axes = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    np.testing.assert_allclose(axes[:, 1], [0, 0, -1], atol=1e-6)  # its height is upright
    np.testing.assert_allclose(np.abs(axes[:, 0]), [1, 0, 0], atol=1e-6)  # its width is along
    assert sign.texts[0].pose.position.z == pytest.approx(2.5 + 0.375 + 0.3)


def test_a_sign_that_a_review_says_is_missing_stands_by_name_where_the_reviewer_put_it(
    new_log, tmp_path
):
    missing = Reviewed(MISSING, None, {"color": "red", "shape": "octagon"}, 3.0, -4.0)
    found = export_log(new_log, tmp_path, review=Review({}, (missing,)))
    *_, entity = found["scene", "foxglove.SceneUpdate"][0][1].entities
    (name,) = entity.texts
    assert (entity.id, entity.frame_id) == ("drive-missing-1", "map")
    assert name.text == "drive-missing-1 red octagon missing"
    place = name.pose.position
    assert (place.x, place.y, place.z) == (3.0, -4.0, 1.5)


@pytest.mark.parametrize(
    ("motion", "world", "parent", "child", "x"),
    [
        ("poses", "log", "map", "camera_optical", 2.0),
        ("fixes", "enu", "wayside_enu", "camera_optical", 2.0),
        ("mount", "log", "map", "base", 2.0),
    ],
)
def test_the_camera_is_placed_where_the_drive_does_not_say_it(
    motion, world, parent, child, x, new_log, tmp_path
):
    found = export_log(new_log, tmp_path, motion, world)
    moved = [content for _, content in found["camera", "foxglove.FrameTransform"]]
    assert [(m.parent_frame_id, m.child_frame_id) for m in moved] == [(parent, child)] * IMAGES
    assert moved[1].translation.x == pytest.approx(x)
    # the camera is mounted 1 m to the right of its body, which is to -y of the world
    assert moved[1].translation.y == pytest.approx(1.0 if motion == "mount" else 0.0, abs=1e-9)


def test_transforms_of_the_drive_are_not_contradicted(new_log, tmp_path):
    found = export_log(new_log, tmp_path, "transforms")
    assert ("camera", "foxglove.FrameTransform") not in found
    assert found["scene", "foxglove.SceneUpdate"][0][1].entities[1].frame_id == "map"


def test_the_same_bytes_come_again_and_another_log_is_refused(new_log, tmp_path):
    export_log(new_log, tmp_path)
    out, again = tmp_path / "out", tmp_path / "again.mcap"
    export(out, NO_REVIEW, again, "mcap")
    assert again.read_bytes() == (tmp_path / "signs.mcap").read_bytes()
    with pytest.raises(InputError, match="is not the log that"):
        export(out, NO_REVIEW, tmp_path / "b.mcap", "mcap", log=again)
    assert not (tmp_path / "b.mcap").exists()


def test_observations_of_a_frame_that_is_not_there_are_refused(new_log, tmp_path):
    out = write_result(tmp_path / "out", drive(new_log, "poses"), "log")
    pq.write_table(pq.read_table(out / FRAMES.file).slice(0, 1), out / FRAMES.file)
    with pytest.raises(InputError, match="name frame 1, which the table of frames lacks"):
        export(out, NO_REVIEW, tmp_path / "signs.mcap", "mcap")
