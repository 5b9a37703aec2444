"""Images of a chessboard seen by a camera with a known lens, rendered with the inverse of its projection."""

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Camera

CAMERA = Camera(480, 360, 390.0, 392.0, 248.0, 174.0, (-0.22, 0.06, 0.0008, -0.0005, 0.0))
COLUMNS, ROWS = 9, 6
_SQUARE = 64  # texels along a side of a square, of which a pixel shows two or three


class BoardRenderer:
    """Renders a board of COLUMNS x ROWS inner corners."""

    def __init__(self, camera):
        self.camera = camera
        u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height))
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
        matrix, lens = camera.matrix, np.array(camera.distortion)
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        rays = cv2.undistortPoints(pixels, matrix, lens, R=None, P=None, criteria=stop)
        self.rays = rays.reshape(camera.height, camera.width, 2)
        row, column = np.indices((ROWS + 1, COLUMNS + 1))
        squares = np.where((row + column) % 2 == 0, 30.0, 200.0)
        sharp = np.kron(squares, np.ones((_SQUARE, _SQUARE)))
        self.board = cv2.GaussianBlur(np.pad(sharp, _SQUARE, constant_values=200.0), (0, 0), 1.3)

    def __call__(self, rotation, shift, seed):
        """Grey image of the board whose points (x, y, 0), in squares, lie at `rotation @ point + shift`."""
        # Plane of the board: the ray s * (x, y, 1) meets it where its third board coordinate is 0.
        depth = rotation[:, 2] @ shift / (self.rays @ rotation[:2, 2] + rotation[2, 2])
        along = self.rays @ rotation[:2, :2] + rotation[2, :2]
        place = depth[..., None] * along - shift @ rotation[:, :2]
        # Inner corner (0, 0) is the origin: squares start at -1, and before them a margin.
        texel = ((place + 2) * _SQUARE - 0.5).astype(np.float32)
        image = cv2.remap(self.board, texel, None, cv2.INTER_LINEAR, borderValue=200.0)
        image = cv2.GaussianBlur(image, (0, 0), 0.7)
        image += np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def board_poses(count, tilt_deg, seed=3):
    """Rotations (3, 3) and shifts (3,) of boards all over the image, tilted in turn about every axis in its plane."""
    rng = np.random.default_rng(seed)
    found = []
    centre = np.array([(COLUMNS - 1) / 2, (ROWS - 1) / 2, 0.0])
    for i in range(count):
        direction = 2.4 * i
        axis = np.array([np.cos(direction), np.sin(direction), 0.0]) * np.radians(tilt_deg)
        rotation = (
            cv2.Rodrigues(axis)[0] @ cv2.Rodrigues(np.array([0, 0, rng.uniform(-0.4, 0.4)]))[0]
        )
        place = np.array([rng.uniform(-0.35, 0.35), rng.uniform(-0.25, 0.25), 1.0])
        found.append((rotation, rng.uniform(13.0, 17.0) * place - rotation @ centre))
    return found


@pytest.fixture(scope="session")
def renderer():
    return BoardRenderer(CAMERA)
