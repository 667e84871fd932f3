"""Studies: each names the sets that it compares, and finds a set for each of these names."""

import pytest

from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.common.streams import CHOOSING
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.runner.study import Study

PLAN = {"search": [{"method": DEFAULT_METHOD, "polish": False}]}
SETS: list[Times] = [(0, 3, 6, 9), (1, 2, 3, 4)]


@pytest.fixture
def study(small_job: Job) -> Study:
    job = small_job.with_changes(sections=PLAN)
    return Study(job, job.problem.feasible)


def test_there_is_a_winner_under_each_name_that_a_search_has(study: Study) -> None:
    winners = study.winners(DEFAULT_METHOD, SETS)
    assert list(winners) == study.names(DEFAULT_METHOD)
    assert set(winners.values()) <= set(SETS)
    assert study.winners(DEFAULT_METHOD, []) == {}


def test_references_and_found_sets_have_different_names(study: Study) -> None:
    assert study.references
    assert not {*study.references} & {*study.names(DEFAULT_METHOD)}


def test_the_best_of_the_found_sets_wins_unless_it_is_alone_after_a_race(study: Study) -> None:
    best, other = SETS
    assert study.winners("genetic", [best, other]) == {"genetic": best}
    assert study.racing([best, other]) == (best, other)
    assert study.racing([best]) == ()


def test_the_draws_of_the_comparison_chose_nothing(study: Study) -> None:
    assert study.purpose not in CHOOSING
