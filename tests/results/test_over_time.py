"""The error of each compared set over time, from sums over ranges of all draws."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.three_sensors import SYSTEMS
from pfdist.filters.kalman import expected_errors
from pfdist.filters.work import ranges_of_draws
from pfdist.results.moments import controlled_mse
from pfdist.results.over_time import (
    Range,
    joined_ranges,
    longest_range,
    read_ranges,
)
from pfdist.store.schema import KEYS

WALK = "model.name=random_walk"
WEIGHTS = "problem.instant_weights=[0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1, 0]"
NOMINAL = "scenarios.parameters=[{step_sd=0.5}, {step_sd=1.0}]", "scenarios.filter=nominal"


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (WEIGHTS, "comparison.control=true"),
        (WALK, *NOMINAL),
        pytest.param((WALK, "filter.engine=numpy", "comparison.draws=40"), marks=pytest.mark.slow),
        (WALK, "filter.engine=kalman", WEIGHTS),
    ],
    ids=["plain", "weights and control", "scenarios", "numpy", "exact"],
)
def test_its_mean_over_time_is_the_expected_mse(
    changes: tuple[str, ...], finished: Callable[..., Path]
) -> None:
    run = pfdist.open_run(finished(*changes))
    table, sets = run.table("error_over_time"), run.table("sets").set_index("name")
    means = (table["weight"] * table["error"]).groupby(table["name"]).mean()
    assert means.to_dict() == pytest.approx(sets["expected_mse"].to_dict(), rel=1e-12)
    for name, rows in table.groupby("name"):
        assert rows["t"][rows["measured"]].tolist() == [*run.sets[name]]
    exact = "filter.engine=kalman" in changes
    assert (table["draws"] == (0 if exact else run.draws_compared)).all()
    assert (table["standard_error"] == 0).all() == exact


def test_an_exact_engine_has_the_variances_of_the_kalman_filter(
    finished: Callable[..., Path],
) -> None:
    run = pfdist.open_run(finished(WALK, "filter.engine=kalman"))
    found = run.table("error_over_time").groupby("name")["error"]
    for name, times in run.sets.items():
        [expected] = expected_errors(pfdist.load_model("random_walk"), 12, [times])
        np.testing.assert_array_equal(found.get_group(name), expected)


def test_sensors_on_a_clock_have_times_of_the_clock(tmp_path: Path) -> None:
    problem = pfdist.Problem(
        SYSTEMS[0].as_model(),
        horizon=6,
        measurement_budget=2,
        particles=20,
        time_step=0.5,
        time_unit="h",
    )
    run = pfdist.compare(
        problem, times={"a": ["0 near", "1.5 far"], "b": ["1 near", "1 far"]},
        results=tmp_path / "run", draws=20, figures=False,
    )  # fmt: skip
    table, sets = run.table("error_over_time"), run.table("sets").set_index("name")
    measured = table[table["measured"]].groupby("name")["t"].agg(list)
    assert (measured["a"], measured["b"]) == ([0.0, 1.5], [1.0])
    assert table.attrs["time_unit"] == "h"
    means = table.groupby("name")["error"].mean().to_dict()
    assert means == pytest.approx(sets["expected_mse"].to_dict(), rel=1e-12)


def test_with_few_draws_its_standard_errors_are_those_of_means(small_job: Any) -> None:
    times = {"a": [0, 3, 6, 9], "b": [1, 2, 8, 12]}
    job = small_job.with_changes(["comparison.draws=30"])  # all ranges have one draw
    run = pfdist.compare(job, times=times, results=job.path.parent / "run", figures=False)
    rows = run.table("range_sums")
    assert (rows["draws"] == 1).all()
    per_draw = {name: np.stack([*of_set["sums"]]) for name, of_set in rows.groupby("name")}
    for name, of_set in run.table("error_over_time").groupby("name"):
        mse = controlled_mse(run.table("comparison"), str(name))
        np.testing.assert_allclose(per_draw[name].mean(axis=1), mse, rtol=1e-9)
        sem = pd.DataFrame(per_draw[name]).sem()
        np.testing.assert_allclose(of_set["standard_error"], sem, rtol=1e-9)


@pytest.mark.parametrize(("draws", "most"), [(1, 1), (63, 1), (64, 2), (4000, 64), (60_000, 1024)])
def test_there_are_at_least_32_ranges_and_hardly_more_than_64(draws: int, most: int) -> None:
    assert longest_range(draws) == most
    assert min(draws, 32) <= len(ranges_of_draws(0, draws, most)) <= 64 + np.log2(draws)


@pytest.mark.parametrize("seed", range(5))
def test_ranges_in_any_pieces_and_twice_are_joined_to_the_longest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cuts = [0, *np.sort(rng.choice(range(1, 200), 12, replace=False)).tolist(), 200]
    pieces = [*pairwise(cuts), (40, 130), (64, 96)]  # the last two come twice
    rows = [
        {"position": set_, "name": f"{set_}", "draw": first, "draws": draws,
         "sums": [float((1 + set_) * sum(range(first, first + draws)))]}
        for piece in pieces for first, draws in ranges_of_draws(*piece, 8) for set_ in (0, 1)
    ]  # fmt: skip
    rng.shuffle(rows)
    committed = pd.DataFrame(rows).drop_duplicates(KEYS["range_sums"])  # as a store gives them
    ranges = joined_ranges(read_ranges(committed), 32)
    assert [(each.first, each.draws) for each in ranges] == ranges_of_draws(0, 200, 32)
    for each in ranges:
        total = sum(range(each.first, each.end))
        assert each.sums.tolist() == [[total], [2 * total]]


def test_ranges_that_are_no_halves_of_one_are_not_joined() -> None:
    ranges = [Range(first, 2, np.ones((1, 1))) for first in (2, 4)]
    assert joined_ranges(ranges, 8) == ranges
