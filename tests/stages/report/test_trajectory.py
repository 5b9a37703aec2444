"""Trajectories in the image, by the closed form of a point that stands still, and their density."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from wayside.schemas.errors import InputError
from wayside.schemas.frame import Pose
from wayside.schemas.models import MixtureModel
from wayside.schemas.settings import TrackSettings
from wayside.stages.mapping import assemble
from wayside.stages.report import classify_trajectory, match_segments
from wayside.stages.report.trajectory import STEP_M, mean_log_ratio, trajectory_of

from ..made_frames import Panel, drive, landmarks_of


def model(space="image", threshold=-np.inf):
    rng = np.random.default_rng(4)
    roots = rng.normal(0, 0.1, (3, 4, 4))
    return MixtureModel(
        space,
        2,
        np.array([0.3, 0.7, 1.0]),
        rng.normal(0, 0.1, (3, 4)),
        roots @ roots.swapaxes(1, 2) + 1e-3 * np.eye(4),
        threshold,
        "by hand",
        "made up",
    )


def moved_by(*centres, rotations=None):
    """Poses of cameras that stand at these steps ahead."""
    turns = rotations or [np.eye(3)] * len(centres)
    return [
        Pose(turn, np.array([0, 0, STEP_M * c])) for turn, c in zip(turns, centres, strict=True)
    ]


def trajectory(point, cameras):
    """Trajectory of a point as these cameras see it."""
    local = np.array([camera.to_camera(np.array(point)) for camera in cameras])
    return trajectory_of(local[:, :2] / local[:, 2:], cameras)


def test_a_standing_point_moves_away_from_the_focus_of_expansion_as_its_depth_says():
    steps = trajectory([3.1, -0.6, 50.0], moved_by(0, 1, 2))
    for k in range(2):
        depth = 50.0 - STEP_M * k
        u, v = 3.1 / depth, -0.6 / depth
        by_depth = STEP_M / (depth - STEP_M)
        np.testing.assert_allclose(steps[k, 0], [u, v, u * by_depth, v * by_depth])
    np.testing.assert_allclose(steps[:, 1], steps[:, 0], atol=1e-12)


def test_displacements_are_those_of_a_step_of_26_4_feet():
    assert pytest.approx(26.4 * 0.3048) == STEP_M
    short = trajectory_of(np.array([[0.1, 0.0], [0.12, 0.01]]), moved_by(0, 0.5))
    np.testing.assert_allclose(short[0, 0, 2:], [0.04, 0.02])


@given(st.floats(-8, 8), st.floats(-1, 1), st.floats(-6, 6), st.floats(30, 90))
def test_without_the_rotation_an_arc_looks_like_a_straight_road(yaw, pitch, right, ahead):
    # half way through the turn the vehicle travels along the axis, whatever the turn
    turn = Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_rotvec()
    half = Rotation.from_rotvec(turn / 2)
    # axes half way through the turn are the world's axes
    arc = moved_by(0, 1, rotations=[half.inv().as_matrix(), half.as_matrix()])
    on_arc, wanted = (
        trajectory([right, -0.6, ahead], cameras)[0] for cameras in (arc, moved_by(0, 1))
    )
    np.testing.assert_allclose(on_arc[1], wanted[0], atol=1e-9)
    if abs(yaw) > 1:
        assert abs(on_arc[0, 2] - wanted[0, 2]) > 0.01


def test_the_score_is_the_mean_log_likelihood_ratio_of_the_steps_in_the_form_of_the_model():
    steps = np.random.default_rng(1).normal(0, 0.1, (5, 2, 4))
    for form, space in enumerate(("image", "compensated")):
        one = model(space)
        signs, more, others = (
            w * multivariate_normal(m, c).pdf(steps[:, form])
            for w, m, c in zip(one.weight, one.mean, one.covariance, strict=True)
        )
        assert mean_log_ratio(steps, one) == pytest.approx(np.log((signs + more) / others).mean())
    assert mean_log_ratio(np.zeros((0, 2, 4)), model()) == -np.inf
    assert mean_log_ratio(np.full((1, 2, 4), np.nan), model()) == -np.inf


def test_a_track_that_moves_otherwise_is_refused_and_so_are_its_candidates():
    def verdicts(threshold):
        frames = drive([Panel(3.5, 1.2, 90.0)], 14)
        tracked = match_segments(iter(frames), TrackSettings(fewest_views=2))
        items = list(assemble(classify_trajectory(tracked, replace(known, threshold=threshold))))
        (place,) = landmarks_of(items)
        codes = {v for item in items for v in item.candidates.verdict[item.track_id >= 0]}
        return place.verdict, len(codes), mean_log_ratio(trajectory_of(*place.trace), known)

    known = model()
    verdict, kinds, score = verdicts(-np.inf)
    assert (verdict, kinds) == ("sign", 1)
    assert np.isfinite(score)
    assert verdicts(score - 1e-6)[:2] == ("sign", 1)
    assert verdicts(score + 1e-6)[:2] == ("trajectory", 1)


def test_a_model_of_another_space_is_refused():
    with pytest.raises(InputError, match="image, compensated"):
        next(classify_trajectory(iter([]), model("right_up_m")))
