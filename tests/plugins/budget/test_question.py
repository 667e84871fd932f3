"""`pfdist budget`: what it finds, that it goes on, and what it says."""

import json
import math
import re
import shutil
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.in_turn import in_turn
from oracles.three_sensors import SYSTEMS
from pfdist import Job, Problem, StateSpaceModel
from pfdist.cli.main import main
from pfdist.common.percent import particle_loss_text
from pfdist.common.rounding import rounded
from pfdist.errors import JobError
from pfdist.filters.exact import exact_mse
from pfdist.filters.kalman import expected_mse
from pfdist.plugins.budget.question import _section
from pfdist.problem.feasible import Feasible
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.questions.run_page import answer_of, page_of
from pfdist.results import reaching
from pfdist.runner.bound_settings import LEAST_DRAWS
from pfdist.runner.build import build
from pfdist.runner.progress import Progress

EXACT = ["model.name=random_walk", "filter.engine=kalman"]
WALK = pfdist.load_model("random_walk")


@pytest.fixture
def exact_job(small_job: Job) -> Job:
    """T = 12, and every cost known."""
    return small_job.with_changes(EXACT)


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> pfdist.Run:
    """Times and a lower bound for 1 to 6 measurements, all exact."""
    job = pfdist.load_job(Path(__file__).parents[2] / "small.toml", EXACT)
    folder = tmp_path_factory.mktemp("exact") / "run"
    return pfdist.budget(job, (1, 6), folder, draws=300, figures=False)


@pytest.fixture
def found(exact: pfdist.Run) -> pd.DataFrame:
    """The found times of each number of measurements."""
    table = exact.table("sets")
    return table[table["kind"] == "found"].set_index("measurements")


def test_few_measurements_are_as_good_in_a_wide_range_for_a_smoothed_estimate(
    exact_job: Job, tmp_path: Path
) -> None:
    """Errors in gaps longer than those that are known only begin to count (brute force)."""
    job = exact_job.with_changes(["problem.estimate=smoothed", "problem.horizon=30"])
    run = pfdist.budget(job, {2, 24}, tmp_path / "run", bound_draws=0, figures=False)
    table = run.table("sets").query("kind == 'found'").set_index("measurements")
    every = [*Feasible(30, 2).every()]
    least = expected_mse(WALK, 30, every, lag=30).min()
    assert table["expected_mse"][2] == pytest.approx(least, rel=1e-9)


def test_numbers_may_be_a_list_and_a_pair_has_all_between() -> None:
    assert _section([2, 5]) == _section({5, 2}) != _section((2, 5))


