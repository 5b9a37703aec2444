"""Positions, calibrations and names in a log that cannot be, and what of the log is used all the same."""

import math
from functools import partial

import pytest

from wayside.schemas.errors import InputError

from .conftest import read as read_log

read = partial(read_log, thin_m=0.0)
COUNT = 24
TURN = (0.5, -0.5, 0.5, -0.5)
SOUND = {
    "pose": ("position", lambda index: [8.0 * index, 0.1 * index, 1.5]),
    "fix": ("place", lambda index: (48.0 + 7e-5 * index, 11.0, 500.0)),
}


def write(new_log, *kinds, dialect="protobuf", **changes):
    """A drive with these (all) kinds; `pose`, `fix`: position or content by number and what it was."""

    def stream(kind, index):
        field, sound = SOUND["fix" if kind == "fix" else "pose"]
        found = changes.get(kind, lambda index, sound: sound)(index, sound(index))
        content = found if isinstance(found, dict) else {field: found}
        return {field: sound(index)} | ({} if kind == "fix" else {"rotation": TURN}) | content

    streams = {kind: partial(stream, kind) for kind in kinds or SOUND}
    return new_log(dialect).drive(COUNT, calibration=changes.get("calibration", {}), **streams)


@pytest.mark.parametrize(
    ("rows", "off"),
    [([10], 5e3), ([10], 20.0), ([0], 5e3), ([23], 5e3), ([10, 11, 12], 1e7), ([3, 10, 16], 500)],
)
def test_poses_aside_are_left_out_bridged_and_told(new_log, rows, off):
    path = write(new_log, pose=lambda i, p: [p[0] + off * (i in rows), *p[1:]])
    frames, report = read(path)
    assert all(f.used for f in frames)
    for frame in frames:
        if frame.pose is not None:
            assert frame.pose.pose.centre[0] == pytest.approx(8.0 * frame.index, abs=1e-6)
    at_an_end = rows[0] in (0, COUNT - 1)
    assert sum(f.pose is not None for f in frames) >= COUNT - at_an_end
    told = f"{len(rows)} of 24 poses of /pose are at impossible places"
    assert any(told in note for note in report.notes)


def test_poses_of_another_origin_than_most_are_left_out_and_told(new_log):
    frames, report = read(write(new_log, pose=lambda i, p: [p[0] + 5000.0 * (i >= 14), *p[1:]]))
    assert [f.index for f in frames if f.pose is not None] == list(range(14))
    assert any("10 of 24 poses of /pose are at impossible places" in n for n in report.notes)


NOWHERE = (0.0, 0.0, 0.0), (0.0, 0.0, 500.0), (math.nan, 11.0, 500.0)
NO_POSITION = [*({"place": place} for place in NOWHERE), {"variances": (math.inf,) * 3}]
NO_POSITION.append({"status": -1})


@pytest.mark.parametrize("content", NO_POSITION)
def test_fixes_without_position_are_left_out_and_counted(new_log, content):
    path = write(new_log, dialect="cdr", fix=lambda i, p: content if i < 9 else p)
    frames, report = read(path)
    assert [f.index for f in frames if f.fix is not None] == list(range(9, COUNT))
    assert any("9 of 24 messages of /gps hold no position" in n for n in report.notes)
    assert not report.problem_count
    with pytest.raises(InputError, match=r"none of the 24 messages of /gps can be used.*--spacing"):
        read(write(new_log, "fix", dialect="cdr", fix=lambda i, p: content))


def test_fixes_that_repeat_without_change_are_no_fixes_and_counted(new_log):
    path = write(new_log, fix=lambda i, p: (48.0 + 7e-5 * min(i, 11), *p[1:]))
    frames, report = read(path)
    assert [f.index for f in frames if f.fix is not None] == list(range(12))
    assert any("12 of 24 fixes of /gps repeat the one before" in n for n in report.notes)


def test_a_fix_aside_is_left_out_bridged_and_told(new_log):
    path = write(new_log, "fix", fix=lambda i, p: (p[0] + 0.045 * (i == 10), *p[1:]))
    frames, report = read(path)
    assert [f.fix.latitude_deg for f in frames] == pytest.approx(
        [48.0 + 7e-5 * i for i in range(COUNT)], abs=1e-9
    )
    assert any("1 of 24 fixes of /gps are at impossible places" in n for n in report.notes)


