"""Random trials keep the best of all they tried."""

import numpy as np

from pfdist.monte_carlo import Evaluation
from pfdist.search import RandomTrials


def test_the_best_of_all_trials_is_kept_over_several_askings() -> None:
    trials, rng = RandomTrials(30, 3, 600), np.random.default_rng(1)
    state, costs = trials.init(), []
    while not trials.done(state):
        rows = map(tuple, trials.ask(state, rng).tolist())
        told = [Evaluation(row, rng.random(1)) for row in rows]
        costs += [evaluation.cost for evaluation in told]
        state = trials.tell(state, told)
    assert len(costs) == 600
    assert trials.best(state).cost == min(costs)


def test_a_killed_set_is_never_the_best_while_another_lives() -> None:
    trials = RandomTrials(30, 3, 2)
    killed, alive = Evaluation((1, 2, 3), np.array([np.nan])), Evaluation((4, 5, 6), np.ones(1))
    assert trials.best(trials.tell(trials.init(), [killed, alive])) is alive
