"""Random trials, exhaustive and greedy searches, where the cost is a function of the times."""

import math
from pathlib import Path

import numpy as np
import pytest

from oracles.searched import last
from pfdist import load_job
from pfdist.common.measurement_times import Times
from pfdist.errors import JobError
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.runner.build import build
from pfdist.search import Exhaustive, GreedyBackward, GreedyForward, RandomTrials
from pfdist.search.base import FINALISTS

FEASIBLE = Feasible(horizon=11, measurement_budget=4)
TRIALS = RandomTrials(Feasible(30, 3), 600)


def test_the_best_of_all_trials_is_kept_over_several_askings() -> None:
    costs: list[float] = []

    def cost(times: Times) -> float:
        costs.append(float(np.random.default_rng(times).random()))
        return costs[-1]

    (best,) = TRIALS.finalists(last(TRIALS, cost))
    assert (len(costs), best.cost) == (600, min(costs))


def test_a_killed_set_is_never_the_best_while_another_lives() -> None:
    killed, alive = Evaluation((1, 2, 3), np.array([np.nan])), Evaluation((4, 5, 6), np.ones(1))
    assert TRIALS.finalists(TRIALS.tell(TRIALS.init(), [killed, alive])) == (alive,)


def test_an_exhaustive_search_finds_what_brute_force_finds() -> None:
    feasible = Feasible(15, 4)
    costs = dict(zip(feasible.every(), np.random.default_rng(1).random(1820), strict=True))
    search = Exhaustive(feasible, limit=1820)
    found = search.finalists(last(search, costs.__getitem__))
    best = sorted(costs, key=lambda times: costs[times])[:FINALISTS]
    assert [evaluation.measurement_times for evaluation in found] == best
    assert search.generations == 4


def test_too_many_sets_are_refused(tmp_path: Path) -> None:
    text = "seed = 1\n[problem]\nhorizon = 60\nmeasurement_budget = 21\n"
    (tmp_path / "job.toml").write_text(text + '[[search]]\nmethod = "exhaustive"\nname = "mine"\n')
    words = r"search.mine: .* limit = 100,000 sets .*, got 12,176,31.* \(.*job.toml\)"
    with pytest.raises(JobError, match=words):
        build(load_job(tmp_path / "job.toml"))


@pytest.mark.parametrize("search", [GreedyForward(FEASIBLE), GreedyBackward(FEASIBLE)])
def test_of_times_that_each_have_their_own_share_greedy_searches_find_the_largest(
    search: GreedyForward | GreedyBackward,
) -> None:
    shares = np.random.default_rng(1).random(12)
    state = last(search, lambda times: float(shares.sum() - shares[list(times)].sum()))
    assert state.chosen == tuple(np.sort(np.argsort(shares)[-4:]))
    assert search.finalists(state)[0].measurement_times == state.chosen
    assert search.finalists(search.init()) == ()  # before the last step none may be chosen


def test_forward_saves_1_minus_1_over_e_of_what_can_be_saved_where_savings_overlap() -> None:
    """Nemhauser, Wolsey, Fisher 1978, for savings that are sizes of unions."""
    shares = []
    for seed in range(20):
        covers = np.random.default_rng(seed).random((12, 60)) < 0.15

        def saved(times: Times, covers: np.ndarray = covers) -> float:
            return float(covers[list(times)].any(axis=0).sum())

        state = last(GreedyForward(FEASIBLE), lambda times, saved=saved: -saved(times))
        shares.append(saved(state.chosen) / max(map(saved, FEASIBLE.every())))
    assert min(shares) >= 1 - 1 / math.e
    assert min(shares) < 1  # it is not always the best


def test_each_step_adds_or_leaves_out_one_time() -> None:
    forward, backward = (
        [each.measurement_times for each in search.ask(search.init(), np.random.default_rng(1))]
        for search in (GreedyForward(FEASIBLE), GreedyBackward(FEASIBLE))
    )
    assert forward == [(time,) for time in range(12)]
    assert {len(times) for times in backward} == {11}
