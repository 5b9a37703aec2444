"""Rays of random roadside points in two images of a camera that turns and goes a baseline ahead."""

import numpy as np
from scipy.spatial.transform import Rotation

FOCAL, SIGMA_PX = 1400.0, 0.1
AHEAD = np.array([0.0, 0.0, 1.0])


def make_pair(noise_px=SIGMA_PX, count=60, seed=0, turn=(0.003, 0.03, -0.002), slope=(0.02, -0.01)):
    """Rotation, direction, points (first camera, baselines), and their rays in both images."""
    generator = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    direction = np.array([*slope, 1.0]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    points = generator.uniform((-1.5, -0.8, 1.8), (1.5, 0.25, 11), (count, 3))
    local = (points - direction) @ rotation
    noise = generator.normal(0, noise_px, (2, count, 2)) / FOCAL
    previous = points[:, :2] / points[:, 2:] + noise[0]
    return rotation, direction, points, previous, local[:, :2] / local[:, 2:] + noise[1]


def errors_deg(found, rotation, direction):
    """Of the rotation and of the direction that were found, degrees."""
    turn = Rotation.from_matrix(found.rotation @ rotation.T).magnitude()
    return np.degrees([turn, np.linalg.norm(np.cross(found.direction, direction))])
