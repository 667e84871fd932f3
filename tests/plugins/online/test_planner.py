"""The planner of one system, and the time to measure next by a run and a table."""

import gc
import re
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import oracles.modes
import pfdist
from oracles.in_turn import in_turn
from oracles.kalman import SCALAR, riccati_cost
from pfdist import Job, Planner, Problem
from pfdist.cli.main import main
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError, PfdistError, PfdistWarning
from pfdist.filters.cloud import Gaussian
from pfdist.filters.simulation import simulate
from pfdist.filters.strategy import follow
from pfdist.problem.problem import as_job
from pfdist.questions.planned_run import filter_of
from pfdist.runner.build import build

JOB = """
seed = 3
[problem]
horizon = 14
measurement_budget = 5
[filter]
particles = 50
[comparison]
draws = 20
[online]
draws = 2
judging_draws = 32
[online.search]
method = "corridor"
rounds = 1
evaluation = { draws = 16, particles = 16 }
[execution]
pool = "serial"
"""
SEARCH = 'search=[{method="survivors", evaluation={draws=20}}]'
PLAN = (0, 3, 7, 10, 14)
Y = simulate(pfdist.load_model("ungm"), 14, range(3), 5).y


@pytest.fixture
def job(tmp_path: Path) -> Job:
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    return pfdist.load_job(path)


def measured(planner: Planner, system: int = 0, most: int = 99) -> list[tuple[int, ...]]:
    """Measure as planned, and give the plans after each measurement."""
    plans = [planner.plan()]
    while (time := planner.next_time()) is not None and len(plans) <= most:
        planner.update(Y[system, time], time)
        plans.append(planner.plan())
    return plans


def test_a_coin_never_has_a_larger_error_than_a_quarter() -> None:
    """A state that takes two values: z is 0 or 1, so q (1 - q) is at most .25, for any times."""
    coin = Problem(oracles.modes.model(switch=0.0, sd=1.0), horizon=10, measurement_budget=4)
    planner = Planner(coin, (0, 3, 6, 9))
    q = planner.update(0.5).mean[0]  # a measurement that says nothing: q is about 1/2
    left, none = planner.expected((1, 2, 3), ())
    assert none.expected_mse == pytest.approx(q * (1 - q), abs=4 * none.standard_error)
    exact = oracles.modes.Modes(switch=0.0, sd=1.0, horizon=10, start=q).fixed((1, 2, 3))
    assert left.expected_mse == pytest.approx(exact, abs=0.01)  # 500 particles, 2,000 draws


@pytest.mark.slow
def test_the_standard_error_of_an_expected_error_contains_the_noise_of_the_particles() -> None:
    """Planners with other noise, beside the exact error of a chain of two states, by enumeration.

    Filters with few particles have a larger error, by a share of about 2 / particles.
    """
    particles = 30
    switch, sd, y = 0.1, 0.5, (0.7, 0.2, 0.4)
    chain = oracles.modes.Modes(switch, sd, horizon=2)
    q = chain.start
    for each in y:
        q = chain._after(q * (1 - switch) + (1 - q) * switch, each)  # at first, both are 1/2
    later = oracles.modes.Modes(switch, sd, horizon=6, start=float(q))
    wanted = later.fixed((2, 4)), later.fixed((5, 6))
    quick = ["online.judging_draws=2", "online.search.evaluation={draws=2, particles=2}"]
    model = oracles.modes.model(switch, sd)
    problem = Problem(model, horizon=8, measurement_budget=5, particles=particles)
    built, found = build(as_job(problem, quick)), list[tuple[float, float, float]]()
    for number in range(20):
        planner = Planner(built, (0, 1, 2, 4, 6), draw=number)
        for t, each in enumerate(y):
            planner.update(each, t)
        plan, other = planner.expected((4, 6), (7, 8), draws=1000)
        apart = plan.difference(other)
        miss = apart.value - wanted[0] + wanted[1]
        found.append((plan.expected_mse, plan.standard_error, miss / apart.standard_error))
    value, error, z = np.array(found).T
    assert 0 <= value.mean() / wanted[0] - 1 < 4 / particles
    assert ((value - value.mean()) / error).std(ddof=1) < 1.5  # 20 normal variates: 1 +- .16
    assert z.std(ddof=1) < 1.5


def test_it_measures_the_whole_budget_and_keeps_the_constraints(job: Job) -> None:
    changed = job.with_changes(["problem.minimum_spacing=2", "problem.forbidden=[6, 7]"])
    planner = Planner(changed, times=(0, 3, 8, 10, 14))
    measured(planner)
    assert planner.plan() == ()
    assert changed.problem.feasible.accepts(planner.measured)


