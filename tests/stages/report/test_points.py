"""SIFT points of a segment, the depth that they agree on, and which segments are one panel."""

from dataclasses import replace

import numpy as np
import pytest

from wayside.schemas.frame import Pose
from wayside.schemas.landmarks import Crop
from wayside.schemas.models import GaussianClass, GaussianModel
from wayside.stages.geometry import pair_midpoint
from wayside.stages.mapping.window import untracked
from wayside.stages.report import merge_segments, triangulate_points
from wayside.stages.report.points import LEAST_EVIDENCE, SIZE_SIGMA, depth_sigma, fit_depth

from ...made_landmarks import made_landmark
from ..made_frames import drive, landmarks_of, stamp, texture

FACE = np.array([3.5, -1.2, 30.0])
LARGE, SMALL = (GaussianClass("", np.full(2, np.log(m)), np.eye(2) / 4, 1) for m in (1.1, 0.2))
ALIKE = GaussianModel("log_m", (LARGE,), "", (LARGE,))


def placed(behind=lambda square: 0.0, seeds=(0, 0), lower_px=0.0, sizes=ALIKE):
    """A landmark of a face of 1 m after two views of it: `behind(k)` is how far its k-th square of 16 is behind it."""
    frames = drive([], 2)
    crops = [shown(f, texture(256, 256, s), behind) for f, s in zip(frames, seeds, strict=True)]
    crops[1] = replace(crops[1], corner=crops[1].corner + np.array([0.0, lower_px]))
    seen = made_landmark(
        position=1.1 * (FACE - frames[1].motion.pose.centre),
        best_pose=frames[1].motion.pose,
        width_m=1.1,
        height_m=1.1,
        crops=tuple(crops),
        evidence=(("place", LEAST_EVIDENCE - 3.9),),
    )
    return landmarks_of(triangulate_points(iter([tracked_frame(frames[1], seen)]), sizes))[0]


def tracked_frame(posed, *landmarks):
    return replace(untracked(posed, posed.detections.candidates), landmarks=landmarks)


def shown(frame, face, behind):
    """What a frame shows of the face and around it."""
    camera, pose = frame.frame.camera, frame.motion.pose
    image, side = np.full((1200, 1600), 128, np.uint8), len(face) // 4
    for square in range(16):
        first = side * np.array(divmod(square, 4))[::-1]
        part = face[first[1] :, first[0] :][:side, :side]
        across = (first + (side - 1) / 2 + 0.5) / len(face) - 0.5
        x, y, z = pose.to_camera(FACE + np.array([*across, behind(square)]))
        at = np.array([camera.cx, camera.cy]) + camera.fx * np.array([x, y]) / z
        stamp(image, part, camera.fx / z / len(face), at)
    x, y, z = pose.to_camera(FACE)
    left = int(camera.cx + camera.fx * (x - 0.6) / z)
    top = int(camera.cy + camera.fx * (y - 0.6) / z)
    size = int(1.2 * camera.fx / z)
    grey = image[top : top + size, left : left + size]
    return Crop(grey, np.array([left, top], float), camera, frame.motion)


def test_a_face_stands_where_its_points_agree_and_is_as_large_as_it_looks_there():
    one = placed()
    assert one.verdict == "sign"
    error = one.best_pose.to_world(one.position) - FACE
    assert np.abs(error).max() < 0.15  # 10 % of 22 m before
    assert abs(error[2]) < 3 * np.sqrt(one.covariance[2, 2]) < 0.9
    assert [one.width_m, one.height_m] == pytest.approx([1.0, 1.0], rel=0.01)
    assert one.sigma_width_m == pytest.approx(SIZE_SIGMA * one.width_m)
    before, made = one.best_pose.to_world(1.1 * (FACE - [0, 0, 8.0])), made_landmark()
    moved = before - one.best_pose.to_world(one.position)
    change = made.right_m - one.right_m, one.above_m - made.above_m, made.station_m - one.station_m
    np.testing.assert_allclose(change, moved)
    assert one.residual_px < 0.2
    assert one.crops == ()


