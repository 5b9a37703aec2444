import math

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.pipeline.logs.information import format_log, inspect_log
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError, UsageError
from wayside.schemas.frame import FRAME_STATUSES
from wayside.schemas.settings import ReadSettings

from ..conftest import with_exif
from .conftest import HEIGHT, LATENCY, START, STEP, WIDTH, image, read

FORWARD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)  # optical in x forward, y left, z up


def path_at(time):
    """True position and rotation of a body on a bend, x forward, at a time in nanoseconds after START."""
    seconds = time / 1e9
    turn = Rotation.from_euler("z", 0.1 * seconds)
    return np.array([32 * seconds, 0.4 * seconds**2, 1.5]), turn


def pose_content(time, of=FORWARD):
    position, turn = path_at(time)
    return {"position": position, "rotation": (turn * Rotation.from_matrix(of)).as_quat()}


def pose_of(index):
    return pose_content(index * STEP)


def fix_of(index):
    seconds = index * STEP / 1e9
    return {"place": (48.0 + 1e-4 * seconds, 11.0 + 2e-4 * seconds, 500.0 + seconds)}


def fill(log, count=8):
    """Images every quarter of a second, eight metres apart, each with its calibration, pose and fix."""
    return log.drive(count, pose=pose_of, fix=fix_of)


def assert_pose(frame, time, tolerance=1e-6):
    position, turn = path_at(time)
    assert frame.pose is not None
    assert frame.pose.pose.centre == pytest.approx(position, abs=tolerance)
    assert frame.pose.pose.rotation == pytest.approx(turn.as_matrix() @ FORWARD, abs=tolerance)


def test_every_dialect_and_packing_gives_the_same_frames(new_log, dialect, packing):
    frames, report = read(fill(new_log(dialect, **packing)))
    assert [f.index for f in frames] == list(range(8))
    for index, frame in enumerate(frames):
        time = index * STEP
        assert frame.status == "used"
        assert frame.header_time_ns == START + time
        assert frame.log_time_ns == START + time + LATENCY
        assert (frame.encoding, frame.width, frame.height) == ("jpeg", WIDTH, HEIGHT)
        assert bytes(frame.data) == image(index)
        assert (frame.camera.fx, frame.camera.fy) == (40.0, 41.0)
        assert (frame.camera.cx, frame.camera.cy) == (15.5, 11.5)
        assert frame.camera.distortion == (-0.1, 0.01, 0.001, -0.002, 0.003)
        assert_pose(frame, time)
        assert frame.pose.source == "poses"
        latitude, longitude, altitude = fix_of(index)["place"]
        assert frame.fix.latitude_deg == pytest.approx(latitude, abs=1e-12)
        assert frame.fix.longitude_deg == pytest.approx(longitude, abs=1e-12)
        assert frame.fix.altitude_m == pytest.approx(altitude)
        assert frame.fix.sigma_m == (2.0, 3.0, 4.0)
        assert frame.spacing_m is None
    assert not report.problem_count
    assert report.statuses == {"used": 8}
    assert report.camera_topic == "/camera/image"
    assert report.motion_source == "poses"
    assert report.bytes_read == report.bytes_total > 0


def test_raw_images_keep_their_rows(new_log, dialect):
    log = new_log(dialect)
    rows = np.arange(HEIGHT * 100, dtype=np.uint8).tobytes()
    shape = {"width": WIDTH, "height": HEIGHT, "step": 100, "encoding": "bgr8"}
    log.add("/camera/image", "raw", 0, data=rows, **shape)
    log.add("/camera/calibration", "calibration", 0)
    (frame,), _ = read(log.finish(), spacing_m=8.0)
    assert (frame.encoding, frame.width, frame.height, frame.step) == ("bgr8", 32, 24, 100)
    assert bytes(frame.data) == rows


