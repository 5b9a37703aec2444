"""The driver on a small problem of its own: a decaying exponential, fitted robustly, against scipy.

As plain Python, which needs no compilation; the fits of the stages run it compiled.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import least_squares

from wayside.stages.geometry.levenberg_marquardt import Schedule, minimiser
from wayside.stages.geometry.linear_algebra import cholesky_solve

TIME = np.linspace(0, 4, 30)
TRUE = np.array([2.0, 0.7])
SCALE = 3.0


class Problem(NamedTuple):
    value: np.ndarray
    sigma: float
    normal: np.ndarray
    right: np.ndarray
    step: np.ndarray
    linearised: np.ndarray


class Estimate(NamedTuple):
    unknowns: np.ndarray
    residuals: np.ndarray


def _evaluate(problem, estimate):
    total = 0.0
    for i in range(problem.value.shape[0]):
        model = estimate.unknowns[0] * np.exp(-estimate.unknowns[1] * 4.0 * i / 29)
        estimate.residuals[i] = (model - problem.value[i]) / problem.sigma
        total += SCALE**2 * np.log1p((estimate.residuals[i] / SCALE) ** 2)
    return total


def _linearise(problem, estimate, iteration):
    problem.linearised[0] = iteration
    problem.normal[:] = 0.0
    problem.right[:] = 0.0
    row = np.empty(2)
    for i in range(problem.value.shape[0]):
        time = 4.0 * i / 29
        row[0] = np.exp(-estimate.unknowns[1] * time) / problem.sigma
        row[1] = -estimate.unknowns[0] * time * row[0]
        weight = 1 / (1 + (estimate.residuals[i] / SCALE) ** 2)
        for k in range(2):
            problem.right[k] -= weight * row[k] * estimate.residuals[i]
            for m in range(2):
                problem.normal[k, m] += weight * row[k] * row[m]


def _solve(problem, estimate, damping, trial):
    damped = problem.normal.copy()
    for k in range(2):
        damped[k, k] *= 1 + damping
    problem.step[:] = problem.right
    solved = cholesky_solve(damped, problem.step)
    trial.unknowns[:] = estimate.unknowns + problem.step
    return solved


def _never(problem, estimate, damping, trial):
    return False


minimise, without_step = (
    minimiser(_evaluate, _linearise, solve, plain=True) for solve in (_solve, _never)
)


def fit(values, schedule, start=(0.5, 0.1), kernel=minimise):
    problem = Problem(values, 0.05, np.empty((2, 2)), np.empty(2), np.empty(2), np.full(1, -1.0))
    first, second = (Estimate(np.array(start), np.empty(30)) for _ in range(2))
    best, cost, done = kernel(problem, first, second, schedule)
    return best, cost, done, problem


def noisy(seed):
    values = TRUE[0] * np.exp(-TRUE[1] * TIME)
    values += np.random.default_rng(seed).normal(0, 0.05, 30)
    values[::9] += 1.0
    return values


@pytest.mark.parametrize("seed", range(4))
def test_the_minimum_is_that_of_scipy(seed):
    values = noisy(seed)
    best, cost, _, _ = fit(values, Schedule(100, gain=1e-14))

    def residuals(x):
        return (x[0] * np.exp(-x[1] * TIME) - values) / 0.05

    found = least_squares(residuals, best.unknowns, loss="cauchy", f_scale=SCALE, xtol=1e-14)
    np.testing.assert_allclose(best.unknowns, found.x, rtol=1e-5)
    assert cost == pytest.approx(2 * found.cost, rel=1e-9)
    np.testing.assert_allclose(best.residuals, residuals(best.unknowns), atol=1e-9)


def test_the_cost_never_rises_from_iteration_to_iteration():
    costs = [fit(noisy(5), Schedule(n, 1e-7))[1] for n in range(12)]
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.5 * costs[0]


def test_it_stops_at_the_limit_of_iterations_and_counts_them():
    _, _, done, problem = fit(noisy(6), Schedule(3, gain=0.0))
    assert done == 3
    assert problem.linearised[0] == 2


def test_it_stops_where_an_iteration_gains_too_little():
    values = noisy(7)
    assert fit(values, Schedule(100, gain=0.5))[2] < fit(values, Schedule(100, gain=1e-12))[2]


def test_equations_that_cannot_be_solved_leave_the_start():
    best, _, done, _ = fit(noisy(8), Schedule(50, 1e-7), kernel=without_step)
    np.testing.assert_array_equal(best.unknowns, [0.5, 0.1])
    assert done == 1
