"""The replicates of a backtest: noise of their own for each."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import pfdist
from pfdist.filters.simulation import simulate
from pfdist.plugins.backtest import thinned
from pfdist.pools.base import SerialPool
from pfdist.problem.problem import as_job
from pfdist.problem.replicates import Replicate
from pfdist.runner.build import build

HORIZON, SETS = 6, ((0, 2, 3, 5),)
COIN = replace(  # yes or no, so that ties are broken for half of the rank
    pfdist.load_model("random_walk"),
    name="coin",
    measurement=lambda x, t, v, p: (np.where(v[0] < 1 / (1 + np.exp(-x[0])), 1.0, 0.0),),
    log_likelihood=lambda y, x, t, p: -np.log1p(np.exp(np.where(y[0] > 0.5, -x[0], x[0]))),
    measurement_noise=("uniform",),
    linear_gaussian=False,
)


def surprises(y: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The p-values of the plan's measurements in each replicate, (R, 4)."""
    monkeypatch.setattr(thinned, "DRAWS", 4)
    problem = pfdist.Problem(COIN, horizon=HORIZON, measurement_budget=4, particles=100)
    built = build(as_job(problem, []))
    matched = []
    for number, own in enumerate(y):
        judged = own.copy()
        judged[[0, 2, 3, 5]] = np.nan
        replicate = Replicate(f"r{number}", built.job.problem.clock, own)
        matched.append(thinned.Matched(replicate, SETS, judged))
    with SerialPool() as pool:
        errors = thinned.judged_errors(built, matched, pool, lambda progress: None)
    return np.stack([each.surprises for each in errors])


def test_p_values_of_a_right_model_are_uniform_over_replicates(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A randomised p-value is uniform and independent of the earlier ones (Brockwell,
    "Universal residuals", Statistics & Probability Letters 77, 2007).

    So the share below 1 % is binomial, here at most 4 standard errors too large. With one key for
    all replicates, ties are broken at each instant as if there were one replicate.
    """
    found = surprises(simulate(COIN, HORIZON, range(40), 3).y, monkeypatch)
    for values in (*found.T, found.ravel()):
        assert stats.kstest(values, "uniform").pvalue > 0.001
    assert np.mean(found < 0.01) < 0.01 + 4 * np.sqrt(0.01 * 0.99 / found.size)
