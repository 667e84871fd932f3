"""Sampling windows against exact losses, and against filters with particles."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from oracles.answered import answered
from pfdist import Job
from pfdist.common.measurement_times import Times
from pfdist.filters import kalman
from pfdist.plugins.why import measured_worth as module
from pfdist.plugins.why.measured_worth import sampling_windows, worth_of
from pfdist.results.sampling_windows import windows_of
from pfdist.runner.build import Built, build
from pfdist.runner.door import Driver, RunSession
from pfdist.runner.progress import Progress

KALMAN = ["model.name=random_walk", "filter.engine=kalman"]
COMPILED = ["model.name=random_walk", "filter.engine=compiled"]
# Measurements are precise at t = 5 alone.
SHARP = """
from pfdist.models.library.linear_gaussian import linear_gaussian
model = linear_gaussian("sharp", initial_noise=[[3]], transition=[[1]], process_noise=[[0.1]],
    measurement=[[1]], measurement_noise=lambda t: ((0.1 + 50 * (t != 5),),),
    quantity_of_interest=[[1]])
"""


def _windows(built: Built, times: Times, draws: int = 2) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = answered(built, sampling_windows, "mine", times, draws)
    return found


def _brute_force(built: Built, times: Times) -> dict[tuple[int, int], float]:
    """Exact loss of every feasible move between the neighbours, up to the first above 5 %."""
    model, feasible = built.evaluator.model, set(built.job.problem.feasible.every())
    horizon = built.evaluator.horizon
    (kept,) = kalman.expected_mse(model, horizon, [times])
    losses = {(t, t): 0.0 for t in times}
    for before, t, after in zip((-1, *times), times, (*times[1:], horizon + 1), strict=False):
        for side in (range(t - 1, before, -1), range(t + 1, after)):
            for instant in side:
                other = tuple(sorted({*times} - {t} | {instant}))
                if other not in feasible:
                    continue
                (mse,) = kalman.expected_mse(model, horizon, [other])
                losses[t, instant] = mse / kept - 1
                if losses[t, instant] > 0.05:
                    break
    return losses


CONSTRAINED = ["problem.forbidden=[7, 9]", "problem.required=[4]", "problem.minimum_spacing=2"]
PRICED = "problem={horizon=12, price=[1,1,2,1,1,1,1,3,1,1,1,1,1], total_price=4}"


@pytest.mark.parametrize(
    ("changes", "times"),
    [
        ([], (0, 4, 8, 12)),
        ([], (2, 3, 9, 11)),
        (CONSTRAINED, (1, 4, 8, 11)),
        ([PRICED], (1, 5, 8, 11)),
    ],
)
def test_exact_losses_are_those_of_brute_force(
    small_job: Job, changes: list[str], times: Times
) -> None:
    built = build(small_job.with_changes([*KALMAN, *changes]))
    found, exact = _windows(built, times), _brute_force(built, times)
    assert [(row["t"], row["moved_to"]) for row in found] == sorted(exact)
    assert len(found) > len(times)
    for row in found:
        loss = exact[row["t"], row["moved_to"]]
        assert row["loss"] == pytest.approx(loss, abs=1e-12)
        assert (row["lower_limit"], row["upper_limit"]) == (row["loss"], row["loss"])
        assert row["loss_error"] == 0.0
        states = ("inside" if loss <= level else "outside" for level in (0.01, 0.05))
        assert (row["within_1"], row["within_5"]) == tuple(states)


@pytest.mark.parametrize("changes", [KALMAN, COMPILED])
def test_windows_do_not_depend_on_how_many_instants_are_tried_at_once(
    small_job: Job, changes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    built, found = build(small_job.with_changes(changes)), []
    for reach in (1, 3, 100):
        monkeypatch.setattr(module, "FIRST_REACH", reach)
        found.append(_windows(built, (0, 6), 50))
    assert found[0] == found[1] == found[2]


def test_losses_of_particles_are_the_exact_losses_within_their_errors(small_job: Job) -> None:
    particles, times = 200, (1, 4, 7, 10)
    job = small_job.with_changes([*COMPILED, f"filter.particles={particles}"])
    rows = _windows(build(job), times, 4000)
    exact = _brute_force(build(small_job.with_changes(KALMAN)), times)
    states = set[str]()
    for row in rows:
        if (row["t"], row["moved_to"]) not in exact:
            continue  # beyond an instant that the draws do not know to be beyond 5 %
        loss, error = exact[row["t"], row["moved_to"]], row["loss_error"]
        # beside the error of the draws, that of the filter, of order 1/particles
        assert abs(row["loss"] - loss) <= 4 * error + 2 * abs(loss) / particles
        assert error < 0.02
        states |= {row["within_1"], row["within_5"]}
        assert row["upper_limit"] - row["loss"] == pytest.approx(1.645 * error, rel=0.02, abs=1e-12)
    assert states >= {"inside", "outside"}


def test_moves_by_one_instant_lose_what_the_worth_says(small_job: Job) -> None:
    built, times = build(small_job.with_changes(COMPILED)), (0, 4, 8, 12)
    summary, _, worth = answered(built, worth_of, "mine", times, 60)
    rows = {(row["t"], row["moved_to"]): row for row in _windows(built, times, 60)}
    for row in worth:
        for change, step in (("earlier", -1), ("later", 1)):
            if not np.isnan(row[change]):
                loss = row[change] / summary["expected_mse"]
                assert rows[row["t"], row["t"] + step]["loss"] == pytest.approx(loss)


@pytest.mark.parametrize("engine", ["kalman", pytest.param("compiled", marks=pytest.mark.slow)])
def test_a_measurement_at_the_only_precise_instant_has_a_window_of_it_alone(
    small_job: Job, engine: str
) -> None:
    (small_job.path.parent / "sharp.py").write_text(SHARP)
    job = small_job.with_changes(["model.name=sharp.py:model", f"filter.engine={engine}"])
    rows = _windows(build(job), (1, 5, 9, 11), 300)
    windows = windows_of(rows, 1, job.problem.clock)
    assert [window.t for window in windows if not (window.is_wide or window.open)] == [5]
    # Both sides end with their first instant, which is clearly beyond 5 %.
    assert [row["moved_to"] for row in rows if row["t"] == 5] == [4, 5, 6]
    others = [window for window in windows if window.t != 5]
    assert all(window.is_wide for window in others) or engine == "compiled"


def test_a_filter_that_does_not_know_the_truth_has_windows(small_job: Job) -> None:
    job = small_job.with_changes([*COMPILED, "model.filter.parameters.step_sd=2.0"])
    rows = _windows(build(job), (0, 4, 8, 12), 100)
    assert {row["t"] for row in rows if row["within_5"] == "inside"} == {0, 4, 8, 12}
    assert all(np.isfinite(row["loss"]) for row in rows)


def test_no_measurements_have_no_windows_and_progress_grows(small_job: Job) -> None:
    seen = list[Progress]()

    def both(session: RunSession) -> Driver:
        assert (yield from sampling_windows(session, "none", (), 5)) == []
        assert (yield from sampling_windows(session, "one", (3,), 300))

    answered(build(small_job), both, show=seen.append)
    done = [progress.done for progress in seen]
    assert all(later >= earlier for earlier, later in pairwise(done))
    assert done[-1] == 2
