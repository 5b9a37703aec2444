"""The world frame of a drive, its path in it and on the globe."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pyproj import Geod
from scipy.spatial.transform import Rotation

from wayside.schemas.frame import Fix, Pose, PosePrior
from wayside.schemas.settings import MotionSettings
from wayside.stages.georeference import LocalOrigin, PathPoint, georeference
from wayside.stages.georeference.placement import mean_scale

GEOD = Geod(ellps="WGS84")
LEVEL_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # world x ahead, y left, z up


def between(first, second, part):
    """A fix interpolated between two."""
    a, b = (np.array([f.latitude_deg, f.longitude_deg, f.altitude_m]) for f in (first, second))
    return Fix(*(a + (b - a) * part).tolist(), first.sigma_m)


def distance_m(path, n, fix):
    """From the n-th place of the path on the globe to a fix, level."""
    lon, lat, _ = path.globe.route()[n]
    return GEOD.inv(lon, lat, fix.longitude_deg, fix.latitude_deg)[2]


def camera_at(x, y=0.0, z=0.0, yaw_deg=0.0):
    turn = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    return Pose(turn @ LEVEL_CAMERA, np.array([x, y, z]))


def told(poses):
    return [PosePrior(pose, None, None, "poses") for pose in poses]


def path_through(points, antenna_m=(0.0, 0.0, 0.0)):
    right, down, ahead = antenna_m
    motion = MotionSettings(antenna_right_m=right, antenna_down_m=down, antenna_ahead_m=ahead)
    (path,) = georeference(iter(points), motion)
    return path


def test_a_drive_without_poses_starts_at_the_first_camera_with_x_ahead_y_left_z_up():
    for yaw_deg in (0, 10):  # a camera turned against the travel gives x along the travel
        turn = camera_at(0, yaw_deg=yaw_deg).rotation
        poses = [Pose(turn, np.array([8.0 * n, 0, 0])) for n in range(4)]
        path = path_through(path_of(poses, [None] * 4))
        assert (path.world, path.globe) == ("drive_start", None)
        np.testing.assert_allclose(path.poses[2].centre, [16, 0, 0], atol=1e-9)
        np.testing.assert_allclose(path.poses[0].rotation, turn, atol=1e-9)
        assert path.offset_of(np.zeros(3), 0) is None  # the camera is all that knows up
    assert path_through([]).poses == {}


def test_lengths_by_points_are_said_and_the_error_of_their_scale_is_that_of_sizes():
    poses, own = [camera_at(8.0 * n) for n in range(6)], np.diag([1e-6] * 3 + [0.01, 0.01, 0.16])
    sources = ["start", "straight", "straight", "points", "points", "points"]
    length = 8.0 + np.arange(6)
    points = path_of(poses, [None] * 6, covariance=[own] * 6, source=sources, baseline_m=length)
    path = path_through(points)
    (note,) = path.notes
    assert "3 of 5 steps, the first to frame 3, points in the images" in note
    assert "11.00 m to 13.00 m" in note
    assert list(path.scales) == [3, 4, 5]
    np.testing.assert_allclose(path.poses[5].centre, [40, 0, 0], atol=1e-9)
    scale = mean_scale(list(path.scales.values()))
    assert (scale.factor, scale.sigma) == (1.0, pytest.approx(0.05))
    assert scale.sigma_before == pytest.approx(scale.sigma)  # positions have it already
    assert path_through(points[:3]).notes == ()
    assert not path_through(points[:3]).scales


def test_given_poses_are_the_world_and_gaps_follow_the_chain():
    given = [camera_at(100 + 8 * n, 50, 3, yaw_deg=n) for n in range(5)]
    some = [None, told(given)[1], None, None, told(given)[4]]
    path = path_through(path_of(given, [None] * 5, some))
    assert (path.world, path.globe) == ("log", None)
    for n in range(5):
        np.testing.assert_allclose(path.poses[n].centre, given[n].centre, atol=1e-9)
        np.testing.assert_allclose(path.poses[n].rotation, given[n].rotation, atol=1e-9)


@pytest.mark.parametrize(("world", "heading", "off_m"), [("enu", 30.0, 0.3), ("log", 90.0, 0.05)])
def test_fixes_place_a_drive_on_the_earth_in_its_own_world_or_east_north_up(world, heading, off_m):
    given = [camera_at(8.0 * n, 5.0, 2.0) for n in range(30)]
    ends = [GEOD.fwd(11.0, 48.0, heading, 8.0 * n) for n in range(30)]  # the log's x points east
    fixes = [Fix(north, east, 500.0, None) for east, north, _ in ends]
    path = path_through(path_of(given, fixes, told(given) if world == "log" else None))
    assert path.world == world
    assert path.globe.route()[29][2] == pytest.approx(500.0, abs=1e-2)
    assert distance_m(path, 29, fixes[29]) < off_m
    if world == "enu":
        radians = np.radians(heading)
        expected = [232 * np.sin(radians), 232 * np.cos(radians)]
        np.testing.assert_allclose(path.poses[29].centre[:2], expected, atol=0.2)


def test_heights_beside_the_path_follow_given_poses_and_not_the_roll_of_the_camera():
    roll = Rotation.from_euler("z", 2.0, degrees=True).as_matrix()
    poses = [camera_at(8.0 * n, z=0.16 * n) for n in range(6)]
    rolled = [Pose(pose.rotation @ roll, pose.centre) for pose in poses]
    path = path_through(path_of(rolled, [None] * 6, told(rolled)))
    slope = np.arctan(0.02)
    found = path.offset_of(np.array([30.0, -8.0, 0.6 + 2.5]), 2)
    assert found.right == pytest.approx(8.0)
    assert found.above == pytest.approx(2.5 * np.cos(slope))


def fixes_on(poses, heading_deg=0.0, sigma=None, turn=None):
    """Fixes of a drive whose world is turned against north, one for each pose."""
    origin = LocalOrigin(48.0, 11.0, 500.0)
    about_up = Rotation.from_euler("z", heading_deg, degrees=True).as_matrix()
    local = np.array([p.centre if turn is None else p.to_world(turn) for p in poses])
    places = origin.geodetic(local @ about_up.T).tolist()
    return [Fix(lat, lon, alt, sigma) for lon, lat, alt in places]


def bend(n):
    """A drive round bends to the left and to the right, an image every 8 m."""
    heading = 0.9 * np.sin(np.arange(n) / 6)
    x, y = np.cumsum(8 * np.cos(heading)), np.cumsum(8 * np.sin(heading))
    return [camera_at(*at) for at in zip(x, y, 0 * x, np.degrees(heading), strict=True)]


def path_of(poses, fixes, given=None, **changes):
    points, given = [], given or [None] * len(poses)
    chained = [pose.relative_to(poses[0]) for pose in poses]
    for n, (pose, known, fix) in enumerate(zip(chained, given, fixes, strict=True)):
        more = {name: values[n] for name, values in changes.items()}
        points.append(PathPoint(n, pose, known, fix, time_ns=n * 10**9, **more))
    return points


def test_an_antenna_behind_the_camera_is_told_by_the_settings():
    poses, antenna = bend(30), (0.4, -1.2, -3.0)
    fixes = fixes_on(poses, 20.0, (0.02, 0.02, 0.03), np.array(antenna))
    with_lever_arm, without = (path_through(path_of(poses, fixes), a) for a in (antenna, (0, 0, 0)))
    truth = fixes_on(poses, 20.0)
    for path, low, high in ((with_lever_arm, 0.0, 0.05), (without, 0.3, 5.0)):
        away = [distance_m(path, n, fix) for n, fix in enumerate(truth)]
        assert low <= np.median(away) <= high


def test_lengths_that_came_from_fixes_are_known_better_in_the_end():
    poses, rng = bend(40), np.random.default_rng(2)
    noisy = [poses[0]]
    wrong = 1 + rng.normal(0, 0.02, 40)
    for n in range(1, 40):
        step = poses[n].relative_to(poses[n - 1])
        noisy.append(noisy[-1].compose(Pose(step.rotation, step.centre * wrong[n])))
    fixes = fixes_on(poses, 70.0, (0.5, 0.5, 0.8))
    ratio = [(np.nan, np.nan)] * 2 + [(1.0, 0.001)] * 38
    source = ["start"] + ["fixes"] * 39
    path = path_through(path_of(noisy, fixes, source=source, length_ratio=ratio))
    factor = np.array([path.scales[n].factor for n in range(1, 40)])
    np.testing.assert_allclose(factor, 1 / wrong[1:], atol=0.003)
    assert np.mean([one.factor for one in path.scales.values()]) == pytest.approx(1.0, abs=0.02)
    assert all(one.sigma < 0.01 for one in path.scales.values())


def test_outliers_and_gaps_of_fixes_are_noted():
    poses = bend(60)
    fixes = fixes_on(poses, 0.0, (0.5, 0.5, 0.8))
    fixes[30] = Fix(fixes[30].latitude_deg + 0.001, fixes[30].longitude_deg, 500.0, (0.5, 0.5, 0.8))
    fixes[40:56] = [None] * 16
    path = path_through(path_of(poses, fixes))
    assert path.notes[0] == "1 of 44 fixes do not fit the motion between the frames: excluded"
    assert "no fixes for 17 s (frames 39 to 56): positions there are known to " in path.notes[1]


def test_a_time_offset_of_the_fixes_is_noted_and_undone():
    late = bend(60)
    poses = [late[0], *late]
    shifted = fixes_on(poses[:60], 10.0, (0.05, 0.05, 0.08))  # each fix is of the image before
    exact = fixes_on(late, 10.0, (0.05, 0.05, 0.08))
    half = [between(a, b, 0.5) for a, b in zip(exact, shifted, strict=True)]
    path = path_through(path_of(late, half))
    assert path.notes[0].startswith("the fixes are 0.")
    assert "s behind the images" in path.notes[0]
    assert distance_m(path, 30, exact[30]) < 0.6


def test_fixes_of_another_continent_move_neither_origin_nor_path():
    poses = bend(30)
    fixes = fixes_on(poses, 0.0, (1.0, 1.0, 1.6))
    kept = path_through(path_of(poses, fixes))
    fixes[0] = Fix(0.0, 0.0, 0.0, (1.0, 1.0, 1.6))
    path = path_through(path_of(poses, fixes))
    assert path.globe.origin.latitude_deg == pytest.approx(48.0, abs=0.01)
    np.testing.assert_allclose(path.globe.route()[10], kept.globe.route()[10], atol=1e-5)


def test_poses_that_drift_do_not_bend_the_place_on_the_globe():
    poses = [camera_at(8.0 * n) for n in range(250)]
    drifted = [Pose(p.rotation, p.centre * [1.004, 1, 1]) for p in poses]  # 8 m over 2 km
    given = [PosePrior(p, 0.02, 0.001, "odometry") for p in drifted]
    path = path_through(path_of(poses, fixes_on(poses, 45.0, (1.0, 1.0, 1.6)), given))
    truth = fixes_on(poses, 45.0)
    assert all(distance_m(path, n, truth[n]) < 1.0 for n in (0, 125, 249))
    np.testing.assert_allclose(path.poses[249].centre, drifted[249].centre, atol=0.1)


def test_what_is_stated_of_a_sign_on_the_globe_holds_camera_and_sign():
    poses = bend(30)
    path = path_through(path_of(poses, fixes_on(poses, 0.0, (1.0, 1.0, 1.6))))
    own = np.diag([0.04, 0.01, 0.25])
    spread = path.globe.point_covariance(15, np.array([3.0, -0.5, 12.0]), own)
    bare = path.globe.point_covariance(15, np.zeros(3), np.zeros((3, 3)))
    assert np.sqrt(bare[0, 0]) == pytest.approx(1.0, abs=0.2)
    turned = path.globe.pose(15).rotation @ own @ path.globe.pose(15).rotation.T
    assert (np.linalg.eigvalsh(spread - turned) > 0).all()


@pytest.mark.parametrize("what", ["poses", "fixes"])
def test_a_jump_is_noted_with_its_place(what):
    poses = bend(80)
    moved = [Pose(p.rotation, np.add(p.centre, [3.0, 4.0, 0.0])) for p in poses]
    if what == "poses":
        given = [PosePrior(p, 0.02, 0.001, "poses") for p in [*poses[:50], *moved[50:]]]
        path = path_through(path_of(poses, [None] * 80, given))
    else:
        fixes = fixes_on([*poses[:50], *moved[50:]], 0.0, (0.5, 0.5, 0.8))
        path = path_through(path_of(poses, fixes))
    assert f"the {what} jump once, furthest by 5.0 m at frame 50" in path.notes


def test_rare_fixes_that_cut_a_bend_do_not_spoil_the_steps():
    poses = bend(81)
    exact = fixes_on(poses, 30.0, (0.05, 0.05, 0.08))
    bare = [between(exact[n - n % 4], exact[min(n - n % 4 + 4, 80)], n % 4 / 4) for n in range(81)]
    rare = [replace(fix, span_s=4.0 if n % 4 else 0.0) for n, fix in enumerate(bare)]
    true = [np.linalg.norm(b.centre - a.centre) for a, b in pairwise(poses)]
    for fixes, low, high in ((rare, 0.0, 0.03), (bare, 0.2, np.inf)):
        found = list(path_through(path_of(poses, fixes)).poses.values())
        way = [np.linalg.norm(b.centre - a.centre) for a, b in pairwise(found)]
        assert low <= np.abs(np.subtract(way, true)).max() < high


def test_one_fix_among_poses_places_the_camera_and_leaves_north_open():
    poses = bend(6)
    fixes = [None, *fixes_on(poses)[1:2], *[None] * 4]
    assert path_through(path_of(poses, fixes)).world == "drive_start"
    path = path_through(path_of(poses, fixes, told(poses)))
    point = np.array([0.0, 0.0, 20.0])
    none = np.zeros((3, 3))
    assert path.globe.point_covariance(1, 0 * point, none).trace() < 4**2
    assert path.globe.point_covariance(1, point, none).trace() > 20**2


def test_places_in_a_gap_of_the_poses_are_as_unsure_as_the_chain():
    poses = bend(40)
    fixes = fixes_on(poses, 0.0, (0.3, 0.3, 0.5))
    fixes[5:35] = [None] * 30
    given = told(poses)
    loose = [np.diag([1e-4] * 3 + [0.25] * 3)] * 40
    sigmas = []
    for known in (given, [*given[:8], *[None] * 24, *given[32:]]):
        globe = path_through(path_of(poses, fixes, known, covariance=loose)).globe
        sigmas.append(np.sqrt(globe.point_covariance(20, np.zeros(3), np.zeros((3, 3)))[0, 0]))
    assert sigmas[1] > 1.5 * sigmas[0]
