"""Reasons for which an estimator is distrusted, and others for which it is not."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pfdist.common.clock import Clock
from pfdist.common.estimate import CLEAR_ERRORS
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.search import Candidate
from pfdist.search.probe import (
    BELOW,
    PROBE_DRAWS,
    Probe,
    ProbeState,
    failed_probe,
    judged,
    misordered,
    new_leaders,
)

Array = NDArray[np.float64]
FEASIBLE = Feasible(horizon=12, measurement_budget=3)
SET = (1, 2, 3)


def _with_moments(mean: float, standard_error: float, draws: int = PROBE_DRAWS) -> Array:
    """Values of exactly this mean and standard error."""
    values = np.random.default_rng(1).normal(size=draws)
    values -= values.mean()
    return mean + values * standard_error * math.sqrt(draws) / np.std(values, ddof=1)


def _pair(estimate: Array, error: Array) -> tuple[Evaluation, Evaluation]:
    return Evaluation(SET, estimate), Evaluation(SET, error)


@pytest.mark.parametrize(
    ("estimate", "standard_error", "fails"),
    [
        (1.0 - BELOW - 0.01, 0.01, True),
        (1.0 - BELOW + 0.01, 0.001, False),  # far more than 4 standard errors, and not 15 %
        (0.5, 0.5 / (CLEAR_ERRORS + 0.1), True),
        (0.5, 0.5 / (CLEAR_ERRORS - 0.1), False),  # a half, and not 4 standard errors
        (2.0, 0.01, False),  # too large is another matter: no search seeks that
    ],
)
def test_an_estimator_fails_that_lies_far_below_both_in_share_and_in_standard_errors(
    estimate: float, standard_error: float, fails: bool
) -> None:
    error = _with_moments(1.0, standard_error)
    assert judged(*_pair(np.full(PROBE_DRAWS, estimate), error)).fails == fails


def test_draws_in_which_a_filter_became_infinite_say_nothing() -> None:
    error, estimate = _with_moments(1.0, 0.01), np.full(PROBE_DRAWS, 0.5)
    error[:-1], estimate[-1] = np.inf, 0.0
    assert not judged(*_pair(estimate, error)).fails
    error, estimate = _with_moments(1.0, 0.01), np.full(PROBE_DRAWS, 0.5)
    error[::2] = np.inf
    assert judged(*_pair(estimate, error)).fails


@pytest.mark.parametrize(("estimate", "fails"), [(0.5, True), (0.59, False)])
def test_only_sets_near_the_best_are_judged(estimate: float, fails: bool) -> None:
    """The estimate of regular times, and its error, is 0.5; that of another set is too small."""
    regular = FEASIBLE.regular()
    state, _ = _probe(
        lambda candidate: 0.5 if candidate.measurement_times == regular else estimate,
        lambda candidate: _with_moments(
            0.5 if candidate.measurement_times == regular else 1.0, 0.001
        ),
    )
    assert bool(state.failed and state.failed[0].end is None) == fails


def test_an_estimator_fails_that_reverses_the_order_of_two_sets() -> None:
    """All estimates are large enough; that of regular times, which are the best, is the largest."""
    regular = FEASIBLE.regular()
    state, _ = _probe(
        lambda candidate: 1.05 if candidate.measurement_times == regular else 1.0,
        lambda candidate: _with_moments(
            0.9 if candidate.measurement_times == regular else 1.0, 0.001
        ),
    )
    better, _ = state.failed
    assert better.measurement_times == regular
    assert "it prefers" in failed_probe(*state.failed, clock=Clock.counting(12))


def test_sets_are_written_with_their_times_on_the_clock_and_their_sensors() -> None:
    """A set has numbers of possible measurements, t * S + sensor, which nobody has written."""
    clock = Clock((0, 0.5, 1, 1.5), "d", sensors=("probe", "core"))
    pair = tuple(Evaluation((0, 2, 7), values, end=3) for values in (np.ones(4), np.ones(4) + 1))
    assert "gives 1 for {0 probe, 0.5 probe, 1.5 core} up to t = 1.5 d, " in failed_probe(
        *pair, clock=clock
    )
    other = Evaluation((1,), np.zeros(4))
    text = failed_probe(other, pair[0], clock=clock)
    assert text.startswith("it prefers {0 probe, 0.5 probe, 1.5 core} to {0 core}, ")


def _probe(
    estimate: Callable[[Candidate], float], error: Callable[[Candidate], Array]
) -> tuple[ProbeState, list[list[Candidate]]]:
    """Run the probes to their end; give the last state, and what was asked for round by round."""
    probe = Probe(FEASIBLE, (Candidate((2,), 2), Candidate((4, 5, 6))))
    state, rounds = probe.init(), []
    while not probe.done(state):
        asked = probe.ask(state, np.random.default_rng(1))
        rounds.append(asked)
        state = probe.tell(
            state,
            [
                Evaluation(
                    candidate.measurement_times,
                    error(candidate)[: candidate.draws]
                    if candidate.squared
                    else np.full(candidate.draws or 0, estimate(candidate)),
                    end=candidate.end,
                )
                for candidate in asked
            ],
        )
    return state, rounds


def test_probes_are_the_regular_times_a_few_random_sets_and_what_led_the_search() -> None:
    state, rounds = _probe(lambda candidate: 1.0, lambda candidate: _with_moments(1.0, 0.01))
    (asked,) = rounds  # all are as good as they say: one round decides
    assert not state.failed
    sets = list(dict.fromkeys((candidate.measurement_times, candidate.end) for candidate in asked))
    assert sets[0] == (FEASIBLE.regular(), None)
    assert all(FEASIBLE.accepts(times) and end is None for times, end in sets[1:4])
    assert sets[4:] == [((2,), 2), ((4, 5, 6), None)]  # a prefix up to its end
    assert {candidate.draws for candidate in asked} == {PROBE_DRAWS}
    for candidate in asked:  # each by the estimator, and by the squared error, on the same draws
        assert candidate._replace(squared=not candidate.squared) in asked


@pytest.mark.parametrize("sought", [Candidate((2,), 2), Candidate((4, 5, 6))])
def test_an_estimator_that_fails_on_what_led_the_search_alone_has_failed(sought: Candidate) -> None:
    def estimate(candidate: Candidate) -> float:
        return 0.2 if candidate.measurement_times == sought.measurement_times else 1.0

    state, _ = _probe(estimate, lambda candidate: _with_moments(1.0, 0.01))
    assert [evaluation.measurement_times for evaluation in state.failed] == 2 * [
        sought.measurement_times
    ]
    assert [evaluation.expected_mse for evaluation in state.failed] == pytest.approx([0.2, 1.0])


def test_draws_are_doubled_where_the_decision_is_open() -> None:
    rng = np.random.default_rng(2)
    errors = rng.normal(1.0, 12.0, 100_000)  # a standard error of a half at first
    state, rounds = _probe(
        lambda candidate: 0.2 if candidate.end else 1.0,
        lambda candidate: errors if candidate.end else np.ones(100_000),
    )
    draws = [asked[0].draws for asked in rounds]
    assert draws == [PROBE_DRAWS * 2**k for k in range(len(draws))]
    assert len(draws) > 1
    assert [len(asked) for asked in rounds[1:]] == [2] * (len(rounds) - 1)  # that probe alone
    assert state.failed[0].draws == draws[-1]


def test_what_cannot_be_decided_comes_to_an_end() -> None:
    errors = np.random.default_rng(3).normal(1.0, 1e3, 100_000)
    state, rounds = _probe(lambda candidate: 1.0, lambda candidate: errors)
    assert not state.failed
    probes = [len(asked) // 2 for asked in rounds]
    assert probes == [6, 3, 2, 1, 1]


def _leader(times: Times, cost: float, end: int | None = None) -> Evaluation:
    return Evaluation(times, np.full(2, cost), end=end)


def test_the_leader_of_a_generation_is_the_best_of_its_kind_so_far() -> None:
    before = [_leader((1, 2), 5.0), _leader((1,), 2.0, end=1)]
    better, worse = _leader((1, 3), 4.0), _leader((2, 3), 6.0)
    longer = _leader((1, 2, 3), 4.5)
    late, soon = _leader((9,), 5.0, end=9), _leader((3,), 4.1, end=3)  # a half, and 1, an instant
    dead = Evaluation((1, 2, 4), np.array([1.0, np.nan]))
    assert new_leaders([worse, better, longer, soon, late, dead], before) == [better, longer, late]


def _misordered(
    believed: dict[Times, Array], squared: dict[Times, Array]
) -> tuple[Evaluation, Evaluation] | None:
    return misordered(
        {times: Evaluation(times, mse) for times, mse in believed.items()},
        [Evaluation(times, mse) for times, mse in squared.items()],
    )


A, B = (1, 2, 3), (4, 5, 6)


@pytest.mark.parametrize(
    ("real", "errors", "seen", "seen_errors", "contradicts"),
    [
        (1.0, 0.2, -0.5, 0.01, True),
        (1.0, 0.2, 0.01, 0.001, False),  # the same order
        (1.0, 0.3, -0.5, 0.01, False),  # the squared error does not tell them apart
        (1.0, 0.2, -0.1, 0.3, False),  # the estimator has hardly an opinion
        (-1.0, 0.2, 0.5, 0.01, True),
    ],
)
def test_an_estimator_is_distrusted_that_changes_the_order_of_two_finalists(
    real: float, errors: float, seen: float, seen_errors: float, contradicts: bool
) -> None:
    """Where the squared error tells them apart, and chance explains the other order badly."""
    common = np.random.default_rng(4).normal(10.0, 5.0, 400)
    squared = {A: common, B: common + _with_moments(real, errors, 400)}
    believed = {A: common[::-1], B: common[::-1] + _with_moments(seen, seen_errors, 400)}
    wrong = _misordered(believed, squared)
    assert (wrong is not None) == contradicts
    if wrong is not None:
        assert wrong[0].expected_mse < wrong[1].expected_mse


def test_a_set_with_an_infinite_error_contradicts_nobody() -> None:
    squared = {A: np.array([1.0, np.inf, 1.0]), B: np.array([2.0, 2.0, 2.5])}
    believed = {A: np.array([1.0, 1.0, 1.1]), B: np.array([3.0, 3.0, 3.1])}
    assert _misordered(believed, squared) is None
