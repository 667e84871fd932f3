"""How many evenly spaced measurements do as well as the plan, against every number."""

from pathlib import Path

import numpy as np
import pytest

import pfdist
from pfdist import Job
from pfdist.common.estimate import CLEAR_ERRORS
from pfdist.filters.exact import exact_mse
from pfdist.models.library.linear_gaussian import linear_gaussian
from pfdist.problem.even_sets import EvenSets
from pfdist.questions.run_page import answer_of
from pfdist.questions.subject import ranges_of_times
from pfdist.results.columns import Row, rows_of
from pfdist.results.moments import controlled_mse
from pfdist.runner.build import build

EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=2"]
DRAWS = "comparison.draws=300"
SHORT = ["model.name=random_walk", "problem.horizon=8"]


def _plan(run: pfdist.Run) -> Row:
    return next(row for row in rows_of(run.table("sets")) if row.label == "plan")


def _on_its_own(job: Job, number: int) -> tuple[int, ...]:
    return job.feasible(number).regular()


OSCILLATOR = linear_gaussian(  # of period 4: every other instant sees half of it
    "oscillator",
    initial_noise=((1.0, 0.0), (0.0, 1.0)),
    transition=((0.0, 0.99), (-0.99, 0.0)),
    process_noise=((0.3, 0.0), (0.0, 0.3)),
    measurement=((1.0, 0.0),),
    measurement_noise=((0.5,),),
    quantity_of_interest=((1.0, 0.0), (0.0, 1.0)),
)


@pytest.mark.parametrize("reference", ["regular", "evenly spaced"])
def test_the_first_number_and_larger_ones_that_do_worse_are_named(
    reference: str, tmp_path: Path
) -> None:
    """With exact errors the error is known of every number, which more do not always lower."""
    changes = ["filter.engine=kalman", "comparison.draws=2", f"comparison.reference={reference}"]
    run = pfdist.plan(
        pfdist.Problem(OSCILLATOR, horizon=20, measurement_budget=4),
        tmp_path / "run",
        changes=changes,
        figures=False,
    )
    job, plan = pfdist.load_job(run.path), _plan(run)
    numbers, evaluator = range(4, 22), build(job).evaluator
    is_even = reference == "evenly spaced"
    evens = [EvenSets(job.feasible(each)) for each in numbers]
    grids = [
        [*even.sets_of(even.lines(10_000))] if is_even else [even.feasible.regular()]
        for even in evens
    ]
    errors = [min(exact_mse(evaluator, each)) for each in grids]
    as_well = [
        n for n, each in zip(numbers, errors, strict=True) if each <= 1.02 * plan.expected_mse
    ]
    assert (plan.evenly_spaced, plan.evenly_spaced_undecided) == (as_well[0], [])
    worse = [number for number in numbers if number > as_well[0] and number not in as_well]
    assert plan.evenly_spaced_worse == worse
    assert worse or is_even
    others = f" ({ranges_of_times(worse)} do worse)" if worse else ""
    said = f"{as_well[0]} evenly spaced measurements do as well{others}."
    assert said in str(answer_of(run))


def test_differences_are_those_of_the_same_draws(small_job: Job, tmp_path: Path) -> None:
    few = [DRAWS, "filter.particles=20"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=few, figures=False)
    job, table = pfdist.load_job(run.path), run.table("evenly_spaced").set_index("measurements")
    plan = run.table("comparison")[f"mse_{run.names[-1]}"].to_numpy()
    assert (table["draws"] <= len(plan)).all()
    sets = {f"of_{number}": _on_its_own(job, number) for number in table.index}
    again = pfdist.compare(job, times=sets, results=tmp_path / "again", figures=False)
    for number, row in table.iterrows():
        assert tuple(row["measurement_times"]) == sets[f"of_{number}"]
        apart = (again.table("comparison")[f"mse_of_{number}"].to_numpy() - plan)[: row["draws"]]
        error = np.hypot(row["difference_error"], apart.std(ddof=1) / np.sqrt(len(apart)))
        # Only the noise of the filters differs, so the paired errors are far too large.
        assert abs(row["difference"] - apart.mean()) < CLEAR_ERRORS * error


@pytest.mark.plugins("budget")
def test_a_budget_compares_all_numbers(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes(SHORT)
    run = pfdist.budget(job, (2, 5), tmp_path / "run", draws=400, bound_draws=0, figures=False)
    rows, draws = rows_of(run.table("sets")), run.table("comparison")
    for row in rows:
        if row.kind != "found":
            assert row.evenly_spaced is None
            continue
        good = []
        for other in (each for each in rows if each.kind == "regular"):
            apart = controlled_mse(draws, other.name) - controlled_mse(draws, row.name)
            limit = apart.mean() + 1.966 * apart.std(ddof=1) / np.sqrt(len(apart))  # Student's t
            if other.measurements >= row.measurements and limit <= 0.02 * row.expected_mse:
                good.append(other.measurements)
        assert row.evenly_spaced == min(good, default=None)


def test_nothing_is_said_where_not_all_numbers_can_be_evenly_spaced(
    small_job: Job, tmp_path: Path
) -> None:
    changes = [*EXACT, "problem.forbidden=[1]"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=changes, figures=False)
    assert "evenly_spaced" not in run.tables
    assert "evenly spaced measurements" not in str(answer_of(run))


def test_nothing_is_said_where_measurements_tell_nothing(small_job: Job, tmp_path: Path) -> None:
    """All numbers have the same error, so none is clearly as good, and none clearly worse."""
    blind = ["model.name=random_walk", "model.parameters.measurement_sd=1e6", DRAWS, "seed=2"]
    run = pfdist.plan(small_job, tmp_path / "run", changes=blind, figures=False)
    assert _plan(run).evenly_spaced is None  # undecided
    assert "evenly spaced measurements" not in str(answer_of(run))


def test_nothing_is_said_where_a_look_would_take_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow simulator must not be run for a sentence beside the answer."""
    problem = pfdist.Problem("random_walk", horizon=8, measurement_budget=3, particles=20)
    changes = ["comparison.draws=50"]
    said = list[bool]()
    for limit in (1.0, 0.0):
        monkeypatch.setattr("pfdist.questions.run.SHARE", limit)
        run = pfdist.plan(problem, tmp_path / str(limit), changes=changes, figures=False)
        said.append("evenly_spaced" in run.tables)
    assert said == [True, False]


def test_numbers_without_an_evenly_spaced_set_have_regular_times(tmp_path: Path) -> None:
    """On an uneven clock ten of fourteen times are never evenly spaced."""
    times = [0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24]
    problem = pfdist.Problem("random_walk", times=times, measurement_budget=6, engine="kalman")
    run = pfdist.plan(problem, tmp_path / "run", changes=["comparison.draws=2"], figures=False)
    assert {*run.table("evenly_spaced")["measurements"]} == {*range(6, 15)}
