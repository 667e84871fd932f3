"""Random times within sampling windows, and the loss of all of them together."""

from collections import Counter
from itertools import product
from typing import Any

import numpy as np
import pytest

from oracles.answered import answered
from pfdist import Job
from pfdist.filters import kalman
from pfdist.problem.feasible import Feasible
from pfdist.questions import sampling_windows as module
from pfdist.questions.sampling_windows import jitter, jittered
from pfdist.runner.build import build

KALMAN = ["model.name=random_walk", "filter.engine=kalman"]
COMPILED = ["model.name=random_walk", "filter.engine=compiled"]
TIMES = (2, 5, 9)
WINDOWS = ((1, 2, 3, 4), (4, 5, 6), (9,))


def _allows(feasible: Feasible, times: tuple[int, ...]) -> bool:
    return len({*times}) == len(times) and feasible.allows(times)


def test_all_feasible_times_within_the_windows_have_the_same_probability() -> None:
    feasible, draws = Feasible(horizon=12, measurement_budget=3, minimum_spacing=2), 6000
    found = Counter(jittered(TIMES, WINDOWS, feasible, "key", draw) for draw in range(draws))
    possible = {times for times in product(*WINDOWS) if _allows(feasible, times)}
    assert found.keys() == possible
    each = draws / len(possible)
    assert max(abs(count - each) for count in found.values()) < 4.5 * np.sqrt(each)


def test_random_times_are_a_function_of_the_key() -> None:
    feasible = Feasible(horizon=12, measurement_budget=3)
    first = [jittered(TIMES, WINDOWS, feasible, 7, draw) for draw in range(20)]
    backward = [jittered(TIMES, WINDOWS, feasible, 7, draw) for draw in reversed(range(20))]
    assert first == backward[::-1]
    assert len(set(first)) > 5


def test_times_that_hardly_fit_move_as_the_job_allows() -> None:
    # Every time but the kept ones costs more than the job pays for, up to a single exchange.
    cost = tuple(1 if t % 5 == 0 else 2 for t in range(61))
    feasible = Feasible(horizon=60, cost=cost, total_cost=14)
    times = tuple(range(0, 61, 5))  # 13 of them leave 1 over
    windows = [tuple(t for t in range(t - 2, t + 3) if 0 <= t <= 60) for t in times]
    found = {jittered(times, windows, feasible, draw) for draw in range(40)}
    for other in found:
        assert feasible.allows(other)
        assert len(other) == 13
        assert len({*other} - {*times}) == 1  # what the money left allows, and no more
    assert len(found) > 10


def test_exact_jitter_is_the_mean_loss_over_all_feasible_times(small_job: Job) -> None:
    built = build(small_job.with_changes(KALMAN))
    times, windows = (1, 4, 7, 10), [(0, 1, 2), (4,), (5, 6, 7, 8), (9, 10)]
    strict, wide = answered(
        built, jitter, "mine", times, {1: [(t,) for t in times], 5: windows}, 10_000
    )
    assert strict == {"percent": 1, "draws": 0} | dict.fromkeys(
        ("loss", "loss_error", "low", "high"), 0.0
    )
    sets = list(product(*windows))
    kept, *mse = kalman.expected_mse(built.evaluator.model, 12, [times, *sets])
    exact = np.mean(mse) / kept - 1
    assert wide["draws"] == module.MOST_EXACT
    assert abs(wide["loss"] - exact) < 4 * wide["loss_error"] < abs(exact)
    assert wide["low"] < wide["loss"] < wide["high"]


def test_jitter_of_particles_is_the_exact_jitter_within_the_errors(small_job: Job) -> None:
    strict, wide = (
        [(1, 2), (4,), (7,), (10, 11)],
        [(0, 1, 2), (3, 4, 5), (6, 7, 8), (9, 10, 11, 12)],
    )
    times, windows = (1, 4, 7, 10), {1: strict, 5: wide}
    job = small_job.with_changes([*COMPILED, "filter.particles=200"])
    found = answered(build(job), jitter, "mine", times, windows, 3000)
    kalman_job = build(small_job.with_changes(KALMAN))
    exact = answered(kalman_job, jitter, "mine", times, windows, 2000)
    for row, true in zip(found, exact, strict=True):
        error = np.hypot(row["loss_error"], true["loss_error"])
        assert abs(row["loss"] - true["loss"]) < 4 * error + 2 * abs(true["loss"]) / 200
        assert row["draws"] == 3000
        assert 0.0 < row["loss_error"] < 0.02


def test_jitter_does_not_depend_on_how_draws_are_cut(
    small_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    built, windows = build(small_job), {1: [(0, 1), (4, 5), (8,), (12,)]}
    found = list[Any]()
    for seconds in (1e9, 1e-9):
        monkeypatch.setattr(module, "MOST_SECONDS", seconds)
        (row,) = answered(built, jitter, "mine", (0, 4, 8, 12), windows, 40)
        found.append([row[key] for key in ("loss", "loss_error", "low", "high")])
    np.testing.assert_allclose(*found, rtol=1e-9)  # sums of other blocks have other last digits
