"""Positions, calibrations and names in a log that cannot be, and what of the log is used all the same."""

import math
from functools import partial

import pytest

from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ReadSettings

from .conftest import read as read_log

read = partial(read_log, thin_m=0.0)
STEP = 10**9 // 4
COUNT = 24


TURN = (0.5, -0.5, 0.5, -0.5)


def write(new_log, dialect="protobuf", *, motion="pose", fixes=True, **changes):
    """A drive; `pose`, `fix`: position by its number and what it was, or the content; `calibration`: content."""
    log = new_log(dialect)

    def changed(kind, field, index, sound):
        found = changes[kind](index, sound) if kind in changes else sound
        return found if isinstance(found, dict) else {field: found}

    for index in range(COUNT):
        time = index * STEP
        calibration = changes.get("calibration", lambda i: {})(index)
        log.add("/camera/calibration", "calibration", time, **calibration)
        if motion:
            pose = changed("pose", "position", index, [8.0 * index, 0.1 * index, 1.5])
            log.add(f"/{motion}", motion, time, **({"rotation": TURN} | pose))
        if fixes:
            fix = changed("fix", "place", index, (48.0 + 7e-5 * index, 11.0, 500.0))
            log.add("/gps", "fix", time, **fix)
        log.add_image(index)
    return log.finish()


@pytest.mark.parametrize(
    ("first", "last", "off"), [(10, 11, 5e3), (10, 11, 20.0), (0, 1, 5e3), (10, 13, 1e7)]
)
def test_poses_aside_are_left_out_bridged_and_told(new_log, first, last, off):
    path = write(new_log, pose=lambda i, p: [p[0] + off * (first <= i < last), *p[1:]])
    frames, report = read(path)
    assert all(f.used for f in frames)
    for frame in frames:
        if frame.pose is not None:
            assert frame.pose.pose.centre[0] == pytest.approx(8.0 * frame.index, abs=1e-6)
    assert sum(f.pose is not None for f in frames) >= COUNT - (first == 0)
    assert any(
        f"{last - first} of 24 poses of /pose are where no vehicle can be" in n
        for n in report.notes
    )


def test_poses_of_another_origin_than_most_are_left_out_and_told(new_log):
    frames, report = read(write(new_log, pose=lambda i, p: [p[0] + 5000.0 * (i >= 14), *p[1:]]))
    assert [f.index for f in frames if f.pose is not None] == list(range(14))
    assert any("10 of 24 poses of /pose are where no vehicle can be" in n for n in report.notes)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0, 500.0)])
def test_fixes_at_zero_are_no_fixes_and_counted(new_log, place):
    frames, report = read(write(new_log, fix=lambda i, p: place if i < 9 else p))
    assert [f.index for f in frames if f.fix is not None] == list(range(9, COUNT))
    assert any("9 of 24 messages of /gps hold no position" in n for n in report.notes)
    with pytest.raises(InputError, match=r"none of the 24 messages of /gps can be used.*--spacing"):
        read(write(new_log, fix=lambda i, p: place, motion=""))


def test_fixes_that_repeat_without_change_are_no_fixes_and_counted(new_log):
    path = write(new_log, fix=lambda i, p: (48.0 + 7e-5 * min(i, 11), *p[1:]))
    frames, report = read(path)
    assert [f.index for f in frames if f.fix is not None] == list(range(12))
    assert any("12 of 24 fixes of /gps repeat the one before" in n for n in report.notes)


def test_a_fix_aside_is_left_out_bridged_and_told(new_log):
    path = write(new_log, fix=lambda i, p: (p[0] + 0.045 * (i == 10), *p[1:]), motion="")
    frames, report = read(path)
    assert [f.fix.latitude_deg for f in frames] == pytest.approx(
        [48.0 + 7e-5 * i for i in range(COUNT)], abs=1e-9
    )
    assert any("1 of 24 fixes of /gps are where no vehicle can be" in n for n in report.notes)


@pytest.mark.parametrize(("axis", "value"), [(0, math.nan), (1, math.inf), (2, 1e308), (0, -1e9)])
def test_impossible_poses_are_lost_with_count_and_reason(new_log, axis, value):
    def pose(index, position):
        return [value if k == axis and index >= 12 else p for k, p in enumerate(position)]

    frames, report = read(write(new_log, pose=pose))
    assert sum(f.pose is not None for f in frames) == 12
    assert "12 messages of /pose lost" in str(report.problems[0])


def test_a_stream_without_a_usable_message_is_told(new_log):
    frames, report = read(write(new_log, pose=lambda i, p: [math.nan, *p[1:]]))
    assert all(f.used and f.pose is None for f in frames)
    assert any("none of the 24 messages of /pose can be used" in note for note in report.notes)
    assert "24 messages of /pose lost" in str(report.problems[0])
    frames, report = read(write(new_log, fix=lambda i, p: (math.nan, *p[1:])))
    assert all(f.used and f.fix is None for f in frames)
    assert (
        "none of the 24 messages of /gps can be used: no position, or one known to a kilometre at best"
        in report.notes
    )
    assert not report.problem_count
    frames, report = read(write(new_log, fix=lambda i, p: (math.nan if i < 9 else p[0], *p[1:])))
    assert any("9 of 24 messages of /gps hold no position" in note for note in report.notes)


