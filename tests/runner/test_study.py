"""Studies: each names the sets that it compares, and finds a set for each of these names."""

from pathlib import Path

import pytest

import pfdist
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import JobError
from pfdist.evaluation.estimate import Purpose
from pfdist.runner.build import build
from pfdist.runner.study import BudgetStudy, Study, study_of
from pfdist.search import SearchOptimiser, StateSpaceRelaxation
from pfdist.search.methods import DEFAULT_METHOD, METHODS
from pfdist.search.section import SearchSection
from pfdist.times.measurement_times import Times

PLAN = {"search": [{"method": DEFAULT_METHOD, "polish": False}]}
BUDGET = PLAN | {"budget": {"least": 2, "most": 11}}
SETS: dict[str, list[Times]] = {
    "times": [(0, 3, 6, 9), (1, 2, 3, 4)],
    "budget": [tuple(range(number)) for number in (5, 2, 9, 3, 10, 4, 6, 11, 8, 7)],
}


def made(job: Job) -> Study:
    return study_of(job, job.problem.feasible)


@pytest.fixture(params=["times", "budget"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def study(kind: str, small_job: Job) -> Study:
    return made(small_job.with_changes(sections=PLAN if kind == "times" else BUDGET))


def test_there_is_a_winner_under_each_name_that_a_search_has(study: Study, kind: str) -> None:
    winners = study.winners(DEFAULT_METHOD, SETS[kind])
    assert list(winners) == study.names(DEFAULT_METHOD)
    assert set(winners.values()) <= set(SETS[kind])
    assert study.winners(DEFAULT_METHOD, []) == {}


def test_references_and_found_sets_have_different_names(study: Study) -> None:
    assert study.references
    assert not {*study.references} & {*study.names(DEFAULT_METHOD)}


def test_a_budget_study_compares_sets_of_the_same_size(small_job: Job) -> None:
    study = made(small_job.with_changes(sections=BUDGET))
    winners = study.winners(DEFAULT_METHOD, SETS["budget"])
    assert [len(times) for times in winners.values()] == list(range(2, 12))
    references = study.references.values()
    assert [len(times) for times in references] == [len(times) for times in winners.values()]
    assert next(iter(winners)) == f"{DEFAULT_METHOD}_02"


def test_the_best_of_the_found_sets_wins_unless_it_is_alone_after_a_race(small_job: Job) -> None:
    study = made(small_job)
    best, other = SETS["times"]
    assert study.winners("genetic", [best, other]) == {"genetic": best}
    assert study.racing([best, other]) == (best, other)
    assert study.racing([best]) == ()


def test_the_draws_that_chose_a_number_do_not_prove_it(small_job: Job) -> None:
    purposes: list[Purpose[pfdist.Evaluation]] = [
        made(small_job.with_changes(sections=sections)).purpose for sections in (PLAN, BUDGET)
    ]
    assert len({purpose.stream(1, "draws") for purpose in purposes}) == 2


@pytest.mark.parametrize("method", sorted({*METHODS} - {DEFAULT_METHOD}))
def test_a_budget_study_by_another_method_is_refused_when_it_is_built(
    method: str, small_job: Job
) -> None:
    """Not when it is read: a run of an older version may have it."""
    section = {"method": method, "polish": False}
    job = small_job.with_changes(sections=BUDGET | {"search": [section]})
    words = rf"budget needs a search of method '{DEFAULT_METHOD}', got '{method}' \(.*small.toml\)$"
    with pytest.raises(JobError, match=words) as error:
        build(job)
    assert "\n" not in str(error.value)


def test_a_run_of_a_budget_study_by_another_method_can_still_be_read(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Older versions had a survivor programme for all measurement budgets."""

    def optimiser(study: BudgetStudy, section: SearchSection, draws: int) -> SearchOptimiser:
        return StateSpaceRelaxation(study.widest, draws, sought=tuple(study.budgets))

    search = [{"method": "survivors", "polish": False, "evaluation": {"draws": 20}}]
    sections = BUDGET | {"search": search, "budget": {"least": 2, "most": 3}}
    job = small_job.with_changes(["comparison.draws=30"], sections=sections)
    with monkeypatch.context() as older:
        older.setattr(BudgetStudy, "optimiser", optimiser)
        path = pfdist.run(job, tmp_path / "run", figures=False).path
    run = pfdist.open_run(path)
    assert run.job["search"][0]["method"] == "survivors"
    found = {"survivors_02", "survivors_03"}
    assert found < set(run.sets())
    assert found < set(run.summary()["results"])
    assert found < set(run.budget()["name"])
    assert load_job(path / "job.toml").identity() == job.identity()
    assert main(["status", str(path)]) == 0
    with pytest.raises(JobError, match=f"budget needs a search of method '{DEFAULT_METHOD}'"):
        pfdist.bound(path, figures=False)
