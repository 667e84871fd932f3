"""What a summary says of a search's belief."""

import pytest

from pfdist.analysis.belief import cause_of_excess

CHOSE = "its draws chose the set"
UNDERESTIMATES = "the search's filter underestimates its error"
ERRS_MORE = "the search's filter errs more than the job's own"
VARIANCE = {"particles": 100, "estimator": "filter_variance"}


@pytest.mark.parametrize(
    ("believed", "own", "cause"),
    [
        (4.7, VARIANCE, CHOSE),  # three standard errors: draws may do that
        (4.5, VARIANCE, UNDERESTIMATES),
        (0.1, {"estimator": "two_filters"}, UNDERESTIMATES),
        (4.5, {"particles": 100}, CHOSE),  # by the squared error no filter flatters itself
        (4.5, {}, CHOSE),
        (5.5, {"particles": 100}, ERRS_MORE),
        (5.5, {}, CHOSE),
    ],
)
def test_the_cause_of_a_wrong_belief_is_the_filter_where_draws_do_not_explain_it(
    believed: float, own: dict[str, object], cause: str
) -> None:
    result = {
        "search_cost": believed,
        "search_standard_error": 0.06,
        "expected_mse": 5.0,
        "standard_error": 0.08,  # of the difference: 0.1
    }
    assert cause_of_excess(result, own) == cause