def test_it_replans_from_what_was_measured(job: Job) -> None:
    plans = [measured(Planner(job, PLAN, draw=n), n) for n in range(3)]
    assert [first for first, *_ in plans] == [PLAN] * 3
    assert len({*map(tuple, plans)}) > 1


def test_a_planner_that_was_killed_goes_on_from_its_measurements(job: Job) -> None:
    whole = measured(Planner(job, PLAN))
    for killed in (1, 3):
        before = Planner(job, PLAN)
        measured(before, most=killed)
        again = Planner(job, PLAN)  # another process, that is told the same
        for time in before.measured:
            again.update(Y[0, time], time)
        assert [before.plan(), *measured(again)] == whole[killed : killed + 1] + whole[killed:]


def test_its_estimates_are_those_of_the_filter(job: Job) -> None:
    planner, filtering = Planner(job, PLAN), pfdist.Filter(
        "ungm", 50, job.seed, resampling="multinomial"
    )  # fmt: skip
    for time in (0, 3):
        found, wanted = planner.update(Y[0, time], time), filtering.update(time, Y[0, time])
        np.testing.assert_array_equal(found.mean, wanted.mean)
    np.testing.assert_array_equal(planner.estimate(5).mean, filtering.predict(5).mean)
    assert planner.estimate().t == 3
    assert filtering.stream == stream_of("filter", job.seed)


def test_a_missed_measurement_may_be_made_later(job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 0], 0)
    missed = planner.next_time()
    assert missed is not None
    planner.missed()
    assert len(planner.plan()) == 4
    assert planner.plan()[0] > missed
    planner.missed(12)  # two instants are left
    assert planner.plan() == (13, 14)
    with pytest.raises(PfdistError, match=r"t must be at least 13, .* got 12"):
        planner.update(1.0, 12)


def test_a_planner_decides_in_the_loop_of_any_strategy(job: Job) -> None:
    """As if its methods had been given each value, and each measurement that was not made."""
    by_hand, planner, belief = Planner(job, PLAN), Planner(job, PLAN), filter_of(build(job))
    measured(by_hand)
    follow(planner, belief, lambda t, _: Y[0, t], range(15), {})
    assert tuple(t for t, _ in belief.seen) == by_hand.measured
    with pytest.raises(ArgumentError, match=r"belief must be a Filter, got 0\.3"):
        planner.decide(0.3, 14)  # type: ignore[arg-type]
    planner, belief = Planner(job, PLAN), filter_of(build(job))
    assert planner.decide(belief, 0) == ["y"]
    assert planner.in_flight == (0,)
    planner.decide(belief, 2)  # nothing was measured, nor at t = 1
    by_hand = Planner(job, PLAN)
    by_hand.missed(1)
    assert {*planner.plan(), *planner.in_flight} == {*by_hand.plan()}
    for t in (2, -3, 1.5, 99):
        with pytest.raises(ArgumentError, match=r"t must be an instant in 3\.\.14, got"):
            planner.decide(belief, t)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"a filter of the planner's model, got one of robot"):
        planner.decide(pfdist.Filter("robot"), 3)


def test_what_was_decided_can_be_missed(job: Job) -> None:
    decided, by_hand = Planner(job, PLAN), Planner(job, PLAN)
    assert decided.decide(filter_of(build(job)), 0) == ["y"]
    decided.missed()
    by_hand.missed(0)
    assert (decided.plan(), decided.in_flight) == (by_hand.plan(), ())


def test_planned_times_that_are_passed_over_count_as_missed(job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 5], 5)
    assert planner.measured == (5,)
    assert len(planner.plan()) == 4
    assert planner.plan()[0] > 5


def test_planned_times_before_the_start_count_as_measured(tmp_path: Path) -> None:
    """A filter that starts at t = 5 leaves two of the times 0, 3, 6 and 9."""
    problem = Problem("random_walk", horizon=12, measurement_budget=4, engine="kalman")
    later = Gaussian(5, np.zeros(1), np.eye(1))
    planner = Planner(problem, [0, 3, 6, 9], prior=later)
    assert (planner.measured, planner.plan()) == ((0, 3), (6, 9))
    given: Any = {"figures": False, "report": False, "pool": "serial", "bound_draws": 0}
    run = pfdist.plan(problem, results=tmp_path / "run", **given)
    before = sum(t < 5 for t in run.best.measurement_times)
    found = pfdist.next_time(run, pd.DataFrame({"t": [6], "y0": [1.0]}), prior=later)
    assert found.left == len(found.plan) == 3 - before


def test_without_times_a_search_makes_the_first_plan(job: Job) -> None:
    planner = Planner(job)
    assert job.problem.feasible.accepts(planner.plan())
    assert planner.plan() == Planner(job).plan()


