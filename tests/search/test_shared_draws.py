"""Why the draws that choose windows must not give the bound: where they do, it is too high.

The error of an instant is 1 if a filter has measured at all good times so far, else 10. Draws add
noise to it. So the good set costs 1, every other set costs more, and the bound of any relaxation is
at most 1. But windows grow only until the bound has reached the cost of the good set. Chance alone
can end that, on the draws that it happens in.

`pytest -m statistics` runs these tests.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy import stats

from oracles.windows import Array, counted
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.search import Candidate, StateSpaceRelaxation
from pfdist.search.programme import Programme
from pfdist.search.relaxation import Relaxation, relaxation_with

pytestmark = pytest.mark.statistics

HORIZON, REPETITIONS, NOISE = 14, 200, 0.3
GOOD = (1, 3, 5, 7, 9, 11, 13)
BUDGET, TRUTH = len(GOOD), 1.0


@dataclass(frozen=True)
class Draws:
    """Mean errors over some draws. Filters that have measured alike have the same noise."""

    rng: np.random.Generator
    known: dict[Times, float] = field(default_factory=dict)

    def errors(self, times: Times) -> Array:
        """The error at each instant of a filter with these times."""
        beginnings = [tuple(time for time in times if time <= t) for t in range(HORIZON + 1)]
        return np.array([self._error(times, t) for t, times in enumerate(beginnings)])

    def _error(self, measured: Times, t: int) -> float:
        key = (t, *measured)
        if key not in self.known:
            good = {time for time in GOOD if time <= t}
            self.known[key] = (1.0 if good <= {*measured} else 10.0) + NOISE * self.rng.normal()
        return self.known[key]

    def told(self, candidate: Candidate) -> Evaluation:
        times, end, _, _, since = candidate
        last = HORIZON if end is None else end
        errors = self.errors(times)[since or 0 : last + 1]
        cost = errors.sum() / (HORIZON + 1)
        return Evaluation(times, np.array([cost]), end=end, errors=errors)

    def bound(self, relaxation: Relaxation) -> float:
        errors = np.array([self.errors(times) for times in relaxation.sets])
        return float(Programme(relaxation, counted(relaxation, errors), BUDGET).mse[BUDGET])


def _chosen(draws: Draws, paths: int) -> Relaxation:
    """The relaxation with the windows that some draws choose."""
    feasible = Feasible(HORIZON, BUDGET)
    start = relaxation_with(feasible, 1, HORIZON + 1)
    search = StateSpaceRelaxation(feasible, paths=paths, rounds=200, start=start)
    state, rng = search.init(), np.random.default_rng(0)
    while not search.done(state):
        state = search.tell(state, [draws.told(each) for each in search.ask(state, rng)])
    return state.relaxation


@pytest.mark.parametrize("paths", [1, 8])
def test_a_bound_on_the_draws_that_chose_its_windows_is_too_high(paths: int) -> None:
    same, fresh = list[float](), list[float]()
    for number in range(REPETITIONS):
        choice, proof = (Draws(np.random.default_rng([number, role])) for role in (1, 2))
        relaxation = _chosen(choice, paths)
        same.append(choice.bound(relaxation))
        fresh.append(proof.bound(relaxation))
    assert np.mean(same) > TRUTH + 4 * stats.sem(same)
    assert np.mean(fresh) <= TRUTH + 4 * stats.sem(fresh)
