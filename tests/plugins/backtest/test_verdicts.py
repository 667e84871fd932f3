"""How often the verdicts of a backtest are right, at exact ratios of found and foreseen gain."""

import math

import numpy as np
import pytest

from pfdist.filters.simulation import simulate


def test_the_true_ratio_of_the_benchmark_is_that_of_many_draws() -> None:
    """Second moments, the linear filter and the draws agree, so that the ratios are exact."""
    from benchmarks import backtest  # no part of the package, so the wheel's tests have none

    model, cases = backtest.lake(), backtest.cases()
    y = simulate(model, backtest.HORIZON, range(6000), 3).y[:, :, 0]
    products, moments = y[:, :, None] * y[:, None, ::7], backtest.second_moments(model)
    error = products.std(axis=0, ddof=1) / np.sqrt(len(y))
    assert np.all(np.abs(products.mean(axis=0) - moments[:, ::7]) < 5 * error)
    for name, case in cases.items():
        true, found = backtest.mean_errors(case.moments), backtest.errors(case.measured(1000, 5))
        for times, each in found.items():
            error = each.std(ddof=1) / np.sqrt(each.size)
            assert abs(each.mean() - true[times]) < 4.5 * error, (name, times)
    ratios = {name: backtest.ratios(case) for name, case in cases.items()}
    assert ratios["right model"] == dict.fromkeys(backtest.GRIDS, 1.0)
    assert ratios["half of all errors"] == pytest.approx(dict.fromkeys(backtest.GRIDS, 0.5))
    for name in ("trend", "shift in the second half"):
        assert ratios[name]["centred"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.statistics
def test_at_a_true_ratio_of_a_half_a_verdict_is_seldom() -> None:
    """*Kept* and *not kept* each in at most 2.5 % of 200 repetitions, plus 3 standard errors."""
    from benchmarks import backtest  # no part of the package, so the wheel's tests have none

    cases, repeated = backtest.cases(), backtest.repeated
    foreseen = backtest.errors(cases["right model"].measured(400 * backtest.FORESEEN, 1))
    most = 0.025 + 3 * math.sqrt(0.025 * 0.975 / 200)
    for row in repeated(cases["half of all errors"], foreseen, (20, 50, 200), 200, 11):
        assert row["kept"] <= most, row
        assert row["not_kept"] <= most, row
    for row in repeated(cases["right model"], foreseen, (5, 20, 50, 200), 200, 12):
        assert row["wrong"] <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 200), row
        assert row["not_kept"] <= most, row
    *_, many = repeated(cases["shift in the second half"], foreseen, (400,), 200, 13)
    assert many["kept"] <= most
    assert many["not_kept"] > 0.5