def test_the_expected_error_of_an_exact_engine() -> None:
    problem = Problem(SCALAR.as_model(), horizon=14, measurement_budget=5, engine="kalman")
    planner = Planner(problem, PLAN)
    (expected,) = planner.expected()
    assert expected.expected_mse == pytest.approx(riccati_cost(SCALAR, 14, PLAN))
    planner.update(0.3)
    (left,) = planner.expected((3, 7))
    kept = riccati_cost(SCALAR, 14, (0, 3, 7))  # from t = 0 on, as before
    assert left.expected_mse == pytest.approx(kept)
    assert left.standard_error == 0


def test_the_expected_error_is_that_of_the_comparison_before_anything_is_measured(
    job: Job,
) -> None:
    (found,) = Planner(job, PLAN).expected(draws=4000)
    wanted = pfdist.evaluate(job, PLAN, draws=4000)
    error = np.hypot(found.standard_error, wanted.standard_error)
    assert abs(found.expected_mse - wanted.expected_mse) < 4 * error


@in_turn(
    ("call", "words"),
    [
        (lambda planner: planner.update(1.0, 3), r"t must be at least 4, .* got 3"),
        (lambda planner: planner.update(None), "got None"),
        (lambda planner: planner.expected((2, 9)), r"must be at least 4, got 2"),
        (lambda planner: planner.expected(draws=0), r"at least 2, got 0"),
        (lambda planner: [planner.update(1.0) for _ in range(9)], "no measurement is left"),
    ],
)
def test_wrong_times_are_named(call: Callable[[Planner], object], words: str, job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 3], 3)
    with pytest.raises(PfdistError, match=words):
        call(planner)


def test_the_first_plan_must_be_feasible(job: Job) -> None:
    with pytest.raises(PfdistError, match=r"problem.measurement_budget is 5, got 2"):
        Planner(job, (3, 9))


# --- pfdist next --------------------------------------------------------------------------------


@pytest.fixture
def kept(finished: Callable[..., Path]) -> Path:
    """The job of a run that has compared the plan."""
    return finished(SEARCH, job=JOB) / "job.toml"


def table(path: Path, times: tuple[Any, ...], missed: tuple[Any, ...] = ()) -> Path:
    """Write a table of simulated measurements."""
    rows = [(t, f"{t},{float(Y[0, t, 0])!r}") for t in times] + [(t, f"{t},") for t in missed]
    path.write_text("t,y0\n" + "".join(f"{line}\n" for _, line in sorted(rows)))
    return path


def planned_in(kept: Path) -> tuple[Any, ...]:
    return pfdist.open_run(kept.parent).sets["survivors"]


def test_next_says_what_a_planner_says(kept: Path, tmp_path: Path) -> None:
    planner = Planner(kept, planned_in(kept))
    times = []
    for _ in range(2):
        times.append(planner.next_time())
        planner.update(Y[0, times[-1]])
        found = pfdist.next_time(kept, table(tmp_path / "y.csv", tuple(times)))
        assert (found.plan, found.next) == (planner.plan(), planner.next_time())
        assert found.measured == tuple(times)
    planner.missed()
    found = pfdist.next_time(kept, table(tmp_path / "y.csv", tuple(times), missed=(found.next,)))
    assert found.plan == planner.plan()
    (expected,) = planner.expected()
    assert found.expected.expected_mse == expected.expected_mse


def test_before_anything_is_measured_next_is_the_plan(kept: Path, tmp_path: Path) -> None:
    found = pfdist.next_time(kept, table(tmp_path / "y.csv", ()), planned="evenly_spaced")
    assert found.plan == found.planned_before == pfdist.open_run(kept.parent).sets["evenly_spaced"]
    assert found.expected.expected_mse == found.expected_before.expected_mse
    with pytest.raises(PfdistError, match="planned must be a compared set"):
        pfdist.next_time(kept, table(tmp_path / "y.csv", ()), planned="nothing")


def test_time_that_has_passed_replaces_the_plan(kept: Path, tmp_path: Path) -> None:
    found = pfdist.next_time(kept, table(tmp_path / "y.csv", (0,)), now=9, planned="evenly_spaced")
    assert found.plan[0] > 9
    assert len(found.plan) == 4
    assert found.now == 9
    low, high = found.as_json()["difference_low"], found.as_json()["difference_high"]
    assert low < found.difference.value < high
    alone = np.hypot(found.expected.standard_error, found.expected_before.standard_error)
    assert found.difference.standard_error < alone  # both plans are filtered with common noise
    assert "(95 % CI " in found._repr_html_()


