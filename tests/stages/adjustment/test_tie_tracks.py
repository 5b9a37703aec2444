import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wayside.stages.adjustment.tie_tracks import link_tracks, select_tracks, translation_px
from wayside.stages.geometry import rotation_from_vector


@pytest.mark.parametrize(
    ("step", "corners", "tracks"),
    [
        ([0, 0, 1, 1, 2], [(5, 1), (6, 2), (2, 9), (7, 3), (9, 4)], [0, 1, 1, 2, 1]),
        ([0, 1, 3], [(-1, -1), (-1, -1), (4, 5)], [0, 1, 2]),  # of no corner
        ([0, 2], [(0, 4), (4, 5)], [0, 1]),  # across a gap
        ([0, 0, 1, 1], [(1, 8), (2, 8), (8, 3), (8, 4)], [0, 1, 1, 2]),  # two at one corner
        ([], [], []),
    ],
)
def test_ties_that_end_and_start_at_the_same_corner_are_one_track(step, corners, tracks):
    step, corners = np.array(step, np.int64), np.array(corners, np.int64).reshape(-1, 2)
    assert link_tracks(step, corners).tolist() == tracks


def test_a_turn_moves_nothing_by_translation_and_a_step_aside_moves_by_focal_length_over_depth():
    turn = rotation_from_vector(np.array([0.02, -0.1, 0.05]))
    points = np.random.default_rng(1).uniform((-9, -3, 20), (9, 3, 60), (40, 3))

    def rays(camera):
        return camera[:, :2] / camera[:, 2:]

    still = translation_px(turn, rays(points), rays(points @ turn), 800.0)
    np.testing.assert_allclose(still, 0, atol=1e-9)
    aside = rays(points - [0.5, 0, 0])
    np.testing.assert_allclose(
        translation_px(np.eye(3), rays(points), aside, 800.0), 800 * 0.5 / points[:, 2]
    )


def test_long_tracks_come_first():
    track, step = np.array([0, 1, 1]), np.array([0, 0, 1])
    cell = np.array([[3, 2], [3, 2], [3, 2]])
    assert select_tracks(track, step, cell).tolist() == [False, True, True]


@given(arrays(np.int64, st.integers(1, 60), elements=st.integers(0, 3)), st.integers(0, 99))
def test_every_cell_that_shows_ties_keeps_one_and_tracks_stay_whole(steps, seed):
    rng = np.random.default_rng(seed)
    step = np.sort(steps)
    track = link_tracks(step, rng.integers(-1, 12, (len(step), 2)))
    cell = rng.integers(0, 4, (len(step), 2))
    kept = select_tracks(track, step, cell)
    places = np.column_stack([step, cell])
    assert {*map(tuple, places[kept].tolist())} == {*map(tuple, places.tolist())}
    for number in np.unique(track):
        assert len(np.unique(kept[track == number])) == 1
        assert len(np.unique(step[track == number])) == (track == number).sum()
