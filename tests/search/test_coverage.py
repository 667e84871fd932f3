"""The 95 % limit of a gap, over many repetitions of the whole proof.

The window is N + 1 and no gap is too long, so the bound is the optimum but for chance and the bias
of the particles. The true gap is known: from the Kalman filter, or from the grid filter's costs of
every set. `pytest -m statistics` repeats the proof 1,000 times.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.grid import grid_filter
from oracles.windows import counted
from pfdist import StateSpaceModel, linear_gaussian, load_model
from pfdist.common.measurement_times import Times
from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.kalman import expected_mse
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, FilterWork, with_truth
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.runner.block_sums import GROUPS
from pfdist.runner.gap_terms import parts_of
from pfdist.runner.proof import Sums, consistent, gap_of, prove
from pfdist.search.first_windows import relaxation_with
from pfdist.search.relaxation import Relaxation

REPETITIONS = 1000
BUDGET, IN_GROUP = 2, 8  # draws of a group
Array = NDArray[np.float64]
Record = Callable[[str, object], None]


@dataclass(frozen=True, eq=False)
class Case:
    """A small problem, and the settings with which its bias is below half a standard error."""

    model: StateSpaceModel
    horizon: int
    particles: int
    set_draws: int
    candidate: Times
    optimum: Callable[["Case"], float]

    @property
    def feasible(self) -> Feasible:
        return Feasible(self.horizon, BUDGET)

    @property
    def evaluator(self) -> Evaluator:
        return Evaluator(self.model, self.horizon)


def _by_kalman(case: Case) -> float:
    return float(expected_mse(case.model, case.horizon, list(case.feasible.every())).min())


def _by_grid(case: Case) -> float:
    """Least expected variance of the exact filter, on draws that did not choose the set."""
    few, many = (simulate(case.model, case.horizon, range(n), n) for n in (4000, 40_000))

    def cost(times: Times, draws: Draws) -> float:
        return float(grid_filter(case.model, draws, times, 300)[1].mean())

    return cost(min(case.feasible.every(), key=lambda times: cost(times, few)), many)


LINEAR = linear_gaussian(
    "linear",
    initial_noise=[[1.0]],
    transition=[[0.95]],
    process_noise=[[0.4]],
    measurement=[[1.0]],
    measurement_noise=[[0.8]],
    quantity_of_interest=[[1.0]],
)
CASES = {
    "linear-Gaussian": Case(LINEAR, 8, 200, 1000, (2, 7), _by_kalman),
    "nonlinear": Case(load_model("ungm"), 6, 300, 1000, (1, 5), _by_grid),
}


def _alone(
    case: Case,
    times: Times,
    draws: tuple[int, int],
    estimation: Estimation,
    streams: tuple[int, int] = (3, 4),
) -> Array:
    """Errors of a set; the streams are those of its filter and of the draws."""
    work = FilterWork((times,), (case.horizon,), streams[:1], streams[1], draws, estimation)
    return case.evaluator.filtered(work).mse[:, 0]


def _sums(case: Case, relaxation: Relaxation, known: Times, number: int) -> Sums:
    """Sums of groups of draws; each repetition has draws of its own."""
    first, sets = number * GROUPS * IN_GROUP, (*relaxation.sets, known)
    work = FilterWork(
        measurement_times=sets,
        ends=(*relaxation.ends.tolist(), case.horizon),
        filter_streams=(1,) * len(sets),
        draws_stream=2,
        draws=(0, 0),
        estimation=with_truth(case.particles),
    )
    blocks = [(first + group * IN_GROUP, first + (group + 1) * IN_GROUP) for group in range(GROUPS)]
    sums = np.stack([case.evaluator.sum_errors(replace(work, draws=draws)) for draws in blocks])
    relaxed, own = counted(relaxation, sums[:, :-1]), sums[:, -1:]
    return Sums(relaxed, own, np.full(GROUPS, float(IN_GROUP)))


@dataclass(frozen=True)
class Outcome:
    """Gaps of all repetitions, in the unit of the error; a limit is NaN without a bound."""

    gaps: Array
    limits: Array
    errors: Array
    truth: float

    @property
    def coverage(self) -> float:
        return float((self.limits >= self.truth).mean())


def _repeated(case: Case, relaxation: Relaxation, repetitions: int = REPETITIONS) -> Outcome:
    """Prove the gap of a set many times."""
    m, known, rows = case.set_draws, case.candidate, []
    by_error = Estimation(case.particles, "systematic")
    for number in range(repetitions):
        draws = number * m, (number + 1) * m
        squared = _alone(case, known, draws, by_error)
        variance = _alone(case, known, draws, with_truth(case.particles))
        whole = Moments()
        whole.add(squared)
        sums = _sums(case, relaxation, known, number)
        proof = prove(relaxation, sums, [known], BUDGET)
        alone = parts_of(whole, squared, squared, variance)
        gap = consistent({"set": gap_of("set", known, alone, proof, 0, 0.95)})["set"]
        total = proof.slack[0].plus(alone.both)
        rows.append((total.value, gap.gap_at_most * gap.expected_mse.value, total.standard_error))
    return Outcome(*np.array(rows).T, _true_cost(case, known) - case.optimum(case))


def _true_cost(case: Case, times: Times) -> float:
    """Expected MSE of a set with the particles of the case."""
    estimation = Estimation(case.particles, "systematic")
    return float(_alone(case, times, (0, 1_000_000), estimation, streams=(5, 6)).mean())


def _exact(case: Case) -> Relaxation:
    return relaxation_with(case.feasible, BUDGET + 1, case.horizon + 1)


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture(scope="module")
def outcome(case: Case) -> Outcome:
    return _repeated(case, _exact(case))


@pytest.mark.slow
def test_the_limit_hardly_ever_fails(case: Case) -> None:
    """60 repetitions: 0.85 is 3.5 standard errors below 0.95."""
    assert _repeated(case, _exact(case), 60).coverage >= 0.85


@pytest.mark.statistics
def test_the_limit_covers_the_gap_as_often_as_it_says(
    outcome: Outcome, record_property: Record
) -> None:
    record_property("coverage", float(outcome.coverage))
    assert 0.93 <= outcome.coverage <= 0.99


@pytest.mark.statistics
def test_the_mean_slack_is_at_most_three_standard_errors(
    outcome: Outcome, record_property: Record
) -> None:
    slack = np.nanmean(outcome.limits - outcome.truth) / outcome.errors.mean()
    record_property("slack", float(slack))
    assert 0.0 < slack <= 3.0


@pytest.mark.statistics
def test_the_jackknife_gives_the_scatter_of_the_gaps(
    outcome: Outcome, record_property: Record
) -> None:
    ratio = outcome.errors.mean() / outcome.gaps.std()
    record_property("error over scatter", float(ratio))
    assert 0.85 <= ratio <= 1.15
