"""The driver on a small problem of its own: a decaying exponential, fitted robustly, against scipy."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from scipy.optimize import least_squares

from wayside.stages.geometry.levenberg_marquardt import Schedule, minimiser

TIME = np.linspace(0, 4, 30)
TRUE = np.array([2.0, 0.7])
SCALE = 3.0


@dataclass
class Problem:
    value: np.ndarray
    linearised: int = -1


@dataclass
class Estimate:
    unknowns: np.ndarray


def residuals(values, x):
    return (x[0] * np.exp(-x[1] * TIME) - values) / 0.05


def _evaluate(problem, estimate):
    squares = (residuals(problem.value, estimate.unknowns) / SCALE) ** 2
    return SCALE**2 * np.log1p(squares).sum()


def _linearise(problem, estimate, iteration):
    problem.linearised = iteration
    factor, rate = estimate.unknowns
    row = np.exp(-rate * TIME) / 0.05 * np.array([np.ones(30), -factor * TIME])
    gap = residuals(problem.value, estimate.unknowns)
    weighted = row / (1 + (gap / SCALE) ** 2)
    problem.normal, problem.right = weighted @ row.T, -weighted @ gap


def _solve(problem, estimate, damping, trial):
    damped = problem.normal + damping * np.diag(np.diag(problem.normal))
    trial.unknowns = estimate.unknowns + np.linalg.solve(damped, problem.right)
    return True


minimise, without_step = (
    minimiser(_evaluate, _linearise, solve, plain=True) for solve in (_solve, lambda *_: False)
)


def fit(values, schedule, start=(0.5, 0.1), kernel=minimise):
    problem = Problem(values)
    best, cost, done = kernel(problem, *(Estimate(np.array(start)) for _ in range(2)), schedule)
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
    gaps = partial(residuals, values)
    found = least_squares(gaps, best.unknowns, loss="cauchy", f_scale=SCALE, xtol=1e-14)
    np.testing.assert_allclose(best.unknowns, found.x, rtol=1e-5)
    assert cost == pytest.approx(2 * found.cost, rel=1e-9)


def test_the_cost_never_rises_from_iteration_to_iteration():
    costs = [fit(noisy(5), Schedule(n, 1e-7))[1] for n in range(12)]
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.5 * costs[0]


def test_it_stops_at_the_limit_of_iterations_and_counts_them():
    _, _, done, problem = fit(noisy(6), Schedule(3, gain=0.0))
    assert done == 3
    assert problem.linearised == 2


def test_it_stops_where_an_iteration_gains_too_little():
    values = noisy(7)
    assert fit(values, Schedule(100, gain=0.5))[2] < fit(values, Schedule(100, gain=1e-12))[2]


def test_equations_that_cannot_be_solved_leave_the_start():
    best, _, done, _ = fit(noisy(8), Schedule(50, 1e-7), kernel=without_step)
    np.testing.assert_array_equal(best.unknowns, [0.5, 0.1])
    assert done == 1
