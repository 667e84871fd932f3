"""Which set a search returns after a race, and how its phases estimate."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.errors import PfdistWarning
from pfdist.filters.estimate import Evaluation
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.runner.search_phase import _uncontradicted

DRAWS = 400
PREFERRED, WINNER, THIRD = (0, 4), (1, 5), (2, 6)


def _raced(times: Times, mean: float, standard_error: float) -> Evaluation:
    """An evaluation whose difference to one of no spread has this mean and standard error."""
    noise = np.random.default_rng(1).normal(size=DRAWS)
    noise = (noise - noise.mean()) / np.std(noise, ddof=1)
    return Evaluation(times, 10.0 + mean + standard_error * np.sqrt(DRAWS) * noise)


@pytest.mark.parametrize(
    ("standard_errors", "first"),
    [(1.9, PREFERRED), (2.1, WINNER), (-1.0, PREFERRED), (0.0, PREFERRED)],
)
def test_the_searchs_best_set_wins_unless_the_race_contradicts_by_two_standard_errors(
    standard_errors: float, first: Times
) -> None:
    winner = _raced(WINNER, 0.0, 0.0)
    preferred, third = _raced(PREFERRED, 0.1 * standard_errors, 0.1), _raced(THIRD, 5.0, 0.1)
    order = sorted([winner, preferred, third], key=lambda evaluation: evaluation.expected_mse)
    found = _uncontradicted([PREFERRED, WINNER, THIRD], order)
    assert found[0].measurement_times == first
    # The others keep the order of the race.
    assert found[1:] == [evaluation for evaluation in order if evaluation is not found[0]]


def test_a_set_that_did_not_finish_the_race_leaves_its_place_to_the_next() -> None:
    """A set that a degenerate draw has killed is not among those that raced."""
    order = [_raced(THIRD, 0.0, 0.0), _raced(WINNER, 0.1, 0.1)]
    found = _uncontradicted([PREFERRED, WINNER, THIRD], order)
    assert [evaluation.measurement_times for evaluation in found] == [WINNER, THIRD]


def test_an_empty_race_has_no_winner() -> None:
    assert _uncontradicted([PREFERRED, WINNER], []) == []


def test_the_phases_of_a_search_take_these_estimators(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.searches._POLISH_DRAWS", 64)  # several sets are left to race
    changes = [f"search.{DEFAULT_METHOD}.evaluation.draws=100"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    rows = run.table("evaluations")
    taken = rows.groupby("phase")["estimator"].agg(set)
    assert taken[DEFAULT_METHOD] == {"filter_variance"}
    assert taken[f"{DEFAULT_METHOD}.polish"] == {"squared_error"}
    race = rows[rows["phase"] == f"{DEFAULT_METHOD}.shortlist"]
    assert set(race["estimator"]) == {"squared_error"}
    assert set(race["particles"]) == {small_job.filter.particles}
    # 3 polished, 1 of the search, the opponent, the linearized design:
    assert 2 <= race["measurement_times"].map(tuple).nunique() <= 6


def test_exchanges_that_take_too_long_are_left_out_and_a_line_says_so(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.search_phase.MOST_STEPS", 1.0)
    monkeypatch.setattr("pfdist.runner.search_phase._FEW_SETS", 0)
    line = "search relaxation: exchanges would take too long and are skipped"
    with pytest.warns(PfdistWarning, match=f"^{line}$"):  # where nobody receives lines
        run = pfdist.plan(small_job, tmp_path / "run", bound_draws=0, figures=False)
    assert f"{DEFAULT_METHOD}.polish" not in set(run.table("evaluations")["phase"])


@pytest.mark.parametrize(
    "criterion", ["expected_mse", pytest.param("worst_instant", marks=pytest.mark.slow)]
)
def test_a_default_search_that_was_cut_short_ends_with_the_same_bytes(
    small_job: Job, tmp_path: Path, cut_short: Callable[..., None], criterion: str
) -> None:
    changes = [f"search.{DEFAULT_METHOD}.evaluation.draws=100", "comparison.draws=20"]
    changes.append(f"problem.criterion={criterion}")
    options: dict[str, Any] = {"changes": changes, "bound_draws": 0, "figures": False}
    whole = pfdist.plan(small_job, tmp_path / "whole", **options)
    cut_short(f"{DEFAULT_METHOD}.polish", small_job, tmp_path / "run", **options)
    assert pfdist.open_run(tmp_path / "run").state == "searching"
    again = pfdist.plan(small_job, tmp_path / "run", **options)
    assert hashes(again.path) == hashes(whole.path)
    assert again.sets == whole.sets