def test_the_residual_is_that_of_the_points():
    # Rays that pass each other by g metres miss by f g / 2 z in each view (eq. 7.5); the lines are inclined.
    near = 1.5 / 2 * 3.5 / np.hypot(3.5, 1.2)
    e = near**2 + (near * 22 / 30) ** 2
    assert placed(lower_px=1.5).residual_px == pytest.approx(np.sqrt(e / 2), abs=0.15)


@pytest.mark.parametrize("seed", range(2, 7))
def test_points_at_many_depths_and_views_of_different_things_are_no_face(seed):
    away = np.random.default_rng(seed).uniform(0, 60, 16)
    assert placed(seeds=(seed, seed)).verdict == "sign"
    assert placed(lambda square: away[square], (seed, seed)).verdict == "residual"
    assert placed(seeds=(0, seed)).verdict == "residual"


def test_a_segment_as_large_as_other_things_has_evidence_against_it():
    assert placed(sizes=GaussianModel("log_m", (SMALL,), "", (LARGE,))).verdict == "residual"


def test_a_landmark_without_pixels_or_refused_before_stays_as_it_is():
    given = [made_landmark(), made_landmark(verdict="location")]
    (frame,) = drive([], 1)
    assert landmarks_of(triangulate_points(iter([tracked_frame(frame, *given)]), ALIKE)) == given


def test_the_scatter_of_a_depth_is_that_of_simulated_midpoints():
    rng, travel = np.random.default_rng(2), np.array([0.1, 0.0, 8.0])
    point = np.array([3.0, -1.0, 20.0])  # in the nearer camera, that is `travel` ahead of the other
    rays = [(p[:2] / p[2]) + rng.normal(0, 1e-4, (4000, 2)) for p in (point + travel, point)]
    depth = pair_midpoint(*rays, np.eye(3), travel).point[:, 2] - travel[2]
    assert depth.std() == pytest.approx(1e-4 * depth_sigma(point[None], travel)[0], rel=0.05)


def test_the_depth_of_many_points_is_as_exact_as_it_says_in_spite_of_wrong_ones():
    rng, sigma = np.random.default_rng(3), np.linspace(0.1, 0.4, 12)
    off = []
    for _ in range(300):
        depth = 20 + sigma * rng.normal(0, 1, 12)
        depth[::4] = rng.uniform(5, 60, 3)
        fit = fit_depth(depth, sigma)
        off.append((fit.depth - 20) / fit.sigma)
    assert 0.6 < np.mean(np.abs(off) < 1) < 0.8
    assert np.mean(np.abs(off) < 1.96) > 0.9


def merged(frames, *landmarks):
    tracked = [tracked_frame(frame) for frame in frames]
    tracked[0] = tracked_frame(frames[0], *landmarks)
    found = list(merge_segments(iter(tracked)))
    assert [item.frame.index for item in found] == list(range(len(frames)))
    return [one.verdict for one in landmarks_of(found)]


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({}, "duplicate"),
        ({"position": np.array([3.2, -0.5, 12.2]), "station_m": 12.2}, "duplicate"),
        ({"position": np.array([3.4, -0.5, 12.0])}, "sign"),  # beside it
        ({"position": np.array([4.5, -0.75, 18.0]), "station_m": 18.0}, "sign"),  # behind it
        ({"verdict": "location"}, "location"),
    ],
)
def test_a_segment_on_a_panel_of_more_evidence_is_a_part_of_it(changes, verdict):
    legend = {"track_id": 2, "width_m": 0.2, "height_m": 0.2, "evidence": (("rigidity", 9.0),)}
    face = made_landmark(evidence=(("rigidity", 20.0),), best_pose=Pose(np.eye(3), np.zeros(3)))
    assert merged(drive([], 4), made_landmark(**legend | changes), face) == [verdict, "sign"]


def test_a_frame_waits_until_the_camera_has_passed_its_landmarks():
    given = 0

    def counted():
        nonlocal given
        for k, frame in enumerate(drive([], 5)):
            given += 1
            yield tracked_frame(frame, *([made_landmark(station_m=20.0)] if k == 0 else []))

    taken = [given for _ in merge_segments(counted())]
    assert taken == [4, 4, 4, 4, 5]  # the fourth frame is 24 m along
