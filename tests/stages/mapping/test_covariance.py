import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.stages.mapping.landmark import point_covariance

POINT = np.array([3.5, -1.0, 60.0])
FRAMES = 6


def project(point, rotation, centre):
    local = rotation.T @ (point - centre)
    return local[:2] / local[2]


def solve(rotations, centres, rays):
    def gaps(point):
        return np.concatenate(
            [project(point, r, c) - ray for r, c, ray in zip(rotations, centres, rays, strict=True)]
        )

    return least_squares(gaps, POINT, x_scale=[1, 1, 10]).x


def test_the_covariance_is_that_of_simulated_drives():
    rng = np.random.default_rng(11)
    ray_sigma = 0.7 / 1400
    step_sigma = np.array([2e-4, 2e-4, 2e-4, 0.01, 0.005, 0.02])
    rotations = np.repeat(np.eye(3)[None], FRAMES, axis=0)
    centres = np.array([[0.0, 0.0, 8.0 * k] for k in range(FRAMES)])
    true_rays = [project(POINT, r, c) for r, c in zip(rotations, centres, strict=True)]
    best = FRAMES - 2
    found = []
    for _ in range(400):
        chain_r, chain_c = [np.eye(3)], [np.zeros(3)]
        for _ in range(1, FRAMES):
            error = rng.normal(0, step_sigma)
            turn = Rotation.from_rotvec(error[:3]).as_matrix()
            chain_c.append(chain_c[-1] + chain_r[-1] @ (np.array([0, 0, 8.0]) + error[3:]))
            chain_r.append(chain_r[-1] @ turn)
        point = solve(chain_r, chain_c, true_rays + rng.normal(0, ray_sigma, (FRAMES, 2)))
        found.append(chain_r[best].T @ (point - chain_c[best]))
    simulated = np.cov(np.array(found).T)
    sigma, steps = np.full(FRAMES, ray_sigma), np.repeat(np.diag(step_sigma**2)[None], FRAMES, 0)
    views = np.arange(FRAMES), sigma, sigma
    stated = point_covariance(rotations, centres, POINT, *views, steps, best)
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), np.sqrt(np.diag(simulated)), rtol=0.12)