def test_the_command_says_when_or_why_no_measurement_is_left(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(times: tuple[Any, ...], *options: str, code: int = 0) -> str:
        file = table(tmp_path / "y.csv", times)
        assert main(["next", str(kept), str(file), *options]) == code
        return "".join(capsys.readouterr())

    text = told((0, 3), "--now", "5")
    found = pfdist.next_time(kept, tmp_path / "y.csv", now=5)
    assert text.startswith(f"Measure next at t = {found.next}; then at about ")
    assert "2 measurements, at t = 0, 3" in text
    assert "from t = " in text
    assert "--now must lie in 3..14, got 99" in told((0, 3), "--now", "99", code=1)
    assert "The budget is spent" in told((0, 3, 7, 10, 13))
    assert "No further" in told((14,))
    # The last planned time was missed, and the budget allows a measurement after it.
    *planned, last = planned_in(kept)
    text = told(tuple(planned), "--now", str(last))
    assert text.startswith("Measure next at t = ")
    assert re.search(r"^  planned before +no further measurement$", text, re.MULTILINE)


def test_measurements_that_contradict_the_model_are_told(
    kept: Path, tmp_path: Path, said: Callable[..., str]
) -> None:
    file = tmp_path / "y.csv"
    file.write_text("t,y0\n0,3000.0\n")
    with pytest.warns(PfdistWarning) as warned:
        told = pfdist.next_time(kept, file)
    few, wrong = (str(each.message) for each in warned)
    assert few.startswith("The estimate is that of a few particles, not the model's")
    assert wrong.startswith("The model may be wrong about this system: look at")
    assert told.is_improbable
    assert repr(told).startswith(f"<{few} | {wrong} | Measure next at t = ")
    assert (told.collapsed, told.as_json()["collapsed"]) == (0, 0)
    text = " ".join(said("next", kept, file).split())
    assert text.startswith(f"{few} {wrong} Measure next")
    planner = pfdist.Planner(kept)
    with pytest.warns(PfdistWarning, match="^The estimate is that of a few particles"):
        assert planner.update(3000.0, 0).collapsed == 0
    assert planner.estimate().collapsed == 0


def test_a_first_plan_that_is_no_longer_possible_is_not_compared(
    finished: Callable[..., Path], tmp_path: Path, said: Callable[..., str]
) -> None:
    """It would cost less than any plan that can be made, because it breaks a constraint."""
    spaced = finished(SEARCH, "problem.minimum_spacing=3", job=JOB) / "job.toml"
    second = planned_in(spaced)[1]
    file = table(tmp_path / "y.csv", (second - 1,))
    found = pfdist.next_time(spaced, file)
    assert found.planned_before[0] == second
    assert found.expected_before is None
    assert found.as_json()["expected_mse_before"] is None
    assert "no longer possible" in said("next", spaced, file)


def test_steps_of_planners_and_questions_for_the_next_time_leave_nothing_in_memory(
    job: Job, finished: Callable[..., Path]
) -> None:
    """A program that serves systems for months asks thousands of times."""
    built, run, numbers = build(job), finished(SEARCH, job=JOB), count()
    table = {"t": [0, 2], "y0": [0.5, 0.1]}

    def plan() -> None:
        planner = Planner(built, PLAN, draw=next(numbers))
        planner.update(Y[0, 0], 0)
        planner.plan()

    def ask() -> None:
        pfdist.next_time(run, pd.DataFrame(table))

    for step in (plan, ask):
        step()
        step()
        gc.collect()
        before = len(gc.get_objects())
        step()
        gc.collect()
        assert len(gc.get_objects()) < before + 100  # a step makes thousands


@pytest.mark.plugins("filter")
def test_next_names_the_samples_beside_a_sensor_that_is_always_on(tmp_path: Path) -> None:
    """A sample at another time than planned; the rest is planned no worse than it was before."""
    always = pfdist.Problem(
        "two_compartments",
        times=range(20),
        measurement_budget=23,
        sensors=["immunoassay", "chromatography"],
        required=["0:19 immunoassay"],
        engine="kalman",
    )
    run = pfdist.plan(always, tmp_path / "run", bound_draws=0, figures=False)
    rows = pd.DataFrame({"t": [*range(10), 5], "sensor": ["immunoassay"] * 10 + ["chromatography"],
                         "y0": [5.0] * 11})  # fmt: skip
    found = pfdist.next_time(run, rows, say=lambda _: None)
    samples = [each for each in found.plan if "chromatography" in str(each)]
    assert [*found.always] == [f"{t} immunoassay" for t in range(10, 20)]
    assert f"Measure next at t = {samples[0]}" in str(found)
    assert "t = 10 to 19 immunoassay'" in repr(found._page().sections)
    assert found.difference is None or found.difference.value <= 0
    followed = pfdist.filter_measurements(run, rows, report=False, say=lambda _: None)
    assert "0 to 9 immunoassay, 5 chromatography" in repr(followed._page().sections)
