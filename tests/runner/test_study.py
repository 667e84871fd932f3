"""Studies: each names the sets that it compares, and finds a set for each of these names."""

import pytest

from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.common.streams import CHOOSING
from pfdist.plugins.budget.study import BudgetStudy
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.runner.study import Study

PLAN = {"search": [{"method": DEFAULT_METHOD, "polish": False}]}
BUDGET = PLAN | {"budget": {"least": 2, "most": 11}}
SETS: dict[str, list[Times]] = {
    "times": [(0, 3, 6, 9), (1, 2, 3, 4)],
    "budget": [tuple(range(number)) for number in (5, 2, 9, 3, 10, 4, 6, 11, 8, 7)],
}


def made(job: Job) -> Study:
    return (Study if job.budget is None else BudgetStudy)(job, job.problem.feasible)


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
    purposes = {
        made(small_job.with_changes(sections=sections)).purpose for sections in (PLAN, BUDGET)
    }
    assert len(purposes) == 2
    assert not purposes & {*CHOOSING}