def test_what_is_refused_for_want_of_poses_says_what_the_poses_lack(new_log):
    with pytest.raises(InputError, match=r"/pose.*a pose that is not finite.*--spacing"):
        read(write(new_log, pose=lambda i, p: [math.nan, *p[1:]], fixes=False))


def test_an_impossible_height_costs_its_fix_only(new_log):
    frames, report = read(write(new_log, fix=lambda i, p: (*p[:2], 1e15 if i == 7 else p[2])))
    assert all(f.fix is not None and f.fix.altitude_m == pytest.approx(500.0) for f in frames)
    assert "1 messages of /gps lost" in str(report.problems[0])


def test_a_calibration_that_becomes_unusable_is_counted_and_the_last_sound_one_kept(new_log):
    bad = [math.nan, *[0.0] * 8]
    frames, report = read(write(new_log, calibration=lambda i: {"k": bad} if i > 1 else {}))
    assert all(f.used and f.camera.fx == 40.0 for f in frames)
    assert "22 messages of /camera/calibration lost" in str(report.problems[0])
    assert "focal length" in str(report.problems[0])


@pytest.mark.parametrize("variance", [-4.0, math.nan])
@pytest.mark.parametrize("dialect", ["protobuf", "cdr"])
def test_variances_of_fixes_that_cannot_be_are_taken_as_unknown(new_log, dialect, variance):
    def fix(index, place):
        odd = 5 <= index < 8
        return {"place": place, "variances": (4.0, variance if odd else 9.0, 16.0)}

    frames, _ = read(write(new_log, dialect, motion="", fix=fix))
    assert [f.fix.sigma_m for f in frames][5:8] == [None] * 3
    assert frames[20].fix.sigma_m == pytest.approx((2.0, 3.0, 4.0))


@pytest.mark.parametrize("place", [1, 4])
@pytest.mark.parametrize("variance", [-1.0, 0.0, math.nan])
def test_variances_of_odometry_that_cannot_be_are_taken_as_unknown(new_log, place, variance):
    def pose(index, position):
        odd = [variance if k == place and index == 9 else 0.04 for k in range(6)]
        return {"position": position, "variances": odd}

    frames, _ = read(write(new_log, "cdr", motion="odometry", fixes=False, pose=pose))
    known = [(f.pose.sigma_m, f.pose.sigma_rad) for f in frames]
    assert known[9] == ((None, pytest.approx(0.2)) if place < 3 else (pytest.approx(0.2), None))
    assert known[20] == pytest.approx((0.2, 0.2))


def test_fixes_of_infinite_variance_hold_no_position(new_log):
    def fix(index, place):
        return {"place": place, "variances": (math.inf if index < 9 else 4.0,) * 3}

    _, report = read(write(new_log, motion="", fix=fix))
    assert any("9 of 24 messages of /gps hold no position" in note for note in report.notes)


@pytest.mark.parametrize(("factor", "words"), [(7.0, "the length 7, not 1"), (0.0, "the length 0")])
def test_a_quaternion_of_another_length_than_one_is_lost_with_its_length(new_log, factor, words):
    def pose(index, position):
        turn = [part * (factor if index == 5 else 1.0) for part in TURN]
        return {"position": position, "rotation": turn}

    _, report = read(write(new_log, fixes=False, pose=pose))
    assert "1 messages of /pose lost" in str(report.problems[0])
    assert words in str(report.problems[0])


def of_two_cameras(new_log, name_of, focal_of=lambda name: 40.0, count=COUNT):
    """Images 8 m apart whose `frame_id` is given by their number, each with a calibration of the same camera."""
    log = new_log()
    for index in range(count):
        name = name_of(index)
        k = [focal_of(name), 0.0, 15.5, 0.0, focal_of(name), 11.5, 0.0, 0.0, 1.0]
        log.add("/camera/calibration", "calibration", index * STEP, frame=name, k=k)
        position = (8.0 * index, 0.0, 1.5)
        log.add("/pose", "pose", index * STEP, position=position, rotation=(0.5, -0.5, 0.5, -0.5))
        log.add_image(index, index * STEP, frame=name)
    return log.finish()


def test_images_of_another_camera_between_those_of_one_are_left_out_and_told(new_log):
    names = ["front" if k % 3 else "rear" for k in range(COUNT)]
    path = of_two_cameras(new_log, names.__getitem__, {"front": 40.0, "rear": 80.0}.__getitem__)
    frames, report = read(path)
    assert [f.status for f in frames] == [
        "used" if name == "front" else "other_camera" for name in names
    ]
    assert all(f.camera.fx == 40.0 for f in frames if f.used)
    assert any("8 images of /camera/image are of another camera" in note for note in report.notes)
    spaced = list(read_frames(path, ReadSettings(spacing_m=8.0, thin_m=0.0), ReadReport()))
    assert [f.spacing_m for f in spaced if f.used] == [None, *[8.0] * 15]


@pytest.mark.parametrize(
    "name_of",
    [lambda k: "old" if k < 9 else "new", lambda k: f"image_{k}", lambda k: "" if k % 2 else "a"],
    ids=["renamed", "a name for each image", "some without a name"],
)
def test_names_that_do_not_tell_two_cameras_leave_out_nothing(new_log, name_of):
    frames, report = read(of_two_cameras(new_log, name_of))
    assert all(f.used for f in frames)
    assert not any("another camera" in note for note in report.notes)
