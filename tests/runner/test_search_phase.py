"""Which set a search returns after a race, and what guides it where the filter is wrong."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.errors import TaskError
from pfdist.evaluation.estimate import Evaluation
from pfdist.evaluation.work import Estimation
from pfdist.runner.build import build
from pfdist.runner.door import Batch
from pfdist.runner.search_phase import _uncontradicted
from pfdist.search.methods import DEFAULT_METHOD
from pfdist.times.measurement_times import Times

DRAWS = 400
PREFERRED, WINNER, THIRD = (0, 4), (1, 5), (2, 6)
WRONG_FILTER = ["model.filter.parameters.process_sd=2"]


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
    order = sorted([winner, preferred, third], key=lambda evaluation: evaluation.cost)
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


def test_what_a_wrong_filter_believes_guides_the_search_and_decides_nothing(
    small_job: Job,
) -> None:
    job = small_job.with_changes(WRONG_FILTER, sections={"search": [{"method": DEFAULT_METHOD}]})
    (search,) = build(job).searches
    assert search.settings.estimation.estimator == "own_variance"
    particles = search.settings.estimation.particles
    assert search.polishing is not None
    assert search.polishing.estimation == Estimation(particles, "systematic", "squared_error")
    assert search.racing.estimation == Estimation(job.filter.particles, job.filter.resampling)
    assert search.again is not None
    assert all(
        settings.estimation.estimator == "squared_error" for settings in search.again.all_settings
    )


def test_a_filter_that_knows_the_truth_guides_and_polishes_by_its_variance(
    small_job: Job,
) -> None:
    job = small_job.with_changes(sections={"search": [{"method": DEFAULT_METHOD}]})
    (search,) = build(job).searches
    assert search.polishing is not None
    for settings in (search.settings, search.polishing):
        assert settings.estimation.estimator == "filter_variance"
    assert search.racing.estimation.estimator == "squared_error"


def test_the_phases_of_a_search_with_a_wrong_filter_take_these_estimators(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.search.trust.BELOW", 10.0)  # the probes fail on nothing
    monkeypatch.setattr("pfdist.runner.searches._POLISH_DRAWS", 64)  # several sets are left to race
    changes = [*WRONG_FILTER, f"search.{DEFAULT_METHOD}.evaluation.draws=100"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    rows = run.evaluations()
    taken = rows.groupby("phase")["estimator"].agg(set)
    assert taken[DEFAULT_METHOD] == {"own_variance"}
    assert taken[f"{DEFAULT_METHOD}.probe"] == {"own_variance", "squared_error"}
    assert taken[f"{DEFAULT_METHOD}.polish"] == {"squared_error"}
    race = rows[rows["phase"] == f"{DEFAULT_METHOD}.shortlist"]
    assert set(race["estimator"]) == {"squared_error"}
    assert set(race["particles"]) == {small_job.filter.particles}
    assert 2 <= race["measurement_times"].map(tuple).nunique() <= 4  # 3 polished, 1 of the search


@pytest.mark.parametrize("phase", ["", ".polish"])
def test_a_default_search_that_was_cut_short_ends_with_the_same_bytes(
    phase: str, small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draws = f"search.{DEFAULT_METHOD}.evaluation.draws=100"
    options: dict[str, Any] = {
        "changes": [draws, "comparison.draws=20"],
        "bound_draws": 0,
        "figures": False,
    }
    whole = pfdist.plan(small_job, tmp_path / "whole", **options)
    real, cut = Batch.take, f"{DEFAULT_METHOD}{phase}"

    def cut_short(self: Batch, *arguments: Any) -> None:
        real(self, *arguments)
        if self.phase == cut:
            raise TaskError("the lights went out", "")

    with monkeypatch.context() as patch:
        patch.setattr(Batch, "take", cut_short)
        with pytest.raises(TaskError, match="the lights went out"):
            pfdist.plan(small_job, tmp_path / "run", **options)
    assert pfdist.open_run(tmp_path / "run").state == "searching"
    again = pfdist.plan(small_job, tmp_path / "run", **options)
    assert hashes(again.path) == hashes(whole.path)
    assert again.sets() == whole.sets()
