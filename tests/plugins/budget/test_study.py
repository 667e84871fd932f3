"""The study of several numbers: the sets that it names, finds and compares."""

import pytest

from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.common.streams import CHOOSING
from pfdist.plugins.budget.study import BudgetStudy
from pfdist.problem.sections import DEFAULT_METHOD

SETS: list[Times] = [tuple(range(number)) for number in (5, 2, 9, 3, 10, 4, 6, 11, 8, 7)]


@pytest.fixture
def study(small_job: Job) -> BudgetStudy:
    search = [{"method": DEFAULT_METHOD, "polish": False}]
    sections = {"search": search, "budget": {"least": 2, "most": 11}}
    job = small_job.with_changes(sections=sections)
    return BudgetStudy(job, job.problem.feasible)


def test_there_is_a_winner_under_each_name_that_a_search_has(study: BudgetStudy) -> None:
    winners = study.winners(DEFAULT_METHOD, SETS)
    assert list(winners) == study.names(DEFAULT_METHOD)
    assert set(winners.values()) <= set(SETS)
    assert study.winners(DEFAULT_METHOD, []) == {}


def test_references_and_found_sets_have_different_names(study: BudgetStudy) -> None:
    assert study.references
    assert not {*study.references} & {*study.names(DEFAULT_METHOD)}


def test_it_compares_sets_of_the_same_size(study: BudgetStudy) -> None:
    winners = study.winners(DEFAULT_METHOD, SETS)
    assert [len(times) for times in winners.values()] == list(range(2, 12))
    references = study.references.values()
    assert [len(times) for times in references] == [len(times) for times in winners.values()]
    assert next(iter(winners)) == f"{DEFAULT_METHOD}_02"


def test_the_draws_that_chose_a_number_do_not_prove_it(study: BudgetStudy) -> None:
    assert study.purpose not in {*CHOOSING, super(BudgetStudy, study).purpose}
