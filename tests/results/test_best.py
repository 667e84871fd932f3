"""The best set of a run."""

from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from oracles.listed import forget
from pfdist.common.rounding import with_error
from pfdist.errors import StoreError

SETS = "search=[]", "comparison.sets={early=[0, 1, 2, 3], late=[9, 10, 11, 12]}"


def test_the_best_set_has_the_least_mean_error_of_the_compared_draws(
    finished: Callable[..., Path],
) -> None:
    run = pfdist.open_run(finished("model.name=random_walk", *SETS))
    mse = run.table("comparison")[["mse_early", "mse_late", "mse_regular"]].mean()
    name = mse.idxmin().removeprefix("mse_")
    assert run.best.measurement_times == list(run.sets[name])
    assert run.best.expected_mse == pytest.approx(mse.min())
    assert len(repr(run.best)) < 140
    assert with_error(run.best.expected_mse, run.best.standard_error) in repr(run.best)


def test_a_run_without_a_comparison_has_no_best_set(small_run: pfdist.Run) -> None:
    forget(small_run.path, "comparison")
    with pytest.raises(StoreError, match="has compared no draws yet"):
        pfdist.open_run(small_run.path).best  # noqa: B018