def _two_levels() -> StateSpaceModel:
    """Two states, with noise that jumps at some instants, and a sensor that is bad at others."""
    q = tuple((0.9 if t in (6, 7) else 0.1, 0.45 if t >= 9 else 0.15) for t in range(15))
    return StateSpaceModel(
        name="two levels",
        initial=lambda w, p: (1.0 + w[0], 0.7 * w[1]),
        transition=lambda x, t, w, p: (
            0.832514 * x[0] + 0.273458 * x[1] + p.a[t] * w[0],
            0.719471 * x[1] + p.b[t] * w[1],
        ),
        measurement=lambda x, t, v, p: (x[0] + p.r[t] * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.r[t]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",) * 2,
        process_noise=("normal",) * 2,
        measurement_noise=("normal",),
        parameters={
            "a": tuple(each for each, _ in q),
            "b": tuple(each for _, each in q),
            "r": tuple(0.8 if t % 4 == 3 else 0.5 for t in range(15)),
        },
        linear_gaussian=True,
    )


def test_a_smoothed_budget_has_the_best_plan_of_each_number(tmp_path: Path) -> None:
    """All sets are enumerated. The programme of gaps alone was up to 10 % above."""
    keys = {"horizon": 14, "measurement_budget": 4, "estimate": "smoothed", "engine": "kalman"}
    problem = pfdist.Problem(_two_levels(), **keys)
    run = pfdist.budget(problem, (2, 5), tmp_path / "run", bound_draws=0, figures=False)
    found = run.table("sets").query("kind == 'found'").set_index("measurements")
    evaluator = build(problem.job()).evaluator
    for number, row in found.iterrows():
        least = min(exact_mse(evaluator, [*combinations(range(15), int(number))]))
        assert row["expected_mse"] == pytest.approx(least, rel=1e-3)


def test_no_row_of_a_smoothed_budget_is_worse_than_its_evenly_spaced_set_or_a_smaller_row(
    tmp_path: Path,
) -> None:
    """The tolerance is three standard errors, because particles have noise.

    The exact error of each plan is at most 1 % above the best of all sets; races alone left 6.7 %.
    """
    keys = {"horizon": 14, "measurement_budget": 4, "estimate": "smoothed"}
    exactly = build(pfdist.Problem(_two_levels(), **keys, engine="kalman").job()).evaluator
    problem = pfdist.Problem(_two_levels(), **keys, particles=200)
    run = pfdist.budget(problem, (2, 6), tmp_path / "run", 1000, bound_draws=0, figures=False)
    rows = run.table("sets").set_index(["kind", "measurements"])
    found = rows.loc["found"]
    for number in range(2, 7):
        own, even = found.loc[number], rows.loc["evenly_spaced", number]
        limit = 3 * math.hypot(own["standard_error"], even["standard_error"])
        assert own["expected_mse"] <= even["expected_mse"] + limit
        (error,) = exact_mse(exactly, [tuple(own["measurement_times"])])
        assert error <= 1.01 * min(exact_mse(exactly, [*combinations(range(15), number)]))
        if number > 2:
            assert own["expected_mse"] <= found.loc[number - 1, "expected_mse"] + limit


@pytest.fixture(scope="module")
def optima() -> "pd.Series[float]":
    """The least expected MSE of all sets of 1 to 6 times, by brute force."""
    sets = {number: list(Feasible(12, number).every()) for number in range(1, 7)}
    return pd.Series({n: expected_mse(WALK, 12, times).min() for n, times in sets.items()})


def test_times_of_every_number_are_those_of_brute_force_and_beside_them_the_regular_ones(
    exact: pfdist.Run,
) -> None:
    table = exact.table("sets")
    kinds = ("regular", DEFAULT_METHOD)
    assert table["name"].tolist() == [f"{name}_{n:02}" for name in kinds for n in range(1, 7)]
    for row in table.to_dict("records"):
        feasible, times = Feasible(12, row["measurements"]), tuple(row["measurement_times"])
        if row["kind"] == "regular":
            assert times == feasible.regular()
        else:
            sets = list(feasible.every())
            costs = expected_mse(WALK, 12, sets)
            assert row["search_mse"] == pytest.approx(costs.min(), rel=1e-9)
            assert times == sets[int(costs.argmin())]
        cost = expected_mse(WALK, 12, [times])[0]
        assert row["expected_mse"] == pytest.approx(cost, rel=1e-9)
        assert row["standard_error"] == 0.0
    assert not (exact.path / "tables" / "trajectories").exists()


def test_no_set_costs_less_than_the_bound_and_a_set_that_costs_as_much_is_optimal(
    exact: pfdist.Run, found: pd.DataFrame, optima: "pd.Series[float]"
) -> None:
    assert found.index.tolist() == optima.index.tolist()
    assert (found["bound"] <= optima * (1 + 1e-12)).all()
    assert (found["bound_error"] == 0).all()
    assert (found["bound_low"] == found["bound"]).all()
    optimal = found["bound"] >= found["search_mse"] * (1 - 1e-11)
    assert optimal.all()  # windows have grown until the gap is 0
    assert found["search_mse"].tolist() == pytest.approx(optima.tolist(), rel=1e-9)
    regular = exact.table("sets").query("kind == 'regular'")
    assert regular[["bound", "bound_error", "bound_low"]].isna().all(axis=None)


def test_a_number_is_impossible_if_no_set_of_so_many_times_reaches_the_target(
    exact: pfdist.Run, optima: "pd.Series[float]"
) -> None:
    for target in (1.0, 1.5, 1.8, 2.2, 2.6):
        cannot = optima.index[optima > target]
        reached = reaching(exact.table("sets"), target)["found"]
        assert reached["impossible"] == (max(cannot) if len(cannot) else None)
        assert reached["measurements"] is None or reached["measurements"] not in cannot


def test_with_particles_the_limit_lies_below_the_optimum(
    small_job: Job, tmp_path: Path, optima: "pd.Series[float]"
) -> None:
    job = small_job.with_changes(["model.name=random_walk", "filter.particles=100"])
    table = pfdist.budget(job, (3, 4), tmp_path / "run", draws=60, figures=False).table("sets")
    for row in table[table["kind"] == "found"].to_dict("records"):
        optimum = optima[row["measurements"]]
        assert row["bound_error"] > 0
        assert 0.9 * optimum < row["bound_low"] < optimum
        assert row["bound_low"] < row["bound"] < optimum + 4 * row["bound_error"]


def test_few_particles_that_reach_no_target_say_that_more_may(
    small_job: Job, tmp_path: Path, optima: "pd.Series[float]"
) -> None:
    """The exact filter reaches it with 3 measurements; 4 particles do not with 3 or 4."""
    few = small_job.with_changes(["model.name=random_walk", "filter.particles=4"])
    run = pfdist.budget(few, (3, 4), tmp_path / "run", draws=400, bound_draws=0, figures=False)
    sets = run.table("sets").set_index("name")
    assert (sets["particle_loss_limit"] > 0.1).all()
    target = optima[3] * 1.05
    reached = reaching(run.table("sets"), target)["found"]
    assert (reached["measurements"], reached["with_more_particles"]) == (None, 3)
    said = " ".join(str(answer_of(run, target)).split())
    own = sets.loc[f"{DEFAULT_METHOD}_03"]
    loss = particle_loss_text(own["particle_loss"], own["particle_loss_limit"])
    more = f"with more particles 3 may be enough: these 4 lose {loss}"
    assert f"reaches an MSE of {target:g}; {more}" in said
    assert len(sets["warnings"].explode().dropna()) == 1  # of the set with the largest loss


def test_however_it_is_cut_it_ends_with_the_same_bytes_and_grows(
    small_job: Job, tmp_path: Path
) -> None:
    few = small_job.with_changes(["problem.horizon=6", "filter.particles=10"])
    whole = pfdist.budget(few, (2, 3), tmp_path / "whole", draws=60, figures=False)

    def stop(progress: Progress) -> None:
        if progress.phase == DEFAULT_METHOD and progress.evaluations > 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.budget(few, (2, 3), tmp_path / "cut", draws=40, progress=stop, figures=False)
    stopped = pfdist.open_run(tmp_path / "cut")
    assert stopped.state != "finished"
    other = few.with_changes(["problem.measurement_budget=3"])  # is left aside
    pfdist.budget(other, (2, 3), tmp_path / "cut", draws=60, figures=False)
    assert hashes(tmp_path / "cut") == hashes(tmp_path / "whole")
    assert whole.state == "finished"
    assert whole.names[0] == "regular_2"
    assert whole.table("bound")["draws"].tolist() == [LEAST_DRAWS] * 2
    found = whole.table("sets").tail(2)
    assert (found["bound_low"] < found["bound"]).all()


def test_a_smoothed_budget_that_is_cut_in_its_exchanges_ends_with_the_same_bytes(
    small_job: Job, tmp_path: Path
) -> None:
    changes = ["problem.estimate=smoothed", "comparison.reference=evenly spaced"]
    few = small_job.with_changes([*changes, "filter.particles=10"])
    given = {"draws": 60, "bound_draws": 0, "figures": False, "pool": "serial"}
    pfdist.budget(few, (2, 3), tmp_path / "whole", **given)
    left = [f"{DEFAULT_METHOD}_{number:02}.polish" for number in (2, 3)]

    def stop(progress: Progress) -> None:
        if progress.phase == left[0] and progress.generation == 2:
            raise KeyboardInterrupt

    while left:
        with pytest.raises(KeyboardInterrupt):
            pfdist.budget(few, (2, 3), tmp_path / "cut", **given, progress=stop)
        del left[0]
    pfdist.budget(few, (2, 3), tmp_path / "cut", **given)
    assert hashes(tmp_path / "cut") == hashes(tmp_path / "whole")


@pytest.mark.plugins("why")
@pytest.mark.usefixtures("no_figures")
def test_the_command_says_how_many_are_enough(
    exact: pfdist.Run,
    found: pd.DataFrame,
    small_job: Job,
    tmp_path: Path,
    said: Callable[..., str],
) -> None:
    run = shutil.copytree(exact.path, tmp_path / "run")
    costs, bounds = found["expected_mse"], found["bound"]
    target = (costs[3] + costs[4]) / 2
    words = f"--measurements 1:6 --draws 300 --target {target} --set {' '.join(EXACT)} --results"
    command = ["budget", "--no-report", str(small_job.path), *words.split(), str(run)]
    answer = json.loads(said(*command, "--json"))
    sets = {row["name"]: row for row in answer["sets"]}
    assert sets[f"{DEFAULT_METHOD}_05"]["expected_mse"] == costs[5]
    assert answer["target"] == target
    assert answer["reached"]["found"]["measurements"] == 4
    assert answer["reached"]["found"]["impossible"] == 3
    row = sets[f"{DEFAULT_METHOD}_03"]
    assert row["bound"] == row["bound_low"] == row["search_mse"] > target
    assert sets["regular_03"]["bound"] is None
    text = said(*command)
    assert f"\nTo reach an MSE of {target:g} you need 4 measurements: t = " in text
    assert "; 3 are provably too few." in " ".join(text.split())
    row = rf"^5 +[0-9.]+ +{rounded(costs[5])} +\S.* {rounded(bounds[5])}$"
    assert re.search(row, text, re.MULTILINE)
    assert "\n1  " in said("status", run)
    assert "several numbers of measurements" in said("why", run / "job.toml", code=1)


@pytest.mark.usefixtures("no_figures")
def test_without_draws_there_is_no_bound(
    exact_job: Job, tmp_path: Path, said: Callable[..., str]
) -> None:
    words = f"--measurements 3 --draws 20 --target 2 --bound-draws 0 --set {' '.join(EXACT)}"
    command = ["budget", str(exact_job.path), *words.split(), "--results", str(tmp_path / "run")]
    text = said(*command, "--no-report")
    assert "bound" not in text
    assert "too few" not in text
    run = pfdist.open_run(tmp_path / "run")
    assert "bound" not in run.tables
    assert run.table("sets")["bound_low"].isna().all()
    assert reaching(run.table("sets"), 0.1)["found"]["impossible"] is None


@pytest.mark.usefixtures("no_figures")
def test_numbers_with_gaps_have_the_times_that_they_have_without_gaps(
    exact: pfdist.Run,
    exact_job: Job,
    found: pd.DataFrame,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Numbers that were not tried are named."""
    target = (found["expected_mse"][3] + found["expected_mse"][4]) / 2
    words = ["--draws", "300", "--set", *EXACT, "--measurements", "2 4,6", "--target", str(target)]
    assert main(["budget", str(exact_job.path), *words, "--results", str(tmp_path / "run")]) == 0
    whole, run = exact.table("sets").set_index("name"), pfdist.open_run(tmp_path / "run")
    few = run.table("sets").set_index("name")
    assert few["measurements"].tolist() == [2, 4, 6] * 2
    for column in ("measurement_times", "expected_mse", "search_mse", "bound"):
        pd.testing.assert_series_equal(few[column], whole[column][few.index])
    said = "; 2 are provably too few; 3 was not tried."
    for page in (capsys.readouterr().out, str(page_of(run, target=target))):
        assert said in " ".join(page.split())
    assert "2, 4, 6" in str(page_of(run, target=target))


def test_numbers_may_be_a_range_or_a_set_and_without_a_gap_are_the_same_run(
    exact: pfdist.Run, exact_job: Job, tmp_path: Path
) -> None:
    folder = shutil.copytree(exact.path, tmp_path / "run")
    for numbers in (range(1, 7), {6, 5, 4, 3, 2, 1}):
        draw = isinstance(numbers, set)  # the last time alone
        run = pfdist.budget(
            exact_job, numbers, folder, draws=300, target=3.0, report=False, figures=draw
        )
        assert run.job["budget"] == {"least": 1, "most": 6}
    names = ("budget", "times")
    figures = {f"{name}.svg" for name in names}
    assert {file.name for file in (folder / "figures").iterdir()} == figures


@in_turn(
    ("options", "words"),
    [
        ("0:5", r"--measurements: each entry .* must be at least 1, got 0$"),
        ("2:14", "budget of 14 measurements: .* number of instants, 13, got 14"),
        ("2:3 --set comparison.draws=9", "which measurements and draws give, got c"),
        ("2:3 --set search.relaxation.polish=true", "polish = false"),
    ],
)
def test_a_mistake_is_one_line(
    options: str, words: str, small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    command = f"budget {small_job.path} --results nowhere --measurements {options}"
    with pytest.raises(SystemExit):
        sys.exit(main(command.split()))
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(words, error)
    assert not Path("nowhere").exists()


def test_other_searches_are_refused(small_job: Job) -> None:
    text = small_job.path.read_text()
    small_job.path.write_text(f"{text}\n[budget]\nleast = 2\nmost = 3\n")
    with pytest.raises(JobError, match=f"search of method '{DEFAULT_METHOD}', got genetic, random"):
        pfdist.load_job(small_job.path)


CHEAP = {"near": {"price": 1}, "far": {"price": 2}, "both": {"price": 3}}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "kind",
    [
        {"sensors": {"both": {"most": 1}}},
        pytest.param({"sensors": {"both": {"minimum_spacing": 4}}}, marks=pytest.mark.slow),
        pytest.param({"sensors": {"near": {"together": "a"}, "both": {"together": "a"}}},
                     marks=pytest.mark.slow),
        pytest.param({"minimum_spacing": 3}, marks=pytest.mark.slow),
        pytest.param({"required": ["5 near"]}, marks=pytest.mark.slow),
        pytest.param({"required": ["5 near"], "sensors": {"both": {"most": 1}}}),
        pytest.param({"forbidden": ["0:2"]}, marks=pytest.mark.slow),
        pytest.param({"sensors": {"both": {"most": 1, "forbidden": ["0:3"]}}},
                     marks=pytest.mark.slow),
        pytest.param({"total_price": 5, "sensors": CHEAP}, marks=pytest.mark.slow),
        pytest.param({"total_price": 5, "sensors": CHEAP | {"near": {"price": 1, "most": 1}}}),
        pytest.param({"total_price": 5, "sensors": CHEAP | {"far": {"price": 2, "install": 1}}},
                     marks=pytest.mark.slow),
        pytest.param({"total_price": 5, "sensors": CHEAP, "visits": {"price": 1, "within": 2}},
                     marks=pytest.mark.slow),
    ],
    ids=str,
)  # fmt: skip
def test_both_numbers_with_any_constraint_are_those_of_enumeration(
    kind: dict[str, Any], tmp_path: Path
) -> None:
    """Two measurements are not a repaired path of three: each number has its own limits."""
    model, numbers = SYSTEMS[0].as_model(), (4, 5) if "total_price" in kind else (2, 3)
    counted = {} if "total_price" in kind else {"measurement_budget": 3}
    sensors = {name: {} for name in model.sensors} | kind.get("sensors", {})
    problem = Problem(model, horizon=8, engine="kalman", **counted, **kind | {"sensors": sensors})
    given = {"draws": 100, "bound_draws": 0, "figures": False, "pool": "serial"}
    run = pfdist.budget(problem, {*numbers}, tmp_path / "run", **given)
    found = run.table("sets").query("kind == 'found'").set_index("budget")["search_mse"]
    for number in numbers:
        sets = [*problem.job().feasible(number).every()]
        assert found[number] == pytest.approx(expected_mse(model, 8, sets).min(), rel=1e-9), number
