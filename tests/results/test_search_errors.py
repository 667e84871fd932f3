"""Why the error that a search estimated differs from the error on fresh draws."""

import math

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist.results.sets import cause_of_excess, largest_of

CHOSE = "its draws chose the set"
UNDERESTIMATES = "the search's filter underestimates its error"
ERRS_MORE = "the search's filter has a larger error than the job's"
UNEXPLAINED = "unexplained: {} standard errors; `pfdist verify` checks the files"
VARIANCE = {"particles": 100, "estimator": "filter_variance"}


@in_turn(
    ("estimated", "own", "cause"),
    [
        (4.7, VARIANCE, CHOSE),  # three standard errors: draws may do that
        (4.5, VARIANCE, UNDERESTIMATES),
        (4.5, {"particles": 100}, CHOSE),  # by the squared error no filter flatters itself
        (4.5, {}, CHOSE),  # 5 standard errors: the smallest of 1,000 may lie so low
        (4.4, {}, UNEXPLAINED.format("6.0")),
        (4.4, {"particles": 100}, UNEXPLAINED.format("6.0")),
        (5.5, {"particles": 100}, ERRS_MORE),
        (5.5, {}, UNEXPLAINED.format("5.0")),  # none is chosen for its large cost
        (5.39, {}, "within chance"),  # no choice explains it
    ],
)
def test_the_cause_of_a_wrong_estimate_is_the_filter_where_draws_do_not_explain_it(
    estimated: float, own: dict[str, object], cause: str
) -> None:
    result = {
        "search_mse": estimated,
        "search_standard_error": 0.06,
        "expected_mse": 5.0,
        "standard_error": 0.08,  # of the difference: 0.1
    }
    assert cause_of_excess(result, own, 1000) == cause


def test_the_smallest_of_many_evaluations_lies_below_the_limit_as_rarely_as_stated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pfdist.results.sets.CLEAR_ERRORS", 2.0)  # 2.3 %: often enough to count
    rare, count, trials = 0.02275, 50, 4000
    largest = np.random.default_rng(1).normal(size=(trials, count)).max(axis=1)
    share = np.mean(largest > largest_of(count))
    assert abs(share - rare) < 4 * math.sqrt(rare / trials)
    assert largest_of(1) == pytest.approx(2.0)


def test_an_estimate_without_standard_error_is_not_called_exact() -> None:
    """A search by particles may see the same error in all of its draws."""
    result = {"search_mse": 5.0, "search_standard_error": 0.0, "expected_mse": 5.0}
    assert cause_of_excess(result | {"standard_error": 0.08}, {}) == CHOSE
    assert cause_of_excess(result | {"standard_error": 0.0}, {}) == "exact"
