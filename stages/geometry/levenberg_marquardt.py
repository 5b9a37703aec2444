"""Levenberg-Marquardt minimisation: one driver for every robust least-squares fit (Nocedal and Wright, chapter 10.3).

The driver owns the damping, the acceptance of steps and the end. What is fitted comes as three functions, which work
on two objects: the problem (data, settings, equations) and the estimate (unknowns and their residuals).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from wayside.stages.kernels import compiled_within

Problem = TypeVar("Problem")
Estimate = TypeVar("Estimate")


class Schedule(NamedTuple):
    """When to stop, and how strongly steps are damped.

    `iterations`: at most this many linearisations. `gain`: stop when an accepted step lowers the cost by a smaller
    fraction. `damping`: at the start, relative to the diagonal of the normal equations. `least_damping`: its lower
    limit. `tries`: damping is multiplied by ten at most this often in one iteration.

    `iterations` and `gain` decide how near to the minimum a fit ends. The damping and the tries are numerical guards:
    they lead to the same minimum.
    """

    iterations: int
    gain: float
    damping: float = 1e-3
    least_damping: float = 1e-9
    tries: int = 8


def minimiser(
    evaluate: Callable[[Problem, Estimate], float],
    linearise: Callable[[Problem, Estimate, int], None],
    solve: Callable[[Problem, Estimate, float, Estimate], bool],
    *,
    plain: bool = False,
) -> Callable[[Problem, Estimate, Estimate, Schedule], tuple[Estimate, float, int]]:
    """Function that minimises a cost from a start.

    It takes the problem, the estimate to start from, a second estimate as scratch (both are overwritten) and the
    schedule. It returns the best estimate (one of the two it was given), its cost and the number of iterations. At the
    returned estimate no linearisation has been made: a caller that needs a covariance makes it.

    `evaluate`: fills the residuals of an estimate and returns its cost. `linearise`: fills the normal equations in the
    problem at an estimate; its last argument counts iterations from 0. `solve`: writes the unknowns after the damped
    step into its last argument; False where the equations cannot be solved. `plain`: these three and the result are
    plain Python on mutable objects; else kernels on named tuples of arrays.
    """

    def minimise(
        problem: Problem, estimate: Estimate, trial: Estimate, schedule: Schedule
    ) -> tuple[Estimate, float, int]:
        cost = evaluate(problem, estimate)
        damping, done = schedule.damping, 0
        # Numbers from a range have one type: a count that starts as the constant 0 compiles `linearise` twice.
        for iteration in range(schedule.iterations):
            linearise(problem, estimate, iteration)
            done = iteration + 1
            accepted, lowered = False, 0.0
            for _ in range(schedule.tries):
                if solve(problem, estimate, damping, trial):
                    reached = evaluate(problem, trial)
                    if reached <= cost:
                        accepted, lowered, cost = True, cost - reached, reached
                        break
                damping *= 10.0
            if not accepted:
                break
            estimate, trial = trial, estimate
            damping = max(schedule.least_damping, damping * 0.1)
            if lowered < schedule.gain * cost:
                break
        return estimate, cost, done

    return minimise if plain else compiled_within(minimise)
