"""Images of a chessboard seen by a camera with a known lens, rendered with the inverse of its projection."""

import cv2
import numpy as np
import pytest

from wayside.schemas.frame import Camera

CAMERA = Camera(480, 360, 390.0, 392.0, 248.0, 174.0, (-0.22, 0.06, 0.0008, -0.0005, 0.0))
COLUMNS, ROWS = 9, 6
_SUB = 3  # samples of a pixel along each axis


class BoardRenderer:
    """Renders a board of COLUMNS x ROWS inner corners; the rays of all sub-pixels are computed once."""

    def __init__(self, camera):
        self.camera = camera
        u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height))
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
        matrix, lens = camera.matrix, np.array(camera.distortion)
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-12)
        rays = cv2.undistortPoints(pixels, matrix, lens, R=None, P=None, criteria=stop)
        self.rays = rays.reshape(camera.height, camera.width, 2)
        self.down, self.right = np.gradient(self.rays, axis=0), np.gradient(self.rays, axis=1)

    def __call__(self, rotation, shift, seed):
        """Grey image of the board whose points (x, y, 0), in squares, lie at `rotation @ point + shift`."""
        image = np.full(self.rays.shape[:2], 200.0)
        part = self._part(rotation, shift)
        # Plane of the board: the ray s * (x, y, 1) meets it where its third board coordinate is 0.
        normal, offset = rotation[:, 2], rotation[:, 2] @ shift
        centres, right, down = self.rays[part], self.right[part], self.down[part]
        total = np.zeros(centres.shape[:2])
        for i in range(_SUB * _SUB):
            dx, dy = (i % _SUB + 0.5) / _SUB - 0.5, (i // _SUB + 0.5) / _SUB - 0.5
            rays = centres + dx * right + dy * down
            depth = offset / (rays @ normal[:2] + normal[2])
            x = depth * (rays @ rotation[:2, 0] + rotation[2, 0]) - rotation[:, 0] @ shift
            y = depth * (rays @ rotation[:2, 1] + rotation[2, 1]) - rotation[:, 1] @ shift
            # Inner corner (0, 0) is the origin: squares start at -1.
            column, row = np.floor(x).astype(np.int16), np.floor(y).astype(np.int16)
            inside = (column >= -1) & (column < COLUMNS) & (row >= -1) & (row < ROWS)
            total += np.where(inside & ((column + row) % 2 == 0), 30.0, 200.0)
        image[part] = total / _SUB**2
        image = cv2.GaussianBlur(image, (0, 0), 0.7)
        image += np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _part(self, rotation, shift):
        """Rows and columns of the image with the board."""
        rim = [[x, y, 0.0] for x in np.linspace(-1, COLUMNS, 9) for y in (-1, ROWS)]
        rim += [[x, y, 0.0] for x in (-1, COLUMNS) for y in np.linspace(-1, ROWS, 9)]
        c = self.camera
        seen = cv2.projectPoints(
            np.array(rim), cv2.Rodrigues(rotation)[0], shift, c.matrix, np.array(c.distortion)
        )[0].reshape(-1, 2)
        (x0, y0), (x1, y1) = seen.min(axis=0) - 3, seen.max(axis=0) + 4
        return slice(max(0, int(y0)), int(y1)), slice(max(0, int(x0)), int(x1))


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


@pytest.fixture(scope="session")
def poses():
    return board_poses