def test_free_text_formats_of_ros_images_are_understood(new_log):
    log = new_log("cdr").calibrated()
    png = cv2.imencode(".png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))[1].tobytes()
    for index, words in enumerate(("bgr8; jpeg compressed bgr8", "jpg", "rgb8; png", "image/png")):
        log.add_image(index, format=words, data=png if "png" in words else image(index))
    frames, _ = read(log.finish(), spacing_m=8.0)
    statuses = [(f.encoding, f.status) for f in frames]
    assert statuses == [("jpeg", "used")] * 2 + [("png", "used"), ("png", "duplicate")]
    assert [(f.width, f.height) for f in frames] == [(WIDTH, HEIGHT)] * 4


def test_odometry_of_a_vehicle_without_mount_looks_straight_ahead_and_says_so(new_log):
    def of_vehicle(index):
        return {"child": "base_link"} | pose_content(index * STEP, np.eye(3))

    frames, report = read(new_log("cdr").drive(4, odometry=of_vehicle))
    for index, frame in enumerate(frames):
        assert_pose(frame, index * STEP)
    assert any("straight ahead" in note for note in report.notes)


MOUNT = Rotation.from_matrix(FORWARD) * Rotation.from_euler("yx", [0.05, -0.02])
LEVER = np.array([1.7, 0.3, 0.2])


def assert_mounted(frame, time):
    position, turn = path_at(time)
    assert frame.pose.pose.centre == pytest.approx(position + turn.apply(LEVER), abs=1e-6)
    assert frame.pose.pose.rotation == pytest.approx((turn * MOUNT).as_matrix(), abs=1e-6)


def add_mount(log, time=0):
    """Camera on a bracket on the vehicle, in two steps."""
    bracket = Rotation.from_euler("z", 0.3)
    add = "transforms"
    log.add(
        "/tf_static", add, time, parent="base_link", child="bracket",
        position=LEVER, rotation=bracket.as_quat(),
    )  # fmt: skip
    log.add(
        "/tf_static", add, time, parent="bracket", child="camera_optical",
        position=[0, 0, 0], rotation=(bracket.inv() * MOUNT).as_quat(),
    )  # fmt: skip


@pytest.mark.parametrize("dialect_name", ["protobuf", "json", "cdr"])
@pytest.mark.parametrize("source", ["transforms", "pose", "odometry"])
def test_a_mount_given_by_transforms_is_composed(new_log, dialect_name, source):
    if source == "odometry" and dialect_name != "cdr":
        source = "poses"
    log = new_log(dialect_name)
    for index in range(6):
        time = index * STEP
        log.add("/camera/calibration", "calibration", time)
        names = {"parent": "world", "child": "base_link"} if source != "pose" else {}
        content = pose_content(time, np.eye(3)) | names
        log.add("/body", source, time, late=0, **content)
        log.add_image(index)
        if index == 1:  # later than the first image
            add_mount(log, time)
    frames, report = read(log.finish())
    assert report.motion_source == {"pose": "poses"}.get(source, source)
    for index, frame in enumerate(frames):
        assert frame.status == "used"
        assert_mounted(frame, index * STEP)


def test_transforms_that_carry_the_camera_come_before_odometry(new_log):
    def of_body(index):
        return {"parent": "odom", "child": "base_link"} | pose_content(index * STEP, np.eye(3))

    log = new_log("cdr")
    add_mount(log)
    still = {"position": [0, 0, 0], "rotation": [0, 0, 0, 1]}
    frames, report = read(log.drive(4, transforms=of_body, odometry=still))
    assert report.motion_source == "transforms"
    for index, frame in enumerate(frames):
        assert_mounted(frame, index * STEP)


def test_frames_without_header_times_go_by_log_time(new_log):
    bare = {"late": 0, "header": False}
    streams = {"calibration": bare, "pose": lambda index: bare | pose_of(index), "image": bare}
    frames, _ = read(new_log().drive(4, **streams))
    for index, frame in enumerate(frames):
        assert frame.header_time_ns is None
        assert frame.time_ns == START + index * STEP
        assert_pose(frame, index * STEP)


@pytest.mark.parametrize("late", [1_000_000, 20_000_000])
def test_each_image_gets_the_calibration_of_its_own_time(new_log, late):
    log = new_log()
    for index in range(6):
        k = [40.0 + index, 0.0, 15.5, 0.0, 41.0, 11.5, 0.0, 0.0, 1.0]
        if late < LATENCY:
            log.add("/camera/calibration", "calibration", index * STEP, late=late, k=k)
        log.add_image(index)
        if late > LATENCY:
            log.add("/camera/calibration", "calibration", index * STEP, late=late, k=k)
    frames, _ = read(log.finish(), spacing_m=8.0)
    focal = [f.camera.fx for f in frames]
    # the second calibration comes before it is known that they come with each image
    assert focal == [40 + i for i in range(6)] or (late > LATENCY and focal[2:] == [42, 43, 44, 45])


def test_the_calibration_of_the_camera_is_told_by_frame_then_by_topic(new_log):
    log = new_log()
    other = [99.0, 0.0, 15.5, 0.0, 99.0, 11.5, 0.0, 0.0, 1.0]
    log.add("/rear/calibration", "calibration", 0, k=other, frame="rear_optical")
    log.add("/front/calibration", "calibration", 0, frame="camera_optical")
    log.add_image(0, topic="/front/image")
    log.add_image(0, topic="/rear/image", frame="rear_optical")
    log.add_image(0, topic="/rear/other", frame="")
    path = log.finish()
    for topic, focal in (("/front/image", 40.0), ("/rear/image", 99.0), ("/rear/other", 99.0)):
        (frame,), _ = read(path, spacing_m=8.0, camera=topic)
        assert frame.camera.fx == focal


def test_a_binned_part_of_the_sensor_has_its_own_matrix(new_log):
    log = new_log("cdr")
    k = [80.0, 0.0, 38.5, 0.0, 82.0, 30.5, 0.0, 0.0, 1.0]
    more = {"width": 80, "height": 60, "roi": (8, 6, 48, 64), "binning": (2, 2)}
    log.add("/camera/camera_info", "calibration", 0, k=k, **more)
    log.add_image(0)
    (frame,), _ = read(log.finish(), spacing_m=8.0)
    assert (frame.camera.width, frame.camera.height) == (32, 24)
    assert (frame.camera.fx, frame.camera.cx) == (40.0, (38.5 - 8) / 2)
    assert (frame.camera.fy, frame.camera.cy) == (41.0, (30.5 - 6) / 2)


def test_a_calibration_file_replaces_that_of_the_log(new_log, calibration):
    frames, report = read(fill(new_log()), calibration=str(calibration))
    assert {f.camera.fx for f in frames} == {50.0}
    assert report.calibration_source.endswith("camera.yaml")


@pytest.mark.parametrize(
    ("name", "media_type"), [("camera.yaml", "application/yaml"), ("left camera", "")]
)
def test_a_calibration_attached_to_the_log_is_used(new_log, calibration, name, media_type):
    log = new_log()
    log.add_image(0)
    log.writer.add_attachment(0, 0, "notes.yaml", "", b"weather: fine, no camera_matrix")
    log.writer.add_attachment(0, 0, name, media_type, calibration.read_bytes())
    (frame,), report = read(log.finish(), spacing_m=8.0)
    assert frame.camera.distortion == (-0.2, 0.1, 0.0, 0.0, 0.5)
    assert report.calibration_source == f"attachment {name}"


@pytest.mark.parametrize(
    ("spacing", "thin", "apart"),
    [(8.04672, 8.0, 1), (6.1, 8.0, 1), (5.0, 8.0, 2), (1.0, 8.0, 8), (3.0, 0.0, 1), (2.0, 8.5, 4)],
)
def test_thinning_takes_the_image_nearest_to_the_wanted_distance(new_log, spacing, thin, apart):
    frames, report = read(new_log().drive(20), spacing_m=spacing, thin_m=thin)
    used = [f for f in frames if f.used]
    assert [f.index for f in used] == list(range(0, 20, apart))
    assert [f.spacing_m for f in used] == [None, *[apart * spacing] * (len(used) - 1)]
    assert report.statuses.get("thinned", 0) == 20 - len(used)
    assert all(f.spacing_m is None and len(f.data) == 0 for f in frames if not f.used)


@pytest.mark.parametrize("source", ["pose", "fix"])
def test_thinning_goes_by_the_way_travelled(new_log, source):
    rng = np.random.default_rng(1)

    def place(index):
        way = 2.0 * min(index, 20) + 2.0 * max(index - 50, 0)  # stands still from 20 to 50
        jitter = rng.normal(0, 0.05, 2)
        if source == "pose":
            return {"position": [way + jitter[0], jitter[1], 1.0], "rotation": [0, 0, 0, 1]}
        degrees = (way + jitter[0]) / 6_371_000 * 180 / np.pi
        return {"place": (degrees, 11.0, 500.0 + 10 * jitter[1])}

    frames, _ = read(new_log().drive(60, **{source: place}), thin_m=8.0)
    used = [f.index for f in frames if f.used]
    assert used[:6] == [0, 4, 8, 12, 16, 20]
    standing = [i for i in used if 20 < i < 50]  # one a second: it tells whether the camera stands
    assert standing
    assert min(np.diff(standing)) >= 4


def test_a_part_and_every_nth_image_are_taken_and_the_rest_is_accounted_for(new_log):
    frames, report = read(fill(new_log(), 20), from_s=1.0, until_s=3.0, every=3)
    assert [f.index for f in frames] == list(range(20))
    assert [f.index for f in frames if f.used] == [4, 7, 10]
    assert report.statuses == {"used": 3, "skipped": 6, "outside": 11}
    assert set(report.statuses) <= set(FRAME_STATUSES)


@pytest.mark.parametrize("status", ["wrong_size", "turned"])
def test_later_images_of_another_size_or_turn_are_marked_and_the_others_used(new_log, status):
    def shown(index):
        if status == "wrong_size":
            return {"width": WIDTH + 8 * (index == 2)}
        return {"data": with_exif(image(index), orientation={1: 1, 2: 6, 3: 0}.get(index))}

    frames, report = read(new_log().drive(5, image=shown), spacing_m=8.0)
    assert [f.status for f in frames] == ["used", "used", status, "used", "used"]
    assert frames[3].spacing_m == 16.0
    assert report.statuses[status] == 1


def test_a_log_whose_first_image_is_to_be_shown_turned_is_refused(new_log, dialect):
    log = new_log(dialect).calibrated()
    log.add_image(0, data=with_exif(image(0), orientation=3))
    path = log.finish()
    with pytest.raises(InputError, match=r"first image of /camera/image: .* turned by 180 degrees"):
        read(path, spacing_m=8.0)
    text = format_log(inspect_log(path))
    assert "cannot be used yet: the first image of /camera/image: its Exif orientation" in text
    assert "can be used" not in text


def test_messages_that_cannot_be_decoded_are_counted_and_images_keep_their_place(new_log, dialect):
    log = new_log(dialect).calibrated()
    for index in range(4):
        log.add("/pose", "pose", index * STEP, **pose_of(index))
        if index == 2:
            log.add_bytes("/camera/image", START + 2 * STEP, b"\xff\xff\xff")
        else:
            log.add_image(index)
    log.add_bytes("/pose", START + 3 * STEP, b"\xff\xff\xff")
    log.add("/pose", "pose", 4 * STEP, position=[math.nan, 0, 0], rotation=[0, 0, 0, 1])
    log.add("/pose", "pose", 4 * STEP, position=[0, 0, 0], rotation=[0, 0, 0, 0])
    frames, report = read(log.finish())
    statuses = ["used", "used", "undecodable", "used"]
    assert [(f.index, f.status) for f in frames] == list(enumerate(statuses))
    assert "3 messages of /pose lost" in str(report.problems[0])


def test_several_cameras_ask_for_a_choice_and_list_what_there_is(new_log):
    log = new_log(chunk_size=1000)
    for index in range(20):
        log.add("/front/info", "calibration", index * STEP)
        log.add_image(index, topic="/front/image")
        if index % 2:
            log.add_image(index, topic="/rear/image", width=40)
    path = log.finish()
    with pytest.raises(UsageError) as error:
        read(path, spacing_m=8.0)
    for words in (
        "--camera /front/image",
        "/front/image (20 images, 32 x 24)",
        "(10 images, 40 x 24)",
    ):
        assert words in str(error.value)
    frames, _ = read(path, spacing_m=8.0, camera="/front/image")
    assert len(frames) == 20


def test_depth_images_are_no_camera(new_log):
    log = new_log().calibrated()
    shape = {"width": WIDTH, "height": HEIGHT, "step": 2 * WIDTH, "encoding": "16UC1"}
    log.add("/depth", "raw", 0, data=bytes(2 * WIDTH * HEIGHT), **shape)
    log.add_image(0, topic="/packed", format="16UC1; compressedDepth")
    log.add_image(0)
    frames, report = read(log.finish(), spacing_m=8.0)
    assert len(frames) == 1
    assert report.camera_topic == "/camera/image"


def test_an_unknown_camera_names_the_nearest(new_log):
    with pytest.raises(UsageError, match="nearest is /camera/image"):
        read(fill(new_log()), camera="/camera/imag")


NO_LENS, OTHER_LENS = {"calibration": None}, {"calibration": {"width": 64, "height": 48}}
LATE = {"pose": None, "fix": lambda index: {"time": 10**12 + index * STEP} | fix_of(index)}
LACKS = {
    "no images": ({"image": None}, r"no images. It holds /camera/calibration", "has no images"),
    "no lens": (
        NO_LENS,
        r"no calibration .*--calibration camera\.yaml",
        "--calibration camera.yaml",
    ),
    "no motion": ({"pose": None}, r"--spacing 26\.4ft", "-o out --spacing 26.4ft"),
    "another size": (OTHER_LENS, "have 32 x 24 pixels.* has 64 x 48; .*--calibration", "64 x 48"),
    "zeros": ({"calibration": {"k": [0.0] * 9}}, "not calibrated", "not calibrated"),
    "a lens model": ({"calibration": {"model": "equidistant"}}, "lens model eq", "lens model eq"),
    "no width": ({"calibration": {"width": 0}}, "0 x 24", "0 x 24"),
    "late fixes": (LATE, "none of its 4 images has a pose or fix near.*--spacing", ""),
}
"""Content of a kind of message that differs, the refusal of a run, and what the information says."""


@pytest.mark.parametrize("lack", LACKS)
def test_what_a_log_lacks_is_refused_and_told_with_what_helps(new_log, lack):
    changes, refused, told = LACKS[lack]
    path = new_log().drive(4, **{"pose": pose_of} | changes)
    with pytest.raises(InputError, match=refused):
        read(path)
    text = format_log(inspect_log(path))
    assert told in text
    assert not told or "can be used:" not in text


@pytest.mark.parametrize("wrong", [{"every": 0}, {"from_s": 5.0, "until_s": 4.0}])
def test_senseless_settings_are_refused_before_anything_is_read(tmp_path, wrong):
    with pytest.raises(UsageError, match=f"read.{list(wrong)[-1]}"):
        read(tmp_path / "none.mcap", **wrong)


def test_images_are_not_copied_from_protobuf_and_cdr(new_log):
    for dialect in ("protobuf", "cdr"):
        (frame, *_), _ = read(fill(new_log(dialect, name=f"{dialect}.mcap", use_chunking=False)))
        assert isinstance(frame.data, memoryview)
        assert memoryview(frame.data).nbytes == len(image(0))
        assert memoryview(frame.data).readonly


def test_reading_keeps_no_images(new_log):
    import tracemalloc

    log = new_log(chunk_size=100_000).calibrated()
    data = image(0) + bytes(100_000)
    for index in range(200):
        log.add("/pose", "pose", index * STEP, **pose_content(index * STEP))
        log.add_image(index, data=data)
    path = log.finish()
    tracemalloc.start()
    count = sum(1 for _ in read_frames(path, ReadSettings(), ReadReport()))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 200
    assert peak < 4_000_000  # of twenty million bytes of images


def test_another_way_of_naming_ros_types_is_understood(new_log):
    log = new_log("cdr")
    log.dialect.schema = lambda name: b""
    register = log.writer.register_schema
    log.writer.register_schema = lambda name, *rest: register(name.replace("/msg/", "/"), *rest)
    assert len(read(fill(log))[0]) == 8


def copied(log, order):
    """A log of the images that `order` lists, each at a time of its own."""
    return log.drive(len(order), image=lambda place: {"data": image(order[place])})


@given(order=st.lists(st.integers(0, 5), min_size=1, max_size=12))
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_images_that_are_used_are_a_spacing_apart_however_often_they_were_copied(new_log, order):
    frames, _ = read(copied(new_log(), order), spacing_m=8.0)
    first = [order.index(i) for i in order]
    copies = [i for i, known in enumerate(first) if known < i]
    assert [f.index for f in frames if f.status == "duplicate"] == copies
    assert [f.spacing_m for f in frames if f.used] == [None] + [8.0] * (len({*order}) - 1)
    assert all(len(f.data) == 0 and f.spacing_m is None for f in frames if not f.used)


def test_copies_do_not_count_among_every_second_image(new_log):
    frames, _ = read(copied(new_log(), [0, 0, 1, 2, 3, 3]), spacing_m=8.0, every=2)
    statuses = ["used", "duplicate", "skipped", "used", "skipped", "duplicate"]
    assert [f.status for f in frames] == statuses
    assert [f.spacing_m for f in frames if f.used] == [None, 16.0]


def test_copies_in_the_part_that_is_left_out_are_not_looked_for(new_log):
    frames, _ = read(copied(new_log(), [0, 1, 0, 2]), spacing_m=8.0, from_s=0.3)
    assert [f.status for f in frames] == ["outside", "outside", "used", "used"]
