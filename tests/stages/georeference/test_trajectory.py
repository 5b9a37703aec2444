"""The smoothed path of whole made-up drives, whose truth is known, and against a dense solver that knows no bands."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.stages.georeference import AbsoluteMeasurements, RelativeMotionChain, smooth

LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
STEP_M, TURN_RAD, SIDE_RAD, LENGTH_M = 8.0, 5e-5, 3e-4, 0.02
NEW_SHARE, UP = 0.1, 1.6
FIRST_SIGMA_RAD = np.radians([5.0, 5.0, 180.0])


@dataclass
class Drive:
    """True poses, what was measured, and where an adjustment starts."""

    rotation: np.ndarray
    centre: np.ndarray
    chain: RelativeMotionChain
    measured: AbsoluteMeasurements
    start: tuple[np.ndarray, np.ndarray]

    def smooth(self, **changes):
        return smooth(self.chain, replace(self.measured, **changes), *self.start)

    def smooth_with(self, rows):
        """By what was measured in these frames alone."""
        position, sigma_m = self.measured.position[rows], self.measured.sigma_m[rows]
        return self.smooth(row=rows, position=position, sigma_m=sigma_m)


def winding(n, radius_m, swing):
    """Poses and times of a camera on a road over hills whose bends alternate, at a speed that swings by this share."""
    station = STEP_M * np.arange(n)
    heading = np.cumsum(np.sin(station / 150) * STEP_M / radius_m)
    centre = np.zeros((n, 3))
    centre[1:, :2] = np.cumsum(STEP_M * np.stack([np.cos(heading), np.sin(heading)], 1)[1:], axis=0)
    centre[:, 2] = 3 * np.sin(station / 200)
    rotation = Rotation.from_rotvec(np.outer(heading, [0, 0, 1])).as_matrix() @ LEVEL
    speed = 20.0 * (1 + swing * np.sin(station / 90))
    time_s = np.cumsum(2 * STEP_M / (speed[1:] + speed[:-1]))
    return rotation, centre, np.concatenate([[0.0], time_s])


def steps_of(rng, rotation, centre, time_s, free, noise):
    """The chain as a camera measures it; `free`: lengths are known as ratios only, to 1.5 permille."""
    n = len(centre)
    back = rotation[:-1].transpose(0, 2, 1)
    way = np.einsum("nij,nj->ni", back, np.diff(centre, axis=0))
    length = np.linalg.norm(way, axis=1)
    ahead = way / length[:, None]
    turn, step = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    slip = Rotation.from_rotvec(noise * rng.normal(0, TURN_RAD, (n - 1, 3))).as_matrix()
    turn[1:] = slip @ back @ rotation[1:]
    side = noise * rng.normal(0, SIDE_RAD, (n - 1, 3))
    beside = ahead + side - (side * ahead).sum(axis=1)[:, None] * ahead
    sigma_m = 0.1 if free else LENGTH_M
    step[1:] = beside * (length + noise * rng.normal(0, sigma_m, n - 1))[:, None]
    along = ahead[:, :, None] * ahead[:, None]
    covariance = np.tile(np.eye(6), (n, 1, 1))
    covariance[1:, :3, :3] = TURN_RAD**2 * np.eye(3)
    covariance[1:, 3:, 3:] = (SIDE_RAD * STEP_M) ** 2 * (np.eye(3) - along) + sigma_m**2 * along
    ratio = np.full((n, 2), np.nan)
    if free:
        ratio[2:, 0] = length[1:] / length[:-1] * np.exp(noise * rng.normal(0, 0.0015, n - 2))
        ratio[2:, 1] = 0.0
    return RelativeMotionChain(time_s, turn, step, covariance, (np.arange(n) > 0) & free, ratio)


def fading(rng, time_s, sigma, memory_s):
    """An error that fades: first-order Gauss-Markov (n, 3)."""
    keeps = np.exp(-np.diff(time_s, prepend=0.0) / memory_s)
    fresh = rng.normal(size=(len(time_s), 3)) * sigma
    error = [fresh[0]]
    for keep, new in zip(keeps[1:], fresh[1:], strict=True):
        error.append(keep * error[-1] + np.sqrt(1 - keep**2) * new)
    return np.array(error)


def drive_of(seed, n=300, *, radius_m=250.0, swing=0.0, free=False, time_offset_s=0.0, noise=1.0):
    rng = np.random.default_rng(seed)
    rotation, centre, time_s = winding(n, radius_m, swing)
    chain = steps_of(rng, rotation, centre, time_s, free, noise)
    sigma = np.array([1.0, 1.0, UP])
    late = np.stack([np.interp(time_s - time_offset_s, time_s, axis) for axis in centre.T], axis=1)
    place = late + noise * fading(rng, time_s, sigma, 60.0)
    place += noise * rng.normal(size=(n, 3)) * NEW_SHARE * sigma
    every = np.tile(sigma, (n, 1))
    others = 60.0, np.zeros(3), None, None, FIRST_SIGMA_RAD, np.radians(10.0)
    measured = AbsoluteMeasurements(np.arange(n), place, NEW_SHARE * every, every, *others)
    return Drive(rotation, centre, chain, measured, chained(chain, rotation[0], centre[0]))


def chained(chain, rotation, centre):
    """Poses of the chain alone, from a first one on."""
    rotations, centres = [rotation], [centre]
    for turn, step in zip(chain.rotation[1:], chain.translation[1:], strict=True):
        centres.append(centres[-1] + rotations[-1] @ step)
        rotations.append(rotations[-1] @ turn)
    return np.array(rotations), np.array(centres)


def sigmas(found):
    return np.sqrt(np.diagonal(found.covariance[:, :3, :3], axis1=1, axis2=2))


def way_between(centre):
    return np.linalg.norm(np.diff(centre, axis=0), axis=1)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("radius_m", [250.0, 1e9])
def test_without_noise_the_truth_comes_out(radius_m, free):
    drive = drive_of(0, 60, radius_m=radius_m, free=free, noise=0.0)
    found = drive.smooth()
    np.testing.assert_allclose(found.centre, drive.centre, atol=2e-3)
    np.testing.assert_allclose(found.rotation, drive.rotation, atol=1e-5)
    assert (found.outliers, found.time_offset_s) == (0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("radius_m", "free"), [(250.0, False), (1e9, True)])
def test_errors_are_bounded_by_those_of_the_fixes_and_stated(radius_m, free):
    pulls, stretches, errors = [], [], []
    for seed in range(60):
        drive = drive_of(seed, 110, radius_m=radius_m, free=free)
        found = drive.smooth()
        error, of_fix = found.centre - drive.centre, drive.measured.position - drive.centre
        errors.append([(error**2).mean(), (of_fix**2).mean()])
        # errors are alike over a minute: a few places of each drive tell all
        pulls.append((error / sigmas(found))[::50])
        true = way_between(drive.centre) / drive.chain.length[1:]
        stretches.append(
            (np.log(found.scale[1:] / true) / np.sqrt(found.covariance[1:, 6, 6]))[::50]
        )
    smoothed, fixes = np.mean(errors, axis=0)
    assert smoothed < fixes
    assert 0.60 < (np.abs(pulls) < 1).mean() < 0.76
    assert 0.92 < (np.abs(pulls) < 2).mean() < 0.98
    if free:
        assert 0.55 < (np.abs(stretches) < 1).mean() < 0.80


def dense_covariance(found):
    """Of all unknowns of all frames, by inversion of the whole normal matrix."""
    n = found.factor.shape[1]
    lower = np.zeros((n, n))
    for down, diagonal in enumerate(found.factor):
        lower[np.arange(down, n), np.arange(n - down)] = diagonal[: n - down]
    return np.linalg.inv(lower @ lower.T)


@pytest.mark.parametrize(("first", "last"), [(0, 29), (3, 4), (7, 20)])
@pytest.mark.parametrize("free", [False, True])
def test_the_variance_of_a_stretch_is_that_of_the_whole_covariance(first, last, free):
    found = drive_of(2, 30, free=free).smooth()
    covariance = dense_covariance(found)
    steps = np.diff(found.centre[first : last + 1], axis=0)
    gradient = np.zeros((30, 11))
    for row, step in enumerate(steps, first):
        gradient[row, :3] -= step / np.linalg.norm(step)
        gradient[row + 1, :3] += step / np.linalg.norm(step)
    wanted = gradient.ravel() @ covariance @ gradient.ravel()
    assert found.length_variance(first, last, level=False) == pytest.approx(wanted, rel=1e-6)


def test_a_lost_ratio_is_bridged_by_a_steady_speed():
    drive = drive_of(1, free=True)
    drive.chain.length_ratio[150] = np.nan
    found = drive.smooth()
    error = np.log(way_between(found.centre) / way_between(drive.centre))
    assert np.abs(error[149]) < 0.02
    assert found.covariance[150, 6, 6] < 0.02**2


@pytest.mark.parametrize("jump", [[15.0, -10.0, 5.0], [0.0, 40.0, 0.0]])
def test_a_jump_of_the_fixes_does_not_bend_the_path(jump):
    drive = drive_of(5)
    place = drive.measured.position.copy()
    place[100:130] += jump
    found = drive.smooth(position=place)
    assert np.abs(found.centre - drive.smooth().centre).max() < 0.7
    assert found.outliers == 30


def test_sigmas_grow_where_there_are_no_fixes():
    drive = drive_of(6)
    inside = drive.smooth_with(np.r_[0:60, 240:300])
    assert np.abs(inside.centre - drive.centre).max() < 4
    level = np.hypot(*sigmas(drive.smooth_with(np.arange(150)))[:, :2].T)
    assert level[-1] > 1.4 * level[140]
    assert (np.diff(level[150:]) > 0).all()


@pytest.mark.parametrize(("radius_m", "swing"), [(250.0, 0.0), (250.0, 0.3), (1e9, 0.3)])
@pytest.mark.parametrize("time_offset_s", [0.3, -0.2])
def test_a_time_offset_is_found_and_undone(radius_m, swing, time_offset_s):
    drive = drive_of(8, radius_m=radius_m, swing=swing, time_offset_s=time_offset_s)
    found = drive.smooth()
    assert found.time_offset_s == pytest.approx(time_offset_s, abs=4 * found.time_offset_sigma_s)
    assert np.abs(found.centre - drive.centre).mean() < 1.5


def test_no_time_offset_is_found_where_there_is_none():
    for seed in range(8):
        assert drive_of(seed, 150, swing=0.3).smooth().time_offset_s == 0.0


def test_a_time_offset_of_poses_is_found_by_rotations_alone():
    drive = drive_of(9, noise=0.2)
    offset, n = 0.15, len(drive.centre)
    time_s = drive.chain.time_s
    late = np.stack([np.interp(time_s - offset, time_s, axis) for axis in drive.centre.T], axis=1)
    vectors = Rotation.from_matrix(drive.rotation @ LEVEL.T).as_rotvec()
    turned = np.stack([np.interp(time_s - offset, time_s, axis) for axis in vectors.T], axis=1)
    turn = Rotation.from_rotvec(turned).as_matrix() @ LEVEL
    known = {"sigma_m": np.full((n, 3), 0.03), "correlated_sigma_m": np.zeros((n, 3))}
    known |= {"rotation": turn, "sigma_rad": np.full(n, 1e-3), "roll_sigma_rad": np.inf}
    found = drive.smooth(position=late, first_sigma_rad=np.full(3, 3.0), **known)
    assert found.time_offset_s == pytest.approx(offset, abs=0.01)
    assert np.abs(found.centre - drive.centre)[5:-5].max() < 0.1


def test_the_same_drive_gives_the_same_bits():
    one, two = (drive_of(10, 80, free=True).smooth() for _ in range(2))
    for name in ("rotation", "centre", "scale", "covariance", "weight"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


@pytest.mark.parametrize("free", [False, True])
def test_a_dense_solver_finds_the_same(free):
    drive = drive_of(12, 6, free=free, radius_m=60.0)
    found = drive.smooth()
    dense = by_dense_least_squares(drive)
    # a hundredth of what either is sure of
    np.testing.assert_allclose(found.centre, dense[0], atol=0.01)
    np.testing.assert_allclose(sigmas(found), dense[1], rtol=0.02)


def by_dense_least_squares(drive):
    """Centres and their sigmas (n, 3) by scipy over all unknowns at once, written from the model alone."""
    chain, measured, n = drive.chain, drive.measured, len(drive.centre)
    length = np.linalg.norm(chain.translation, axis=1)
    root = np.linalg.inv(np.linalg.cholesky(chain.step_covariance()))
    keeps = np.exp(-np.diff(chain.time_s) / measured.correlation_s)

    def loss(residual, freedom, reach):
        # Cauchy's loss as a residual whose square it is
        square, scale = max(residual @ residual, 1e-300), freedom * reach**2
        return residual * np.sqrt(scale * np.log1p(square / scale) / square)

    def residuals(x):
        move, turn, correlated = x[: 3 * n], x[3 * n : 6 * n], x[6 * n : 9 * n].reshape(n, 3)
        log_scale = x[9 * n :]
        centre = drive.start[1] + move.reshape(n, 3)
        rotation = Rotation.from_rotvec(turn.reshape(n, 3)).as_matrix() @ drive.start[0]
        parts = [correlated[0], turn[:3] / measured.first_sigma_rad]
        parts.append(rotation[:, 2, 0] / measured.roll_sigma_rad)
        parts.append(log_scale / np.where(chain.free_length, 0.3, 1e-4))
        antenna = centre + measured.correlated_sigma_m * correlated
        for k in range(n):
            away = measured.position[k] - antenna[k] - rotation[k] @ measured.lever_arm_m
            parts.append(loss(away / measured.sigma_m[k], 3, 3.0))
            if k == 0:
                continue
            fresh = np.sqrt(1 - keeps[k - 1] ** 2)
            parts.append((correlated[k] - keeps[k - 1] * correlated[k - 1]) / fresh)
            back = rotation[k - 1].T
            slip = Rotation.from_matrix(back @ rotation[k] @ chain.rotation[k].T).as_rotvec()
            gap = back @ (centre[k] - centre[k - 1]) - np.exp(log_scale[k]) * chain.translation[k]
            parts.append(loss(root[k] @ np.concatenate([slip, gap]), 6, 6.0))
            if k > 1 and chain.free_length[k]:
                change = log_scale[k] - log_scale[k - 1] + np.log(length[k] / length[k - 1])
                before, now = np.diff(chain.time_s)[k - 2 : k]
                stamps = 2e-3 * np.sqrt(now**-2 + before**-2 + 1 / (now * before))
                sigma = np.hypot(0.5 * (now + before) * now / length[k], stamps)
                ratio = (chain.length_ratio[k, 0], 0.0015), (now / before, sigma)
                parts += [loss(np.array([(change - np.log(r)) / s]), 1, 6.0) for r, s in ratio]
        return np.concatenate([np.atleast_1d(p) for p in parts])

    solved = least_squares(residuals, np.zeros(10 * n), x_scale="jac", xtol=1e-12, ftol=1e-12)
    spread = np.diag(np.linalg.inv(solved.jac.T @ solved.jac))[: 3 * n]
    return drive.start[1] + solved.x[: 3 * n].reshape(n, 3), np.sqrt(spread).reshape(n, 3)
