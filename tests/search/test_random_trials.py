"""Random trials keep the best of all they tried."""

import numpy as np

from pfdist.evaluation.estimate import Evaluation
from pfdist.search import RandomTrials
from pfdist.times.feasible import Feasible


def test_the_best_of_all_trials_is_kept_over_several_askings() -> None:
    trials, rng = RandomTrials(Feasible(30, 3), 600), np.random.default_rng(1)
    state, costs = trials.init(), []
    while not trials.done(state):
        asked = trials.ask(state, rng)
        told = [Evaluation(candidate.measurement_times, rng.random(1)) for candidate in asked]
        costs += [evaluation.cost for evaluation in told]
        state = trials.tell(state, told)
    assert len(costs) == 600
    assert [best.cost for best in trials.finalists(state)] == [min(costs)]


def test_a_killed_set_is_never_the_best_while_another_lives() -> None:
    trials = RandomTrials(Feasible(30, 3), 2)
    killed = Evaluation((1, 2, 3), np.array([np.nan]))
    alive = Evaluation((4, 5, 6), np.ones(1))
    assert trials.finalists(trials.tell(trials.init(), [killed, alive])) == [alive]
