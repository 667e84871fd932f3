"""Which number of measurements reaches a target, which cannot, and which is worse, by hand."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.results import reaching
from pfdist.results.budget_curve import BOUND_DEGREES, add_bounds, worse_than
from pfdist.results.columns import rows_of
from pfdist.runner.block_sums import GROUPS
from pfdist.runner.proof import Gap, GapTerms, Proof, gap_of

NOISE = np.tile([-1.0, 1.0], 200)  # of the draws, common to all sets; the mean's error is 0.05
COSTS = {
    "regular_2": 9.0,
    "regular_3": 7.0,
    "regular_4": 7.15,  # worse by 0.15, of which the draws that both share are sure
    "regular_5": 5.0,
    "relaxation_2": 7.02,
    "relaxation_3": 6.0,
    "relaxation_4": 5.0,
    "relaxation_5": 4.0,
}


def _table(mse: dict[str, np.ndarray]) -> pd.DataFrame:
    comparison = pd.DataFrame({f"mse_{name}": column for name, column in mse.items()})
    rows = []
    for name, column in mse.items():
        mean, kind = Estimate.of_mean(column), name.rpartition("_")[0]
        low, high = mean.interval()
        row = {
            "name": name,
            "kind": "regular" if kind == "regular" else "found",
            "budget": int(name.rpartition("_")[2]),
            "measurement_times": [*range(int(name.rpartition("_")[2]))],
            "expected_mse": mean.value,
            "standard_error": mean.standard_error,
            "expected_mse_low": low,
            "expected_mse_high": high,
            "draws": column.size,
            "particle_loss": math.nan,  # as of an exact engine
            "particle_loss_limit": math.nan,
        }
        rows.append(row)
    table = pd.DataFrame(rows)
    worse = worse_than(rows_of(table), [comparison[:130], comparison[130:]])
    return table.assign(worse_than=[worse.get(name, math.nan) for name in mse])


def with_bounds(table: pd.DataFrame, proofs: dict[str, Any]) -> pd.DataFrame:
    rows, columns = rows_of(table), ("bound", "bound_error", "bound_low")
    for row in rows:
        row.add(dict.fromkeys(columns))
    gaps = dict.fromkeys(("gap", "gap_at_most"), math.nan)  # which no test here looks at
    add_bounds(rows, {name: gaps | proof for name, proof in proofs.items()})
    of_rows = {name: [getattr(row, name) for row in rows] for name in columns}
    return table.assign(**{name: pd.Series(each, dtype=float) for name, each in of_rows.items()})


@pytest.fixture
def table() -> pd.DataFrame:
    return with_bounds(_table({name: cost + NOISE for name, cost in COSTS.items()}), {})


def test_a_row_a_set_with_its_interval(table: pd.DataFrame) -> None:
    assert table["kind"].tolist() == ["regular"] * 4 + ["found"] * 4
    assert table["budget"].tolist() == [2, 3, 4, 5] * 2
    assert table["expected_mse"].tolist() == pytest.approx(list(COSTS.values()))
    half = (table["expected_mse_high"] - table["expected_mse_low"]) / 2
    assert half.tolist() == pytest.approx([0.05 * 1.97] * 8, rel=0.01)


def test_that_more_are_worse_is_said_where_common_draws_are_sure(table: pd.DataFrame) -> None:
    worse = table.set_index("name")["worse_than"].dropna()
    assert worse.to_dict() == {"regular_4": 3}


@pytest.mark.slow
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
        "with_more_particles": None,
    }
    assert found["found"]["measurements"] == 3
    assert found["found"]["interval"] == [2, 3]  # 7.02 may be 7.0
    assert found["found"]["larger_that_do_not"] == []
    assert reaching(table, 7.1)["regular"]["larger_that_do_not"] == []  # 7.15 may be 7.1
    none = reaching(table, 3.0)["found"]
    assert (none["measurements"], none["interval"]) == (None, [None, None])
    assert none["larger_that_do_not"] == []
    assert none["impossible"] is None  # nothing is proved


def _proof(bound: float, cost: float, errors: tuple[float, float, float]) -> Gap:
    """The gap of a set, with the errors of its parts."""
    relaxation, estimate, wrong = (Estimate((cost - bound) / 3, error) for error in errors)
    both = Estimate(2 * (cost - bound) / 3, math.hypot(errors[1], errors[2]))
    alone = GapTerms(Estimate(cost, 0.05), estimate, wrong, both)
    proof = Proof([Estimate(bound, 0.04)], [(0,)], [0], [relaxation])
    return gap_of("relaxation_2", (0,), alone, proof, 0, CONFIDENCE)


def _columns(gap: Gap) -> dict[str, Any]:
    return gap.columns() | {"particles": 100, "confidence": CONFIDENCE}


@pytest.mark.parametrize("wrong_model", [0.0, 0.02])  # changes nothing in the limit
def test_the_limit_of_a_bound_holds_for_all_numbers(
    table: pd.DataFrame, wrong_model: float
) -> None:
    proofs = {"relaxation_2": _columns(_proof(6.9, 7.02, (0.03, 0.02, wrong_model)))}
    rows = with_bounds(table, proofs).set_index("name")
    quantile = stats.t.isf(0.05 / 4, 19)  # 4 numbers of measurements, 20 groups of draws
    assert BOUND_DEGREES == GROUPS - 1 == 19
    row = rows.loc["relaxation_2"]
    assert (row["bound"], row["bound_error"]) == (6.9, 0.04)
    expected = 6.9 - quantile * 0.04
    assert row["bound_low"] == pytest.approx(expected, abs=1e-12)
    others = rows.drop("relaxation_2")
    assert others[["bound", "bound_error", "bound_low"]].isna().all(axis=None)


def test_limits_hold_together_as_often_as_they_say() -> None:
    """A budget curve has a bound for each number of measurements.

    The errors of a bound are those of 20 groups of draws, here of normal values.
    """
    names = [f"relaxation_{number}" for number in range(2, 6)]
    table = _table(dict.fromkeys(names, 7.0 + NOISE))
    groups = np.random.default_rng(1).normal(5.0, 1.0, (200, 4, GROUPS))
    errors = groups.std(axis=2, ddof=1) / math.sqrt(GROUPS)
    covered = 0
    for bounds in np.stack([groups.mean(axis=2), errors], axis=2):
        proofs = {
            name: _columns(_proof(6.0, 7.0, (0.1, 0.1, 0.1)))
            | {"bound": bound, "bound_error": error, "budget": 2 + number}
            for number, (name, (bound, error)) in enumerate(zip(names, bounds, strict=True))
        }
        covered += bool((with_bounds(table, proofs)["bound_low"] < 5.0).all())
    assert abs(covered / 200 - CONFIDENCE) < 4 * math.sqrt(0.95 * 0.05 / 200)


def test_an_exact_bound_is_a_limit_and_a_withdrawn_bound_is_none(table: pd.DataFrame) -> None:
    exact = {"bound": 5.9, "bound_error": 0.0, "particles": 0, "reason": "", "budget": 3}
    withdrawn = exact | {"reason": "the set costs less than the bound"}
    rows = with_bounds(table, {"relaxation_3": exact, "relaxation_4": withdrawn}).set_index("name")
    assert rows.loc["relaxation_3", ["bound", "bound_error", "bound_low"]].tolist() == [5.9, 0, 5.9]
    assert np.isnan(rows.loc["relaxation_4", "bound_low"])


@pytest.mark.parametrize(
    ("target", "least", "impossible"),
    [
        (7.0, 3, None),
        (6.1, 3, 2),
        (5.95, 4, 2),  # nobody knows whether other 3 times can
        (5.01, 5, 4),  # 4 times seem to reach it, but the proof says that they do not
        (0.5, None, 5),
    ],
)
def test_the_largest_number_that_cannot_reach_a_target_is_proved(
    table: pd.DataFrame, target: float, least: int | None, impossible: int | None
) -> None:
    bounds = {"relaxation_2": 6.9, "relaxation_3": 5.9, "relaxation_4": 5.02, "relaxation_5": 3.9}
    proofs = {
        name: {"bound": bound, "bound_error": 0.0, "particles": 0, "reason": "", "budget": 2}
        for name, bound in bounds.items()
    }
    reached = reaching(with_bounds(table, proofs), target)
    assert "impossible" not in reached["regular"]
    assert reached["found"]["measurements"] == least
    assert reached["found"]["impossible"] == impossible


def test_a_target_that_is_an_estimate_brings_its_error_into_the_proof() -> None:
    """If bound and target are equal, at most 5 % of the proofs may say that the bound is higher.

    The bound's error is that of 20 groups of draws, the target's is twice as large. Without it, the
    test would find a difference as often as a normal variate exceeds 1.73 / sqrt(5): 22 %.
    """
    table, rng, tries = _table({"relaxation_2": 9.0 + NOISE}), np.random.default_rng(1), 80
    groups = rng.normal(5.0, 1.0, (tries, GROUPS))
    errors = groups.std(axis=1, ddof=1) / math.sqrt(GROUPS)
    targets = rng.normal(5.0, 2 / math.sqrt(GROUPS), tries)
    wrong, without = 0, 0
    for bound, error, target in zip(groups.mean(axis=1), errors, targets, strict=True):
        columns = _columns(_proof(6.0, 7.0, (0.1, 0.1, 0.1)))
        proof = {"relaxation_2": columns | {"bound": bound, "bound_error": error}}
        bounded = with_bounds(table, proof)
        own = reaching(bounded, target, 2 / math.sqrt(GROUPS))["found"]
        wrong += own["impossible"] is not None
        without += reaching(bounded, target)["found"]["impossible"] is not None
    most = tries * 0.05 + 3 * math.sqrt(tries * 0.05 * 0.95)
    assert wrong <= most < without
    assert wrong > 0  # the test is not idle


@pytest.mark.parametrize(
    ("loss", "limit", "fewer"),
    [
        (0.15, 0.30, 3),  # 6 (1 - 0.30) = 4.2 may be enough, 7.02 (1 - 0.30) = 4.9 is not
        (0.15, 0.38, 2),
        (0.15, 0.10, None),  # 5 (1 - 0.10) = 4.5 is not enough
        (0.005, 0.045, None),  # small
        (math.nan, math.nan, None),  # unknown
    ],
)
def test_a_number_that_more_particles_may_make_enough(
    table: pd.DataFrame, loss: float, limit: float, fewer: int | None
) -> None:
    table = table.assign(particle_loss=loss, particle_loss_limit=limit)
    found = reaching(table, 4.4)["found"]
    assert (found["measurements"], found["with_more_particles"]) == (5, fewer)
    sure = {"bound": 6.5, "bound_error": 0.0, "particles": 0, "reason": "", "budget": 2}
    proved = reaching(with_bounds(table, {"relaxation_2": sure}), 4.4)["found"]
    assert proved["with_more_particles"] != 2  # no filter reaches it
