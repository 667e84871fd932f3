"""Errors with a control variate: means are of mse - control, and single draws have the MSE."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from scipy import stats

import pfdist
from pfdist.questions.run_page import answer_of
from pfdist.results import stored_run
from pfdist.results.budget_curve import worse_than
from pfdist.results.columns import rows_of
from pfdist.results.moments import ComparisonStatistics, Gain, Moments, controlled_mse
from pfdist.results.pairs import pairs_table

NAMES = ["a", "b"]
RNG = np.random.default_rng(1)
CONTROL = RNG.normal(0.0, 1.0, (3000, 2))
VALUES = np.abs(RNG.normal([3.0, 2.5], 0.2, (3000, 2)))
MSE = VALUES + CONTROL + 5.0  # far above 0, so that relative gains are tame
VALUES = VALUES + 5.0
BLOCK = np.hstack([MSE, CONTROL])


def _statistics(*blocks: Any) -> ComparisonStatistics:
    statistics = ComparisonStatistics(NAMES)
    for block in blocks:
        statistics.add(block)
    return statistics


def test_moments_and_gains_of_means_are_those_of_errors_less_their_controls() -> None:
    found, plain = _statistics(BLOCK), _statistics(MSE)
    for name, values in zip(NAMES, VALUES.T, strict=True):
        assert found.mse[name].mean == pytest.approx(values.mean())
        assert found.mse[name].standard_error == pytest.approx(stats.sem(values))
        assert found.mse[name].standard_error < 0.5 * plain.mse[name].standard_error
    columns, single = found.gains["b"].columns(), plain.gains["b"].columns()
    a, b = VALUES.T
    assert columns["gain_of_means"] == pytest.approx(1 - b.mean() / a.mean())
    of_means = [name for name in columns if name.startswith("gain_of_means")]
    assert all(columns[name] != single[name] for name in of_means)
    others = columns.keys() - {*of_means, "gains_disagree"}
    assert {name: columns[name] for name in others} == {name: single[name] for name in others}


def test_blocks_change_nothing() -> None:
    whole, parts = _statistics(BLOCK), _statistics(BLOCK[:1000], BLOCK[1000:])
    for name in NAMES:
        assert parts.mse[name].mean == pytest.approx(whole.mse[name].mean)
    assert parts.gains["b"].of_means == pytest.approx(whole.gains["b"].of_means)


def test_pairs_have_the_differences_without_controls_and_the_wins_of_the_errors() -> None:
    found, plain, bare = (pairs_table(NAMES, [each], {}).iloc[0] for each in (BLOCK, MSE, VALUES))
    for name in ("difference", "low", "high", "simultaneous_low", "gain_of_means"):
        assert found[name] == pytest.approx(bare[name])
    assert found["first_wins"] == plain["first_wins"] != bare["first_wins"]


def test_a_number_of_measurements_is_worse_by_errors_less_their_controls() -> None:
    columns = {f"mse_{name}": each for name, each in zip(NAMES, MSE.T, strict=True)}
    columns |= {f"control_{name}": each for name, each in zip(NAMES, CONTROL.T, strict=True)}
    sets = {"name": NAMES, "kind": "found", "budget": [4, 3], "standard_error": 0.1}
    table = pd.DataFrame(sets | {"expected_mse": VALUES.mean(axis=0)})
    few = pa.table({name: values[:20] for name, values in columns.items()})
    assert worse_than(rows_of(table), [few]) == {"a": 3}
    assert worse_than(rows_of(table), [few.select(["mse_a", "mse_b"])]) == {}
    for rows in (few, few.to_pandas()):
        np.testing.assert_allclose(controlled_mse(rows, "a"), VALUES[:20, 0])


@pytest.mark.parametrize("draws", [100, 300])
def test_intervals_with_a_control_hold_as_often_as_without(draws: int) -> None:
    """One draw of 100 loses the state: rare, large errors, of which a control knows nothing.

    The control is the visible part of the error, a compound Poisson variable. It leaves the rare
    part, whose standard error few draws underestimate. The standard error of a share of 300
    intervals is below 0.03. Owen, "Monte Carlo theory, methods and examples", 2013, section 8.9.
    """
    rng, repeats, truth = np.random.default_rng(5), 300, 10.0 + 2.0 + 0.01 * 40.0
    size = repeats, draws
    visible = 10.0 * rng.standard_gamma(rng.poisson(1.0, size))
    lost = rng.random(size) < 0.01
    rest = 2.0 + rng.normal(0.0, 0.5, size) + lost * rng.exponential(40.0, size)
    holds = dict.fromkeys(("without", "of the rest alone", "with"), 0)
    for errors, control in zip(visible + rest, visible - 10.0, strict=True):
        plain, found = ComparisonStatistics(["a"]), ComparisonStatistics(["a"])
        plain.add(errors[:, None])
        found.add(np.stack([errors, control], axis=1))
        estimates = plain.estimate("a"), found.mse["a"].estimate, found.estimate("a")
        for name, (low, high) in zip(holds, (each.interval() for each in estimates), strict=True):
            holds[name] += low <= truth <= high
    assert holds["of the rest alone"] < holds["without"] - 3 * 0.03 * repeats
    assert holds["with"] >= holds["without"]


def test_a_control_keeps_its_worth_where_no_error_is_rare() -> None:
    """The largest of 3,000 errors adds (max - mean)^2 / D^2 to the variance: here 5 %."""
    found, plain = _statistics(BLOCK), _statistics(MSE)
    for name, errors, values in zip(NAMES, MSE.T, VALUES.T, strict=True):
        alone = (errors.max() - values.mean()) / len(errors)
        error = found.estimate(name).standard_error
        assert error == pytest.approx(math.hypot(stats.sem(values), alone))
        assert error < 0.35 * plain.estimate(name).standard_error
        assert plain.estimate(name) == plain.mse[name].estimate  # without a control


@pytest.mark.parametrize("shift", [[9.0, 0.0], [0.0, 9.0]], ids=["reference", "set"])
def test_no_gain_is_known_if_a_mean_is_not_above_0(shift: list[float]) -> None:
    """The control has the expectation 0, so there are too few draws."""
    block = np.hstack([MSE, CONTROL + shift])
    gain = _statistics(block).gains["b"]
    assert all(map(math.isnan, (gain.of_means, *gain.of_means_interval)))
    assert not math.isnan(gain.relative.mean)
    pair = pairs_table(NAMES, [block], {}).iloc[0]
    assert pair[["gain_of_means", "gain_of_means_low", "gain_of_means_high"]].isna().all()
    assert not math.isnan(pair["difference"])
    own = Gain.of_draws(-MSE[:, 0], MSE[:, 1])  # an error of a model may be negative
    assert own.of_means > 1


def test_a_line_says_that_there_are_too_few_draws_for_a_gain(
    finished: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = pfdist.open_run(finished("comparison.control=true"))
    errors_of = stored_run.errors_of

    def shifted(run: Any) -> Iterator[tuple[Any, ...]]:
        for errors, *others in errors_of(run):
            yield (errors + np.r_[np.zeros(3), np.full(3, 1000.0)], *others)

    assert " instead of " in str(answer_of(run))
    monkeypatch.setattr(stored_run, "errors_of", shifted)
    monkeypatch.setattr("pfdist.results.sets.summary_of", lambda run: None)
    text = " ".join(str(answer_of(run)).split())
    assert "The gain is not known" in text
    assert "regular: The mean of mse - control is not above 0" in text
    assert " instead of " not in text
    assert run.table("sets")["gain_of_means"].isna().all()
    assert Moments.of_values(MSE[:, 0]).mean > 0
