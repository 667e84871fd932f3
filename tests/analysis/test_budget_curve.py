"""Which number of measurements reaches a target, and which is worse than fewer, by hand."""

import numpy as np
import pandas as pd
import pytest

from pfdist.analysis import ComparisonStatistics, reaching
from pfdist.analysis.budget_curve import budget_table

NOISE = np.tile([-1.0, 1.0], 200)  # of the draws, common to all sets; the mean's error is 0.05
COSTS = {
    "regular_2": 9.0,
    "regular_3": 7.0,
    "regular_4": 7.15,  # worse by 0.15, of which the draws that both share are sure
    "regular_5": 5.0,
    "survivors_2": 7.02,
    "survivors_3": 6.0,
    "survivors_4": 5.0,
    "survivors_5": 4.0,
}


def _table(mse: dict[str, np.ndarray]) -> pd.DataFrame:
    comparison = pd.DataFrame({f"mse_{name}": column for name, column in mse.items()})
    statistics = ComparisonStatistics(list(mse))
    statistics.add(comparison.to_numpy())
    compared = pd.DataFrame(
        [
            {
                "name": name,
                "measurement_times": np.arange(int(name.rpartition("_")[2])),
                "search_cost": 1.0,
                "search_standard_error": 0.1,
            }
            for name in mse
        ]
    )
    return budget_table(compared, statistics, [comparison[:130], comparison[130:]], "regular")


@pytest.fixture
def table() -> pd.DataFrame:
    return _table({name: cost + NOISE for name, cost in COSTS.items()})


def test_a_row_a_set_with_its_interval(table: pd.DataFrame) -> None:
    assert table["kind"].tolist() == ["regular"] * 4 + ["found"] * 4
    assert table["measurements"].tolist() == [2, 3, 4, 5] * 2
    assert table["expected_mse"].tolist() == pytest.approx(list(COSTS.values()))
    half = (table["high"] - table["low"]) / 2
    assert half.tolist() == pytest.approx([0.05 * 1.97] * 8, rel=0.01)


def test_that_more_are_worse_is_said_where_common_draws_are_sure(table: pd.DataFrame) -> None:
    worse = table.set_index("name")["worse_than"].dropna()
    assert worse.to_dict() == {"regular_4": 3}


def test_sets_that_are_all_alike_are_seldom_said_to_be_worse() -> None:
    # With 95 % for all differences together, in 5 of 100 tables at most, or by chance a few more.
    rng, tables = np.random.default_rng(1), 100
    said = 0
    for _ in range(tables):
        common = 3 * rng.normal(size=200)
        mse = {f"regular_{n}": common + rng.normal(size=200) for n in range(2, 12)}
        said += bool(_table(mse)["worse_than"].notna().any())
    assert said <= 0.05 * tables + 3 * np.sqrt(0.05 * 0.95 * tables)


def test_the_least_number_that_reaches_a_target(table: pd.DataFrame) -> None:
    found = reaching(table, 7.0)
    assert found["regular"] == {
        "measurements": 3,
        "interval": [3, 5],  # 7.0 may be 7.1
        "measurement_times": [0, 1, 2],
        "larger_that_do_not": [4],  # 7.15 is not 7.0
    }
    assert found["found"]["measurements"] == 3
    assert found["found"]["interval"] == [2, 3]  # 7.02 may be 7.0
    assert found["found"]["larger_that_do_not"] == []
    assert reaching(table, 7.1)["regular"]["larger_that_do_not"] == []  # 7.15 may be 7.1
    none = reaching(table, 3.0)["found"]
    assert (none["measurements"], none["interval"]) == (None, [None, None])
    assert none["larger_that_do_not"] == []
