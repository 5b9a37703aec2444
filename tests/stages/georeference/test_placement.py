"""What the end of the drive keeps of its frames, and the signs placed on its path."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.detections import Candidates, Regions
from wayside.schemas.frame import Frame
from wayside.schemas.landmarks import TrackedFrame
from wayside.schemas.settings import MotionSettings
from wayside.stages.georeference import DriveRecord, StepScale, collect, georeference, place_signs
from wayside.stages.georeference.placement import ROAD_SIGMA_M, ROLL_RAD, ROUGH_HEIGHT

from ...made_landmarks import made_landmark, made_motion


def landmark(track=1, station=12.0, **changes):
    return made_landmark(track_id=track, station_m=station, **changes)


def tracked(index, *landmarks, used=True):
    frame = Frame(index, index * 10**9, None, "used" if used else "thinned", "jpeg", b"", None)
    motion = made_motion(index) if used else None
    none = np.zeros(0, np.int32), np.zeros(0, np.float32)
    return TrackedFrame(frame, motion, Candidates.of(Regions.empty()), *none, 0, landmarks)


def path_of():
    record = DriveRecord()
    list(collect(map(tracked, range(4)), record))
    (path,) = georeference(iter(record.points), MotionSettings())
    return path


def scaled(path, factor, sigma=0.01, before=0.05):
    """The path as if fixes had found every step longer by a factor."""
    scales = {frame: StepScale(factor, sigma, before) for frame in path.poses}
    stations = {frame: factor * station for frame, station in path.stations.items()}
    return replace(path, scales=scales, stations=stations)


def signs(*landmarks, path=None):
    return list(place_signs(iter(landmarks), path or path_of(), 0.5))


def test_every_frame_is_passed_on_and_its_accepted_landmarks_are_kept():
    refused = landmark(5, verdict="moving")
    frames = [tracked(0), tracked(1, used=False), tracked(2, landmark(4), refused)]
    record = DriveRecord()
    assert list(collect(iter(frames), record)) == frames
    assert [point.frame for point in record.points] == [0, 2]
    assert [one.track_id for one in record.landmarks] == [4]


def test_signs_are_numbered_by_station_and_share_the_number_of_their_support():
    found = signs(landmark(7, 30.0, assembly=2), landmark(8, 10.0), landmark(9, 31.0, assembly=2))
    numbers = [(s.landmark.track_id, s.number, s.assembly) for s in found]
    assert numbers == [(8, 1, 1), (7, 2, 2), (9, 3, 2)]


@pytest.mark.parametrize(
    ("score", "back", "status"),
    [(3.0, False, "sign"), (-0.1, False, "uncertain"), (-3.0, True, "back"), (900.0, True, "back")],
)
def test_a_face_below_the_threshold_is_uncertain_and_a_back_stays_one(score, back, status):
    (sign,) = signs(landmark(score=score, back=back))
    assert sign.status == status
    assert 0 < sign.confidence <= 1


def test_a_sign_stands_where_its_best_camera_puts_it():
    path = path_of()
    (sign,) = signs(landmark(), path=path)
    np.testing.assert_allclose(sign.centre, path.poses[1].to_world(sign.position))
    np.testing.assert_allclose(sign.centre, [20, -3, 0.5], atol=1e-9)  # ahead, left, up
    turned = path.poses[1].rotation @ sign.covariance @ path.poses[1].rotation.T
    np.testing.assert_allclose(sign.world_covariance, turned)
    assert (sign.lateral_m, sign.up_m, sign.bottom_m) == pytest.approx((3.0, 2.3, 1.9))
    assert sign.globe is None


@pytest.mark.parametrize(
    ("world", "more_m"),
    [
        ("log", ()),
        ("drive_start", (3.0 * ROLL_RAD,)),
        ("enu", (3.0 * ROLL_RAD, 1.8 * ROUGH_HEIGHT)),
    ],
)
def test_the_error_of_the_lower_edge_holds_the_road_and_what_the_log_does_not_know(world, more_m):
    (sign,) = signs(landmark(), path=replace(path_of(), world=world))
    own_m = sign.covariance[1, 1] ** 0.5, sign.sigma_height_m / 2
    assert sign.sigma_bottom_m == pytest.approx(np.linalg.norm([*own_m, ROAD_SIGMA_M, *more_m]))


def test_the_lower_edge_is_less_sure_beyond_the_last_image_where_the_road_may_bend():
    path = path_of()
    near, far = signs(*(landmark(station=path.given_stations[-1] + m) for m in (0, 40)), path=path)
    assert far.sigma_bottom_m == pytest.approx(np.hypot(near.sigma_bottom_m, 2.5e-4 * 40**2 / 2))


def test_without_a_camera_height_nothing_is_known_of_heights_above_the_road():
    (sign,) = signs(landmark(), path=replace(path_of(), camera_height_m=None))
    assert np.isnan([sign.up_m, sign.bottom_m, sign.sigma_bottom_m]).all()


def test_position_size_and_station_follow_the_final_lengths():
    path = scaled(path_of(), 1.025)
    one, (sign,) = landmark(), signs(landmark(), path=path)
    np.testing.assert_allclose(sign.position, 1.025 * one.position)
    assert (sign.width_m, sign.height_m) == pytest.approx((0.615, 0.82))
    assert sign.sigma_width_m == pytest.approx(np.hypot(1.025 * 0.02, 0.01 * 0.615))
    assert sign.station_m == pytest.approx(12 * 1.025)
    beyond = path.stations[3] + 100
    assert path.station_of(24.0 + 100) == pytest.approx(beyond)


def test_lengths_known_better_in_the_end_leave_less_scatter_and_still_a_covariance():
    for before in (0.005, 0.5):
        (sign,) = signs(landmark(), path=scaled(path_of(), 1.0, 0.001, before))
        assert sign.covariance[2, 2] < landmark().covariance[2, 2]
        assert (np.linalg.eigvalsh(sign.covariance) > 0).all()
