"""The plain filter with a rule: each draw's set grows, and its filter runs again from the start."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters import plain
from pfdist.filters.draws import Draws
from pfdist.filters.work import Estimation
from pfdist.kernels.left import Left
from pfdist.kernels.rules import Applied, Thresholds


def filter_by_rule(
    model: StateSpaceModel, draws: Draws, candidates: Times, stream: int, settings: Estimation
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether each draw is measured at each point, and the MSE of each draw."""
    rule, follows, _ = settings.rule or Applied(Thresholds(()))
    fixed, end = replace(settings, rule=None), draws.instants.stop
    every = range(model.points.first(end))
    sets, errors = list[Times](), list[float]()
    for place in range(len(draws.index)):
        alone, times = draws[place : place + 1], Times()
        left = Left(follows, model.points.ways, candidates, end, rule.limit)
        for t in range(end):
            left.wait(t)
            arrived = tuple(p for p in times if model.points.instant(p) < t)
            given = model, alone, arrived, stream, replace(fixed, lag=0)
            deviation = np.sqrt(plain.filter_checked_draws(*given).variance[0, t].sum())
            times = tuple(sorted((*times, *rule.chosen(deviation, t, left))))
        sets.append(times)
        errors.append(plain.filter_checked_draws(model, alone, times, stream, fixed).mse[0])
    return np.array([np.isin(every, times) for times in sets]), np.array(errors)
