"""Random trials, exhaustive and greedy searches, where the cost is a function of the times."""

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
from pfdist.search import Exhaustive, RandomTrials
from pfdist.search.base import FINALISTS

TRIALS = RandomTrials(Feasible(30, 3), 600)


def test_the_best_of_all_trials_is_kept_over_several_askings() -> None:
    costs: list[float] = []

    def cost(times: Times) -> float:
        costs.append(float(np.random.default_rng(times).random()))
        return costs[-1]

    (best,) = TRIALS.finalists(last(TRIALS, cost))
    assert (len(costs), best.expected_mse) == (600, min(costs))


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
