"""The section [budget]: jobs that cannot have it, and a refusal that names it."""

import pytest

from pfdist import Job
from pfdist.errors import JobError

BUDGET = "budget={least=2, most=4}"
RELAXATION = "search=[{method='relaxation', polish=false}]"


@pytest.mark.plugins("online")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["online={}", RELAXATION, BUDGET], "budget needs a job without a section online"),
        ([BUDGET], r"needs one search of method 'relaxation', got genetic, random \("),
        (
            [RELAXATION, BUDGET, "comparison.reference=[0, 3]"],
            r"needs comparison\.reference = 'evenly spaced' or 'regular'",
        ),
        ([RELAXATION, "budget={least=2, most=14}"], "budget of 14 measurements: "),
        ([RELAXATION, "budget={least=3, most=2}"], "least must be at most budget.most = 2, got 3"),
    ],
)
def test_a_job_that_cannot_have_it_is_one_line(
    changes: list[str], message: str, small_job: Job
) -> None:
    with pytest.raises(JobError, match=message) as error:
        small_job.with_changes(changes)
    assert "\n" not in str(error.value)


def test_it_has_the_numbers_from_the_least_to_the_largest(small_job: Job) -> None:
    assert [*small_job.with_changes([RELAXATION, BUDGET]).amounts] == [2, 3, 4]
