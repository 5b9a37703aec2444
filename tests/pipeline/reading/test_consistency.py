"""Positions no vehicle can be at: told before anything is built on them."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from wayside.pipeline.reading.consistency import Series, check_positions, joined
from wayside.pipeline.reading.frames import ReadReport, read_frames
from wayside.schemas.errors import InputError
from wayside.schemas.settings import ReadSettings

SETTINGS = ReadSettings()
STEP = 10**9 // 4
COUNT = 24
TURN = Rotation.from_euler("z", 30, degrees=True)


def drive(count=60, rate=4.0, noise=0.0, seed=0):
    """A bend at changing speed, as a series with rotations."""
    t = np.arange(count) / rate
    heading = 0.2 * np.sin(0.3 * t)
    speed = 20 + 5 * np.sin(0.4 * t)
    step = speed[:, None] / rate * np.stack([np.cos(heading), np.sin(heading), 0 * t], axis=1)
    noise = np.random.default_rng(seed).normal(0, noise, (count, 3))
    q = Rotation.from_euler("z", heading[:, None]).as_quat()
    return Series(t, np.cumsum(step, axis=0) + noise, q)


def judged(series, **settings):
    found = check_positions(series, ReadSettings(**settings), origin_may_move=True)
    return np.flatnonzero(found.wrong).tolist(), found


@pytest.mark.parametrize("rate", [1.0, 4.0, 30.0, 200.0])
@pytest.mark.parametrize("noise", [0.0, 0.03, 0.3])
def test_a_sound_drive_is_kept_whole(rate, noise):
    wrong, found = judged(drive(400, rate, noise))
    assert wrong == []
    assert not found.origin.any()


@given(
    st.lists(st.tuples(st.integers(3, 56), st.integers(1, 2)), min_size=1, max_size=3),
    st.floats(8.0, 1e7),
    st.floats(0, 2 * math.pi),
)
@example([(3, 1)], 43.0, 0.0)  # in reach of one side only
@example([(3, 2)], 45.0, 1.0)  # a sound position out of reach of those beside it
def test_positions_aside_are_found_wherever_they_are_and_nothing_else(places, size, direction):
    series = drive(noise=0.02)
    rows = sorted({row for at, length in places for row in range(at, at + length)})
    assume(all(b - a == 1 or b - a > 6 for a, b in pairwise(rows)))
    assume(not any(set(range(a, a + 4)) <= set(rows) for a in rows))
    series.position[rows] += size * np.array([math.cos(direction), math.sin(direction), 0.0])
    assert judged(series)[0] == rows


@pytest.mark.parametrize("rows", [[0], [0, 1], [59], [58, 59], [0, 30, 31, 32, 59]])
def test_positions_off_by_kilometres_are_found_at_the_ends_too(rows):
    series = drive()
    series.position[rows] += [5000.0, 0.0, 0.0]
    assert judged(series)[0] == rows


def test_a_rotation_that_flips_there_and_back_is_wrong():
    series = drive()
    series.rotation[20] = (Rotation.from_euler("z", 90, degrees=True)).as_quat()
    assert judged(series)[0] == [20]


def test_a_short_jump_that_stays_is_left_to_the_smoothing_of_the_path():
    series = drive()
    series.position[30:] += [0.0, 15.0, 0.0]
    wrong, found = judged(series)
    assert wrong == []
    assert not found.origin.any()


@pytest.mark.parametrize("at", [20, 40])
def test_an_origin_that_moves_and_turns_is_moved_back(at):
    series = drive()
    sound = series.position.copy()
    series.position[at:] = TURN.apply(series.position[at:])
    series.position[at:] += [9000.0, -4000.0, 30.0]
    series.rotation[at:] = (TURN * Rotation.from_quat(series.rotation[at:])).as_quat()
    wrong, found = judged(series)
    assert wrong == []
    moves = joined(series, found)
    whole = np.array(
        [moves[o][0] @ p + moves[o][1] for o, p in zip(found.origin, series.position, strict=True)]
    )
    steps, true = np.diff(whole, axis=0), np.diff(sound, axis=0)
    assert np.linalg.norm(steps, axis=1) == pytest.approx(np.linalg.norm(true, axis=1), abs=0.2)
    kept = slice(0, at) if at > 30 else slice(at, None)
    assert (whole[kept] == series.position[kept]).all()  # the longest part is the frame


def test_fixes_that_leave_and_stay_away_are_left_out():
    series = drive()
    series.position[40:] += [5000.0, 0.0, 0.0]
    found = check_positions(series, SETTINGS, origin_may_move=False)
    assert np.flatnonzero(found.wrong).tolist() == list(range(40, 60))


# In logs


def write(new_log, pose=None, fix=None, calibration=None, poses=True, fixes=True):
    log = new_log()
    for index in range(COUNT):
        time = index * STEP
        more = {} if calibration is None else calibration(index)
        log.add("/camera/calibration", "calibration", time, **more)
        if poses:
            position = [8.0 * index, 0.1 * index, 1.5]
            position = position if pose is None else pose(index, position)
            log.add("/pose", "pose", time, position=position, rotation=[0.5, -0.5, 0.5, -0.5])
        if fixes:
            place = (48.0 + 7e-5 * index, 11.0, 500.0)
            log.add("/gps", "fix", time, place=place if fix is None else fix(index, place))
        log.add_image(index)
    return log.finish()


def read(path, **settings):
    report = ReadReport()
    return list(read_frames(path, ReadSettings(thin_m=0.0, **settings), report)), report


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


def test_an_origin_of_the_poses_that_moves_is_told_and_the_drive_goes_on(new_log):
    frames, report = read(write(new_log, pose=lambda i, p: [p[0] + 5000.0 * (i >= 14), *p[1:]]))
    along = [f.pose.pose.centre[0] for f in frames]
    assert np.diff(along) == pytest.approx(8.0, abs=1e-6)
    assert along[0] == 0.0
    assert any("the origin of the poses of /pose moves once" in note for note in report.notes)


def test_a_fix_aside_is_left_out_bridged_and_told(new_log):
    path = write(new_log, fix=lambda i, p: (p[0] + 0.045 * (i == 10), *p[1:]), poses=False)
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
    assert not report.lost
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
def test_variances_of_fixes_that_cannot_be_are_told_and_taken_as_unknown(
    new_log, dialect, variance
):
    log = new_log(dialect)
    for index in range(COUNT):
        odd = {"variances": (4.0, variance, 16.0)} if index in (5, 6, 7) else {}
        log.add("/gps", "fix", index * STEP, place=(48.0 + 7e-5 * index, 11.0, 500.0), **odd)
        log.add("/camera/calibration", "calibration", index * STEP)
        log.add_image(index, index * STEP)
    frames, report = read(log.finish())
    assert [f.fix.sigma_m for f in frames][5:8] == [None] * 3
    assert frames[20].fix.sigma_m == pytest.approx((2.0, 3.0, 4.0))
    assert all(f.fix is not None for f in frames)
    assert [note for note in report.notes if "negative" in note] == [
        "3 of 24 messages of /gps state a covariance with variances that are negative or not a number: it is taken as "
        "unknown, the rest is used"
    ]


@pytest.mark.parametrize("place", [1, 4])
@pytest.mark.parametrize("variance", [-1.0, math.nan])
def test_variances_of_odometry_that_cannot_be_are_told_and_taken_as_unknown(
    new_log, place, variance
):
    log = new_log("cdr")
    odd = [variance if k == place else 0.04 for k in range(6)]
    for index in range(COUNT):
        log.add("/camera/calibration", "calibration", index * STEP)
        log.add(
            "/odom",
            "odometry",
            index * STEP,
            position=(8.0 * index, 0.0, 1.5),
            rotation=(0.5, -0.5, 0.5, -0.5),
            variances=odd if index == 9 else [0.04] * 6,
        )
        log.add_image(index, index * STEP)
    frames, report = read(log.finish())
    known = [(f.pose.sigma_m, f.pose.sigma_rad) for f in frames]
    assert known[9] == ((None, pytest.approx(0.2)) if place < 3 else (pytest.approx(0.2), None))
    assert known[20] == pytest.approx((0.2, 0.2))
    assert any("1 of 24 messages of /odom state a covariance" in note for note in report.notes)


def test_fixes_of_infinite_variance_hold_no_position(new_log):
    log = new_log()
    for index in range(COUNT):
        vague = {"variances": (math.inf,) * 3} if index < 9 else {}
        log.add("/gps", "fix", index * STEP, place=(48.0 + 7e-5 * index, 11.0, 500.0), **vague)
        log.add("/camera/calibration", "calibration", index * STEP)
        log.add_image(index, index * STEP)
    _, report = read(log.finish())
    assert any("9 of 24 messages of /gps hold no position" in note for note in report.notes)


@pytest.mark.parametrize(("factor", "words"), [(7.0, "the length 7, not 1"), (0.0, "the length 0")])
def test_a_quaternion_of_another_length_than_one_is_lost_with_its_length(new_log, factor, words):
    log = new_log()
    for index in range(COUNT):
        turn = [part * (factor if index == 5 else 1.0) for part in (0.5, -0.5, 0.5, -0.5)]
        log.add("/pose", "pose", index * STEP, position=(8.0 * index, 0.0, 1.5), rotation=turn)
        log.add("/camera/calibration", "calibration", index * STEP)
        log.add_image(index, index * STEP)
    _, report = read(log.finish())
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
