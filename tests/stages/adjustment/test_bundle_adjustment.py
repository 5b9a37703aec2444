"""The window adjustment on exact scenes: against scipy, against finite differences, against simulated errors."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from wayside.schemas.motion import StepPrior
from wayside.stages.adjustment.bundle_adjustment import Window, adjust_window
from wayside.stages.adjustment.residuals import (
    QUADRATIC,
    PointAnchors,
    ResidualBlocks,
    StepConstraints,
    WindowEstimate,
    constraint_residuals,
    linearise_blocks,
)

FOCAL = 1400.0
TIE_PX, SIGHT_PX, LENGTH_M = 0.1, 0.3, 0.02
SIGN = np.array([3.5, -1.0, 16.0])  # in the last camera
TRAVEL = np.array([0.1, 0.02, 8.0])
AHEAD = np.array([0.01, 0.0, 1.0])


@dataclass(frozen=True)
class Scene:
    """True poses, points in the coordinates of their anchors, and what was measured of them."""

    rotations: np.ndarray
    centres: np.ndarray
    points: np.ndarray
    anchors: np.ndarray
    rows: ResidualBlocks
    links: StepConstraints

    @property
    def last(self):
        return len(self.rotations) - 1

    @property
    def place(self):
        return self.centres[-1] + self.rotations[-1] @ SIGN

    def solve(self, start=None, held=None, iterations=15):
        rotations, centres = (self.rotations, self.centres) if start is None else start
        held = self.last if held is None else held
        window = Window(rotations, centres, held, self.points, self.anchors)
        return adjust_window(window, self.rows, self.links, iterations=iterations, gain=1e-9)


def seen(rotation, centre, point):
    local = rotation.T @ (point - centre)
    return local[:2] / local[2], local[2]


def scene(frames=4, ties=60, seed=0, noise=1.0, aside_px=0.7, scales=(2.385, 3.0)):
    """A drive past one sign: `ties` tracks from each frame over one or two steps.

    Each step starts up to `aside_px` beside where the one before ended; noise: factor on all errors, seed: theirs.
    """
    world, rng = np.random.default_rng(0), np.random.default_rng(1000 + seed)
    rotations, centres = [np.eye(3)], [np.zeros(3)]
    for _ in range(1, frames):
        turn = Rotation.from_rotvec(np.array([0, 0.02, 0]) + world.normal(0, 0.003, 3)).as_matrix()
        centres.append(centres[-1] + rotations[-1] @ (TRAVEL + world.normal(0, 0.05, 3)))
        rotations.append(rotations[-1] @ turn)
    rotations, centres = np.array(rotations), np.array(centres)
    sign = centres[-1] + rotations[-1] @ SIGN
    numbers = np.arange(frames)
    rays = [seen(rotations[k], centres[k], sign)[0] for k in numbers]
    rays = rays + noise * rng.normal(0, SIGHT_PX / FOCAL, (frames, 2))
    points, anchors = [[*(SIGN[:2] / SIGN[2]), 1 / SIGN[2]]], [frames - 1]
    tied = []
    for first in range(frames - 1):
        for i in range(ties):
            depth = world.uniform(14, 70)
            local = depth * np.array([world.uniform(-0.5, 0.5), world.uniform(-0.3, 0.15), 1.0])
            point = centres[first] + rotations[first] @ local
            place = local[:2] / depth
            points.append([*place, 1 / depth])
            anchors.append(first)
            for k in range(first, min(first + 1 + i % 2, frames - 1)):
                before, z = seen(rotations[k], centres[k], point)
                now, nearer = seen(rotations[k + 1], centres[k + 1], point)
                if nearer < 4:
                    break
                growth = z / nearer
                error = noise * rng.normal(0, TIE_PX / FOCAL, 2)
                target = now + growth * (place - before) + error
                warp = growth, 0.0, growth
                tied.append(((k, k + 1), len(points) - 1, place, target, warp))
                place = now + world.uniform(-aside_px, aside_px, 2) / FOCAL
    points, anchors, m = np.array(points), np.array(anchors), len(tied)
    exact = np.full(frames, SIGHT_PX / FOCAL), np.full(len(points) - 1, 0.01 / FOCAL)
    sights = numbers, 0 * numbers, rays, exact[0], scales[0]
    corners = anchors[1:], np.arange(1, len(points)), points[1:, :2], exact[1], QUADRATIC
    errors = np.full(m, TIE_PX / FOCAL), np.full(m, scales[1])
    ties = *map(np.array, zip(*tied, strict=True)), *errors
    observed = [ResidualBlocks.observations(*one) for one in (sights, corners)]
    rows = ResidualBlocks.joined([*observed, ResidualBlocks(*ties)])
    lengths = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    lengths += noise * rng.normal(0, LENGTH_M, frames - 1)
    about = np.eye(3), np.inf, AHEAD, np.full(2, 0.01 if noise else 10.0), True
    links = StepConstraints.of([StepPrior(*about, length, LENGTH_M) for length in lengths])
    return Scene(rotations, centres, points, anchors, rows, links)


def shaken(one, held):
    """Poses off by so much, but for the held one."""
    rng = np.random.default_rng(1)
    rotations, centres = one.rotations.copy(), one.centres.copy()
    for k in range(len(rotations)):
        if k != held:
            rotations[k] = Rotation.from_rotvec(rng.normal(0, 0.002, 3)).as_matrix() @ rotations[k]
            centres[k] += rng.normal(0, 0.05, 3)
    return rotations, centres


def with_given_turns(links):
    """Steps whose rotation and direction between two poses are known, one of them."""
    given = Rotation.from_rotvec([0.01, 0.03, -0.02]).as_matrix()
    rotation, sigma = links.rotation.copy(), links.sigma_rotation.copy()
    rotation[0], sigma[0] = given, 0.002
    halfway = links.halfway.copy()
    halfway[1] = False
    return links._replace(rotation=rotation, sigma_rotation=sigma, halfway=halfway)


@pytest.mark.parametrize("scales", [(QUADRATIC, QUADRATIC), (2.385, 1.5)])
def test_the_minimum_is_the_one_that_scipy_finds(scales):
    one = scene(ties=10, seed=1, scales=scales)
    one = replace(one, links=with_given_turns(one.links))
    found = one.solve(shaken(one, one.last), iterations=40)
    charts = PointAnchors(one.rotations[one.anchors], one.centres[one.anchors])

    def residuals(unknowns):
        poses = unknowns[: 6 * one.last].reshape(-1, 6)
        turns = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ one.rotations[:-1]
        rotations = np.concatenate([turns, one.rotations[-1:]])
        centres = np.concatenate([one.centres[:-1] + poses[:, 3:], one.centres[-1:]])
        gaps, known = np.empty((len(one.rows.point), 2)), np.empty((one.last, 6))
        slopes = np.empty((len(gaps), 2, 12)), np.empty((len(gaps), 2, 3))
        points = one.points + unknowns[6 * one.last :].reshape(-1, 3) * [1e-3, 1e-3, 1e-3]
        estimate = WindowEstimate(rotations, centres, points, gaps, known, *slopes)
        linearise_blocks(estimate, charts, one.rows)
        constraint_residuals(rotations, centres, one.links, known)
        square, scale = (gaps**2).sum(axis=1), one.rows.scale
        flat = scale * np.sqrt(np.log1p(square / scale**2)) / np.sqrt(np.maximum(square, 1e-30))
        return np.concatenate([(gaps * flat[:, None]).ravel(), known.ravel()])

    start = np.zeros(6 * one.last + 3 * len(one.points))
    best = least_squares(residuals, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-12)
    assert found.cost == pytest.approx(2 * best.cost, rel=1e-6)
    poses = best.x[: 6 * one.last].reshape(-1, 6)
    np.testing.assert_allclose(found.centres[:-1], one.centres[:-1] + poses[:, 3:], atol=1e-4)
    if scales[0] == QUADRATIC:  # then the normal equations are scipy's own
        inverse = np.linalg.inv(best.jac.T @ best.jac)[6 * one.last :, 6 * one.last :][:3, :3]
        a, b, rho = found.points[0]
        ray = one.rotations[-1] @ [a, b, 1.0]
        spread = np.column_stack([one.rotations[-1][:, :2], -ray / rho]) / rho * 1e-3
        np.testing.assert_allclose(found.covariance, spread @ inverse @ spread.T, rtol=1e-3)


def test_the_held_frame_stays_and_the_others_do_not_care_which_it_is():
    one = scene(frames=5, seed=4, scales=(QUADRATIC, QUADRATIC))
    at_end, at_start = one.solve(iterations=40), one.solve(held=0, iterations=40)
    np.testing.assert_array_equal(at_end.rotations[-1], one.rotations[-1])
    np.testing.assert_array_equal(at_end.centres[-1], one.centres[-1])
    np.testing.assert_array_equal(at_start.centres[0], one.centres[0])
    assert at_start.cost == pytest.approx(at_end.cost, rel=1e-6)
    for found in (at_end, at_start):  # the sign as the last camera sees it
        local = (found.position - found.centres[-1]) @ found.rotations[-1]
        expected = (at_end.position - one.centres[-1]) @ one.rotations[-1]
        np.testing.assert_allclose(local, expected, atol=1e-4)


def test_the_gain_tells_how_an_error_of_a_row_moves_the_place():
    one = scene(ties=15, seed=7, scales=(QUADRATIC, QUADRATIC))
    found = one.solve(iterations=40)
    for row in (1, len(one.rows.point) - 1, len(one.rows.point) - 20):
        for axis in range(2):
            target = one.rows.target.copy()
            target[row, axis] += 0.02 / FOCAL
            moved = replace(one, rows=one.rows._replace(target=target)).solve(iterations=40)
            expected = found.gain[row, axis] * 0.02 / FOCAL
            np.testing.assert_allclose(moved.position - found.position, expected, atol=2e-6)


def test_a_step_that_starts_beside_the_end_of_the_one_before_follows_the_same_point():
    """Corners lie up to a pixel from where the step before ended; the map of the patch takes that along."""
    one = scene(noise=0.0, aside_px=1.0)
    found = one.solve()
    np.testing.assert_allclose(found.position, one.place, atol=1e-4)
    assert found.squares.max() < 1e-4
    # taken for the place itself, that pixel would be an error of many sigmas
    tie = (one.rows.frames[:, 0] != one.rows.frames[:, 1])[:, None]
    stiff = one.rows._replace(warp=np.where(tie, 0.0, one.rows.warp))
    assert replace(one, rows=stiff).solve().squares.max() > 4


def test_far_points_and_points_behind_a_camera_do_no_harm():
    one = scene(seed=10)
    points = one.points.copy()
    points[-1, 2], points[-2, 2] = 1e-7, 0.5  # as good as infinite, and passed on the way
    found = replace(one, points=points).solve()
    gap = found.position - one.place
    assert np.sqrt(gap @ np.linalg.solve(found.covariance, gap)) < 4


def test_what_would_be_read_beside_an_array_is_refused():
    one = scene(ties=3)
    frames = one.rows.frames.copy()
    frames[0, 1] = 9
    with pytest.raises(ValueError, match=r"frames: .* is outside 0 to 3"):
        replace(one, rows=one.rows._replace(frames=frames)).solve()
    with pytest.raises(ValueError, match="held"):
        one.solve(held=4)
    with pytest.raises(ValueError, match="sigma"):
        replace(one, rows=one.rows._replace(sigma=one.rows.sigma[1:])).solve()
