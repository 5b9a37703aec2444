"""Which world the results stand in."""

import numpy as np
import pytest
from pyproj import Geod
from scipy.spatial.transform import Rotation

from wayside.pipeline.world import PathPoint, beside_in_world, place_in_world
from wayside.schemas.frame import Fix, Pose

LEVEL_CAMERA = np.array(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
)  # world x ahead, y left, z up


def camera_at(x, y=0.0, z=0.0, yaw_deg=0.0):
    turn = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    return Pose(turn @ LEVEL_CAMERA, np.array([x, y, z]))


def chain(poses):
    return [pose.relative_to(poses[0]) for pose in poses]


def test_a_drive_without_poses_starts_at_the_first_camera_with_x_ahead_y_left_z_up():
    chained = chain([camera_at(8.0 * n) for n in range(4)])
    world = place_in_world([PathPoint(2 * n, pose, None, None) for n, pose in enumerate(chained)])
    assert world.name == "drive_start"
    assert world.earth is None
    np.testing.assert_allclose(world.poses[4].centre, [16, 0, 0], atol=1e-9)
    np.testing.assert_allclose(world.poses[0].rotation, LEVEL_CAMERA, atol=1e-9)


def test_a_camera_turned_against_travel_still_gives_x_along_the_travel():
    crab = [Pose(camera_at(0, yaw_deg=10).rotation, np.array([8.0 * n, 0, 0])) for n in range(3)]
    world = place_in_world([PathPoint(n, pose, None, None) for n, pose in enumerate(chain(crab))])
    np.testing.assert_allclose(world.poses[2].centre, [16, 0, 0], atol=1e-9)


def test_given_poses_are_the_world_and_gaps_follow_the_chain():
    given = [camera_at(100 + 8 * n, 50, 3, yaw_deg=n) for n in range(5)]
    path = [
        PathPoint(n, pose, given[n] if n in (1, 4) else None, None)
        for n, pose in enumerate(chain(given))
    ]
    world = place_in_world(path)
    assert world.name == "log"
    for n in range(5):
        np.testing.assert_allclose(world.poses[n].centre, given[n].centre, atol=1e-9)
        np.testing.assert_allclose(world.poses[n].rotation, given[n].rotation, atol=1e-9)


def test_fixes_alone_give_east_north_up_at_the_first_fix():
    geod = Geod(ellps="WGS84")
    lon, lat, heading = 11.0, 48.0, 30.0
    chained = chain([camera_at(8.0 * n) for n in range(30)])
    path = []
    for n, pose in enumerate(chained):
        east, north, _ = geod.fwd(lon, lat, heading, 8.0 * n)
        path.append(PathPoint(n, pose, None, Fix(north, east, 500.0, None)))
    world = place_in_world(path)
    assert world.name == "enu"
    assert world.earth is not None
    last = world.poses[29].centre
    distance, azimuth = np.hypot(last[0], last[1]), np.degrees(np.arctan2(last[0], last[1]))
    assert distance == pytest.approx(232, abs=0.2)
    assert azimuth == pytest.approx(heading, abs=0.05)
    lonlat = world.earth.geodetic(last[None])[0]
    east, north, _ = geod.fwd(lon, lat, heading, 232.0)
    np.testing.assert_allclose(lonlat[:2], [east, north], atol=3e-6)


def test_poses_and_fixes_together_place_the_log_world_on_the_earth():
    geod = Geod(ellps="WGS84")
    given = [camera_at(8.0 * n, 5.0, 2.0) for n in range(20)]
    path = []
    for n, pose in enumerate(chain(given)):
        east, north, _ = geod.fwd(-98.0, 38.0, 90.0, 8.0 * n)  # the world's x points east
        path.append(PathPoint(n, pose, given[n], Fix(north, east, 100.0, None)))
    world = place_in_world(path)
    assert world.name == "log"
    assert world.earth is not None
    lonlat = world.earth.geodetic(np.array([[80.0, 5.0, 2.0]]))[0]
    east, north, _ = geod.fwd(-98.0, 38.0, 90.0, 80.0)
    np.testing.assert_allclose(lonlat, [east, north, 100.0], atol=1e-2)
    assert geod.inv(lonlat[0], lonlat[1], east, north)[2] < 0.05


def test_no_used_picture_is_an_empty_world():
    assert place_in_world([]).poses == {}


def test_heights_beside_the_path_follow_given_poses_and_not_the_roll_of_the_camera():
    roll = Rotation.from_euler("z", 2.0, degrees=True).as_matrix()
    poses = [camera_at(8.0 * n, z=0.16 * n) for n in range(6)]
    rolled = [Pose(pose.rotation @ roll, pose.centre) for pose in poses]
    path = [
        PathPoint(n, c, g, None) for n, (c, g) in enumerate(zip(chain(rolled), rolled, strict=True))
    ]
    world = place_in_world(path)
    slope = np.arctan(0.02)
    found = beside_in_world(world, range(6), 2, np.array([30.0, -8.0, 0.6 + 2.5]))
    assert found.right == pytest.approx(8.0)
    assert found.above == pytest.approx(2.5 * np.cos(slope))


def test_without_given_poses_the_camera_is_all_that_knows_up():
    path = [
        PathPoint(n, pose, None, None) for n, pose in enumerate(chain([camera_at(0), camera_at(8)]))
    ]
    assert beside_in_world(place_in_world(path), range(2), 0, np.zeros(3)) is None
