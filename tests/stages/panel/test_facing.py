import numpy as np
import pytest
from scipy.optimize import least_squares

from wayside.stages.panel import facing
from wayside.stages.panel.rectification import PanelPlane

PLANE = PanelPlane(
    np.array([4.0, -1.5, 60.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0])
)
CENTRES = np.array([[0.1 * k, 0.0, 8.0 * k] for k in range(1, 7)])[::-1].copy()


def solve_facing(centres, sizes, sigmas, angle_sigma, aspect=None, aspect_sigma=0.02):
    prior = {"aspect": aspect, "facing_sigma": angle_sigma, "aspect_sigma": aspect_sigma}
    return facing.solve_facing(PLANE, centres, sizes, sigmas, cauchy=2.385, **prior)


def covered(angle, width, height):
    """Width and height on the plane, seen from each centre: rays through the ends, met one by one."""
    across = np.array([np.cos(angle), 0, -np.sin(angle)]) * width / 2
    below = np.array([0, height / 2, 0])
    sizes = []
    for centre in CENTRES:
        met = []
        for end in (-across, across, -below, below):
            ray = PLANE.point + end - centre
            met.append(centre + ray * (PLANE.point[2] - centre[2]) / ray[2])
        sizes.append([met[1][0] - met[0][0], met[3][1] - met[2][1]])
    return np.array(sizes)


@pytest.mark.parametrize("angle", [-0.4, 0.15])
def test_the_solution_is_that_of_scipy(angle):
    rng = np.random.default_rng(3)
    sizes = covered(angle, 0.75, 0.75) * np.exp(rng.normal(0, 0.004, (len(CENTRES), 2)))
    sigmas = np.full(sizes.shape, 0.02)  # weights of the robust loss stay near one
    found = solve_facing(CENTRES, sizes, sigmas, angle_sigma=0.2, aspect=1.0)

    def residuals(x):
        gaps = (np.log(sizes) - np.log(covered(x[0], np.exp(x[1]), np.exp(x[2])))) / sigmas
        return np.array([*gaps.ravel(), x[0] / 0.2, (x[1] - x[2]) / 0.02])

    other = least_squares(residuals, [0.0, *np.log(sizes.mean(axis=0))])
    np.testing.assert_allclose([found.angle, *found.log_size], other.x, atol=2e-3)
    expected = np.linalg.inv(other.jac.T @ other.jac)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(expected), rtol=0.1)


def test_of_one_view_the_angle_is_that_of_the_prior_or_of_a_known_proportion():
    sizes, sigmas = covered(0.3, 0.6, 0.6)[:1], np.full((1, 2), 0.01)
    found = solve_facing(CENTRES[:1], sizes, sigmas, angle_sigma=0.14)
    assert found.angle == pytest.approx(0.0, abs=1e-6)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.14, rel=0.01)
    sizes, sigmas = covered(-0.2, 0.6, 0.6)[:1], np.full((1, 2), 1e-3)
    square = solve_facing(CENTRES[:1], sizes, sigmas, 1.0, aspect=1.0, aspect_sigma=1e-3)
    assert square.angle == pytest.approx(-0.2, abs=0.02)
