"""Inner corners of a chessboard in an image."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from wayside.stages.kernels import Array

WINDOW = 0.33
"""Half side of the window that refines a corner, by the distance to the next: least scatter, 0.04 px (measured)."""
LARGEST_WINDOW_PX = 11
"""That half side at most, as boards are not flat."""
_SMALLEST_PART = (3, 3)
_THOROUGH = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
"""Equalised histograms (CALIB_CB_NORMALIZE_IMAGE) are left out: they cost a third of a pixel on rendered boards."""
_REFINED = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)


class Board(NamedTuple):
    """Inner corners along the two sides of a chessboard, and the side of a square in metres (nan: unknown)."""

    columns: int
    rows: int
    square_m: float

    @property
    def points(self) -> NDArray[np.float32]:
        """Corners (n, 3) on the board, row by row, in squares."""
        grid = np.mgrid[: self.columns, : self.rows].T.reshape(-1, 2)
        return np.hstack([grid, np.zeros((len(grid), 1))]).astype(np.float32)


class FoundBoard(NamedTuple):
    """Corners (n, 2) in pixels in the order of `Board.points`, or None and the reason in words."""

    corners: Array | None
    why: str


def find_board(grey: NDArray[np.uint8], board: Board) -> FoundBoard:
    """Find all inner corners of a board in a grey image (height, width).

    By localised Radon transform (Duda and Frese 2018), or else by its quadrangles. The corners are then refined to
    where the gradients around a corner are orthogonal to the lines to it (Förstner and Gülch 1987). A board of which
    only a part is found is named as such: its corners cannot be numbered.
    """
    shape = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(grey, shape, flags=_THOROUGH)
    if not found:
        found, corners = cv2.findChessboardCorners(grey, shape)
    if found:
        return FoundBoard(_refined(grey, np.array(corners, np.float32), board), "")
    wanted = f"{board.columns} x {board.rows} inner corners"
    part, _, meta = cv2.findChessboardCornersSBWithMeta(
        grey, _SMALLEST_PART, _THOROUGH | cv2.CALIB_CB_LARGER
    )
    if part and meta is not None and sorted(meta.shape[:2]) != sorted(shape):
        height, width = meta.shape[:2]
        return FoundBoard(
            None,
            f"{width} x {height} inner corners found, not {wanted}: the board is cut off, partly "
            "hidden, or another",
        )
    return FoundBoard(None, f"no board of {wanted} found: too blurred, too small, or another board")


def _refined(grey: NDArray[np.uint8], corners: NDArray[np.float32], board: Board) -> Array:
    """Corners (n, 2) refined in windows that do not reach the next corner."""
    grid = corners.reshape(board.rows, board.columns, 2)
    gaps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)]
    half = int(np.clip(WINDOW * min(gaps), 2, LARGEST_WINDOW_PX))
    refined = cv2.cornerSubPix(grey, corners.reshape(-1, 1, 2), (half, half), (-1, -1), _REFINED)
    return np.asarray(refined, np.float64).reshape(-1, 2)