IMPOSSIBLE = [
    ({"position": [math.nan, 0.0, 0.0]}, "not finite"),
    ({"position": [0.0, math.inf, 0.0]}, "not finite"),
    ({"position": [0.0, 0.0, 1e308]}, ""),
    ({"position": [-1e9, 0.0, 0.0]}, ""),
    ({"rotation": [7.0 * part for part in TURN]}, "the length 7, not 1"),
    ({"rotation": [0.0] * 4}, "the length 0"),
]


@pytest.mark.parametrize(("pose", "reason"), IMPOSSIBLE)
def test_impossible_poses_are_lost_with_count_and_reason(new_log, pose, reason):
    frames, report = read(write(new_log, pose=lambda i, p: pose if i >= 12 else p))
    assert sum(f.pose is not None for f in frames) == 12
    assert "12 messages of /pose lost" in str(report.problems[0])
    assert reason in str(report.problems[0])


def test_a_stream_without_a_usable_message_is_told_with_what_it_lacks(new_log):
    def nowhere(index, position):
        return [math.nan, *position[1:]]

    frames, report = read(write(new_log, pose=nowhere))
    assert all(f.used and f.pose is None for f in frames)
    assert any("none of the 24 messages of /pose can be used" in note for note in report.notes)
    assert "24 messages of /pose lost" in str(report.problems[0])
    frames, report = read(write(new_log, fix=nowhere))
    assert all(f.used and f.fix is None for f in frames)
    lack = "no position, or one known to a kilometre at best"
    assert f"none of the 24 messages of /gps can be used: {lack}" in report.notes
    with pytest.raises(InputError, match=r"/pose.*a pose that is not finite.*--spacing"):
        read(write(new_log, "pose", pose=nowhere))


def test_an_impossible_height_costs_its_fix_only(new_log):
    frames, report = read(write(new_log, fix=lambda i, p: (*p[:2], 1e15 if i == 7 else p[2])))
    assert all(f.fix is not None and f.fix.altitude_m == pytest.approx(500.0) for f in frames)
    assert "1 message of /gps lost" in str(report.problems[0])


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
        return {"variances": (4.0, variance if odd else 9.0, 16.0)}

    frames, _ = read(write(new_log, "fix", dialect=dialect, fix=fix))
    assert [f.fix.sigma_m for f in frames][5:8] == [None] * 3
    assert frames[20].fix.sigma_m == pytest.approx((2.0, 3.0, 4.0))


@pytest.mark.parametrize("place", [1, 4])
@pytest.mark.parametrize("variance", [-1.0, 0.0, math.nan])
def test_variances_of_odometry_that_cannot_be_are_taken_as_unknown(new_log, place, variance):
    def pose(index, position):
        return {"variances": [variance if k == place and index == 9 else 0.04 for k in range(6)]}

    frames, _ = read(write(new_log, "odometry", dialect="cdr", odometry=pose))
    known = [(f.pose.sigma_m, f.pose.sigma_rad) for f in frames]
    assert known[9] == ((None, pytest.approx(0.2)) if place < 3 else (pytest.approx(0.2), None))
    assert known[20] == pytest.approx((0.2, 0.2))


def of_two_cameras(new_log, name_of, focal_of=lambda name: 40.0):
    """Images 8 m apart whose `frame_id` is given by their number, each with a calibration of the same camera."""

    def calibration(index):
        focal = focal_of(name_of(index))
        return {"frame": name_of(index), "k": [focal, 0.0, 15.5, 0.0, focal, 11.5, 0.0, 0.0, 1.0]}

    def pose(index):
        return {"position": (8.0 * index, 0.0, 1.5), "rotation": TURN}

    return new_log().drive(
        COUNT, calibration=calibration, pose=pose, image=lambda index: {"frame": name_of(index)}
    )


def test_images_of_another_camera_between_those_of_one_are_left_out_and_told(new_log):
    names = ["front" if k % 3 else "rear" for k in range(COUNT)]
    path = of_two_cameras(new_log, names.__getitem__, {"front": 40.0, "rear": 80.0}.__getitem__)
    frames, report = read(path)
    assert [f.status for f in frames] == [
        "used" if name == "front" else "other_camera" for name in names
    ]
    assert all(f.camera.fx == 40.0 for f in frames if f.used)
    assert any("8 images of /camera/image of another camera" in note for note in report.notes)
    spaced, _ = read(path, spacing_m=8.0)
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
