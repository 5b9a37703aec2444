"""Invented boards: their ground, what stands on it, and that a seed says all."""

import numpy as np
import pytest

from recordings.drives.signs.face import COLORS
from training.face_drawings import BOARD_WEIGHTS, draw_board


def boards(color, count=40):
    return [draw_board(color, np.random.default_rng(seed)) for seed in range(count)]


@pytest.mark.parametrize("color", BOARD_WEIGHTS)
def test_most_of_a_board_has_the_colour_it_is_named_by(color):
    names, hits = list(BOARD_WEIGHTS), 0
    for board in boards(color):
        shown = board[..., :3][board[..., 3] > 0].astype(int)
        away = np.stack([np.abs(shown - COLORS[name]).sum(axis=1) for name in names])
        hits += names[np.bincount(away.argmin(axis=0)).argmax()] == color
    assert hits >= 38


def test_boards_are_opaque_but_for_their_corners_and_all_show_something():
    for board in boards("blue"):
        assert (board[..., 3] > 0).mean() > 0.9
        assert board[..., 3].any(axis=0).all()
        assert board[..., 3].any(axis=1).all()
        assert np.ptp(board[..., :3].astype(int).sum(axis=2)) > 200


def test_boards_differ_by_their_seed_and_by_nothing_else():
    first, again = boards("green", 8), boards("green", 8)
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert len({board.tobytes() for board in first}) == 8
