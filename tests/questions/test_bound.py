"""Lower bounds of finished runs, against brute force and where a filter fools itself."""

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.results_of import results_of
from pfdist import Job, Run, load_job
from pfdist.cli.main import main
from pfdist.common.percent import gap_sentence, rounded_up
from pfdist.errors import JobError, ModelError, PfdistWarning
from pfdist.filters.criteria.information import Information
from pfdist.filters.kalman import expected_mse
from pfdist.models import installed_models
from pfdist.pools.base import SerialPool
from pfdist.questions.bound import Bound
from pfdist.questions.bound import bound as bound_of
from pfdist.questions.run import minutes_of_bound
from pfdist.questions.run_page import page_of
from pfdist.results.stored_run import last_bounds, statistics_of
from pfdist.runner.bound_settings import LEAST_DRAWS, BoundSettings
from pfdist.runner.build import build
from pfdist.runner.driver import prover_of
from pfdist.runner.gap_terms import SET_DRAWS
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Progress
from pfdist.runner.prover import Prover

JOBS = Path(__file__).parents[2] / "jobs"
SHARP = Path(__file__).parents[1] / "oracles" / "sharp_sensor.toml"
QUICK = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]
WALK = ["model.name=random_walk", "filter.particles=20", "comparison.draws=300"]
OWN = "model.name=own.py:model"
RunOf = Callable[..., Path]


def bound(run: Path | Run, draws: int | None = None, **options: Any) -> Bound:
    job = run if isinstance(run, Run) else run / "job.toml"
    return bound_of(job, draws, **{"pool": "serial", "figures": False} | options)


@pytest.fixture
def exact(finished: RunOf, tmp_path: Path) -> Path:
    """A finished run whose costs are all exact, in a copy of its own."""
    return shutil.copytree(finished(*QUICK, *EXACT), tmp_path / "run")


@pytest.fixture
def walk(finished: RunOf, tmp_path: Path) -> Path:
    """A finished run with particles, in a copy of its own."""
    return shutil.copytree(finished(*QUICK, *WALK), tmp_path / "run")


@pytest.fixture
def proved(finished: RunOf, tmp_path: Path) -> Path:
    """The same run with a bound on 960 draws, in a copy of its own."""
    return shutil.copytree(finished(*QUICK, *WALK, proved=2 * LEAST_DRAWS), tmp_path / "proved")


@pytest.fixture
def run_of(small_job: Job, tmp_path: Path) -> RunOf:
    """Make a run of the small job with changes, and with a model in ``own.py``."""

    def make(*changes: str, source: str = "") -> Path:
        (small_job.path.parent / "own.py").write_text(source)
        job = small_job.with_changes([*QUICK, *changes])
        return pfdist.run(job, tmp_path / "run", figures=False).path

    return make


def _optimum(job: Job) -> float:
    """The least expected MSE of all feasible sets, by brute force."""
    feasible = job.problem.feasible
    sets = list(feasible.every())
    return float(expected_mse(pfdist.load_model("random_walk"), feasible.horizon, sets).min())


# --- what is true of every bound ------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, 2, 5])
def test_where_everything_is_known_it_lies_below_the_optimum(
    exact: Path, small_job: Job, window: int
) -> None:
    found, optimum = bound(exact, window=window), _optimum(small_job)
    assert found.draws == found.particles == 0
    for gap in found.gaps:
        assert gap.bound.value <= optimum * (1 + 1e-12)
        assert gap.bound.standard_error == 0.0
        assert gap.gap == gap.gap_at_most
        difference = gap.expected_mse.value - gap.bound.value
        assert gap.gap * gap.expected_mse.value == pytest.approx(difference)
    if window == 5:  # nothing is added to 4 measurements, and no gap is too long
        assert found.gaps[0].bound.value == pytest.approx(optimum)


def test_with_particles_it_lies_below_the_optimum_but_for_its_error(
    run_of: RunOf, small_job: Job
) -> None:
    smaller = ["problem.horizon=8", "problem.measurement_budget=3"]
    run = run_of("model.name=random_walk", "filter.particles=200", *smaller)
    optimum = _optimum(small_job.with_changes(smaller))
    found = bound(run, LEAST_DRAWS)
    for gap in found.gaps:
        assert not gap.reason
        assert gap.bound.value < optimum + 4 * gap.bound.standard_error
        assert gap.bound.value > 0.9 * optimum
        assert gap.gap < gap.gap_at_most < gap.gap + 0.1
        parts = gap.relaxation.value + gap.estimate.value + gap.filter_model.value
        assert parts == pytest.approx(gap.gap * gap.expected_mse.value)
        assert gap.filter_model.value == 0.0
    assert bound(run, LEAST_DRAWS).as_json() == found.as_json()
    assert pfdist.open_run(run).state == "finished"


def test_where_measurements_cost_money_it_lies_below_the_optimum(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, costs = small_job.path.read_text(), [3 + t % 2 for t in range(13)]
    priced = text.replace("measurement_budget = 4", f"total_price = 20\nprice = {costs}")
    small_job.path.write_text(priced)
    job = load_job(small_job.path, [*QUICK, *EXACT])
    run, optimum = pfdist.run(job, tmp_path / "run", figures=False).path, _optimum(job)
    for gap in bound(run).gaps:
        assert gap.budget == job.problem.feasible.total
        assert 0.95 * optimum < gap.bound.value <= optimum * (1 + 1e-12)
    finely = bound(run, window=5).gaps[0].bound.value
    assert finely == pytest.approx(optimum)
    monkeypatch.setattr("pfdist.search.first_windows.MOST_UNITS", 7)  # costs are rounded down
    assert bound(run, window=5).gaps[0].bound.value <= finely


def test_many_measurements_are_counted_one_by_one(
    exact: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = [gap.bound.value for gap in bound(exact).gaps]
    monkeypatch.setattr("pfdist.search.first_windows.MOST_UNITS", 3)  # less than N
    assert [gap.bound.value for gap in bound(exact).gaps] == expected
    assert all(value > 0 for value in expected)


def test_a_wrong_model_of_the_filter_is_a_part_of_the_gap(run_of: RunOf) -> None:
    run = run_of("model.name=random_walk", "model.filter.parameters.step_sd=5.0")
    for gap in bound(run, LEAST_DRAWS, work=0).gaps:
        assert gap.filter_model.value > 4 * gap.filter_model.standard_error > 0


def test_where_nothing_is_unknown_the_gap_is_zero(run_of: RunOf) -> None:
    source = """
from pfdist import linear_gaussian
model = linear_gaussian("known", initial_noise=[[0.0]], transition=[[1.0]],
    process_noise=[[0.0]], measurement=[[1.0]], measurement_noise=[[1.0]],
    quantity_of_interest=[[1.0]])
"""
    for gap in bound(run_of(OWN, "filter.engine=kalman", source=source)).gaps:
        assert (gap.gap, gap.gap_at_most, gap.reason) == (0.0, 0.0, "")


SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
SLOW = {"epidemic", "epidemic_counts", "pharmacokinetics", "robot", "tumour", "two_compartments"}
TIMES = "problem.times=[0, 0.5, 1, 2, 3, 4, 6, 9, 12, 13, 30, 46, 47]"
CHANGES = {
    "pharmacokinetics": [TIMES],
    "two_compartments": [TIMES],
    # Else nobody is ill in these days, and a bound says nothing.
    "epidemic_counts": ["problem.horizon=12", "model.parameters.first_infectious=0.02"],
}


@pytest.mark.zoo
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in SHIPPED],
)
def test_every_model_that_ships_has_a_bound(name: str, tmp_path: Path) -> None:
    budget = "total_price" if name == "two_compartments" else "measurement_budget"
    few = [f"problem.{budget}=4", "comparison.draws=100", "execution.pool=serial"]
    few += CHANGES.get(name, ["problem.horizon=12"])
    job = load_job(JOBS / f"{'plan' if name == 'ungm' else name}.toml", few)
    run = pfdist.plan(job, tmp_path / "run", search="random", bound_draws=0, figures=False)
    for gap in bound(run, LEAST_DRAWS).gaps:
        assert not gap.reason
        assert 0.0 <= gap.gap <= gap.gap_at_most < 1.0


# --- filters that fool themselves -----------------------------------------------------------------


@pytest.mark.slow
def test_a_filter_that_fools_itself_gives_no_false_bound(tmp_path: Path) -> None:
    """The "bound" by squared errors would be 3.45 for 0.03, above a set that costs 1.00."""
    changes = ["model.parameters.sharp=0.03", "comparison.draws=1000"]
    run = pfdist.plan(load_job(SHARP, changes), tmp_path / "run", figures=False)
    for gap in bound(run, LEAST_DRAWS).gaps:
        assert gap.reason or gap.bound.value < 1.0


WALK_WITH = """
from dataclasses import replace
import numpy as np
from pfdist import load_model, where
walk = load_model("random_walk")
model = replace(walk, linear_gaussian=False, log_likelihood=lambda y, x, t, p: {})
"""
INFLATED = WALK_WITH.format("-0.5 * ((y[0] - x[0]) / (1.2 * p.measurement_sd)) ** 2")


def test_a_likelihood_that_is_not_that_of_the_noise_gives_no_bound(
    run_of: RunOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Found by `check-model`, and, where that cannot tell, by the truth among the particles."""
    run = run_of(OWN, "filter.particles=100", source=INFLATED)
    first = bound(run, LEAST_DRAWS, work=0)
    assert all("check-model finds that the likelihood is wrong" in gap.reason for gap in first.gaps)
    monkeypatch.setattr("pfdist.runner.prover.likelihood", lambda model, draws: ("note", ""))
    shutil.rmtree(run / "tables" / "bound")
    second = bound(run, LEAST_DRAWS, work=0)
    assert all("the true z lies too often" in gap.reason for gap in second.gaps)
    assert all(math.isnan(gap.gap_at_most) for gap in second.gaps)


# --- what has no bound ----------------------------------------------------------------------------


def test_a_reference_that_is_not_feasible_has_no_gap(run_of: RunOf) -> None:
    run = run_of(*EXACT, "comparison.reference=[1, 3, 6, 9]", "problem.forbidden=[3, 4]")
    reasons = {gap.name: gap.reason for gap in bound(run).gaps}
    assert reasons == {"reference": "the set is not feasible", "genetic": "", "random": ""}


def test_an_error_of_the_users_own_has_no_bound(small_job: Job, tmp_path: Path) -> None:
    """A run that was to have a bound says so and stands; the bound says why."""
    (tmp_path / "own.py").write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model\n"
        "model = replace(load_model('ungm'), error=lambda z, e, t, p: abs(z[0] - e[0]))\n"
    )
    few, said = [*QUICK, OWN, "filter.engine=numpy", "evaluation.draws=3"], list[str]()
    options: Any = {"bound_draws": LEAST_DRAWS, "figures": False, "say": said.append}
    run = pfdist.run(small_job.with_changes(few), tmp_path / "run", **options)
    assert run.state == "finished"
    (line,) = (line for line in said if line.startswith("Not proved: "))
    assert "squared Euclidean norm" in line
    with pytest.raises(JobError, match="squared Euclidean norm"):
        bound(run)
    assert pfdist.open_run(run.path).as_json()["unproved"] == line


def test_a_run_of_a_model_with_long_formulas_has_no_bound_yet(
    walk: Path, monkeypatch: pytest.MonkeyPatch, said: Callable[..., str]
) -> None:
    """The minutes are those of counted work, and follow the operations of the formulas.

    The last sentence of every answer says why there is no proof, and which command makes one, in
    how many minutes.
    """
    lines = list[str]()
    again: Any = {"figures": False, "pool": "serial", "bound_draws": LEAST_DRAWS}
    with monkeypatch.context() as patched:
        patched.setattr("pfdist.questions.run.operations_of", lambda *_: 10**9)
        assert "bound" not in pfdist.run(walk / "job.toml", walk, **again, say=lines.append).tables
    (line,) = lines  # no pool was started
    says = r"Not proved: `pfdist bound \S+ --draws 480` takes about ([\d,]+) minutes of one core\."
    told = re.fullmatch(says, line)
    assert told is not None
    assert int(told[1].replace(",", "")) > 4
    run = pfdist.open_run(walk)
    assert repr(run).startswith("<Measure at t = ")
    assert repr(run).endswith(f" | {line}>")
    code = re.sub("`(.*)`", r"<code>\1</code>", line)
    assert f"<p>Note: {code}</p>" in run._repr_html_()
    assert line in str(page_of(run))
    printed, _, _ = said("status", walk).partition(f"\n\n{walk}: ")
    assert " ".join(printed.split()).endswith(f" Note: {line}")
    assert "bound" in pfdist.run(walk / "job.toml", walk, **again).tables
    assert pfdist.open_run(walk).as_json()["unproved"] == ""


def test_a_proof_that_fails_is_named_at_the_end_of_every_answer(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever refuses a proof, in the prover or in its table: the results of the run stand."""

    def refuse(*_: Any) -> Any:
        raise ModelError("the log-likelihood does not fit the measurements")

    again: Any = {"figures": False, "pool": "serial", "bound_draws": LEAST_DRAWS}
    line = "Not proved: the log-likelihood does not fit the measurements."
    with monkeypatch.context() as patched:
        patched.setattr(Prover, "_parts", refuse)
        with pytest.warns(PfdistWarning, match=f"^{line}"):
            run = pfdist.run(walk / "job.toml", walk, **again)
    assert run.as_json()["unproved"] == line
    assert repr(run).startswith(f"<{line} | Measure at ")
    monkeypatch.setattr(Prover, "_sums", refuse)
    of_sets = line.replace("proved", "proved for {}")
    assert repr(bound(walk)).endswith(f" | {of_sets.format('the random plan')}>")
    assert pfdist.open_run(walk).as_json()["unproved"] == of_sets.format(
        "the genetic plan, the random plan"
    )


def test_a_relaxation_that_is_too_large_is_refused_before_a_pool_starts(
    exact: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("pfdist.questions.at_work.make_pool")
    with pytest.raises(JobError, match=r"; take a smaller window or more memory$") as refused:
        bound(exact, window=6, memory=1)
    assert refused.value.argument == "window"


@pytest.mark.parametrize(
    ("name", "value"),
    [("draws", LEAST_DRAWS - 1), ("draws", 100_001), ("particles", 0), ("window", 0),
     ("window", 7), ("within", 0.0), ("within", 1.0)],
)  # fmt: skip
def test_a_setting_out_of_its_range_is_refused(name: str, value: float) -> None:
    with pytest.raises(JobError, match=f"{name} must be"):
        BoundSettings(**{name: value})  # type: ignore[arg-type]


# --- what a run keeps of its bounds ---------------------------------------------------------------


def _tables(run: Path) -> dict[str, bytes]:
    """The published files of a bound."""
    paths = (run / "tables").glob("*/bound.proof*.parquet")
    found = {f"{path.parent.name}/{path.name}": path.read_bytes() for path in paths}
    return {name: content for name, content in found.items() if not name.startswith("timings")}


def test_a_bound_that_was_stopped_goes_on_and_ends_with_the_same_bytes(
    walk: Path, proved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is stopped while its model seems slow, so that blocks of draws are cut."""
    reports = iter(range(30))

    def stop(progress: object) -> None:
        if next(reports, None) is None:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Pace, "expected", lambda self, steps: 3600.0)
        with pytest.raises(KeyboardInterrupt):
            bound(walk, 2 * LEAST_DRAWS, progress=stop)
    stopped = pfdist.open_run(walk)
    assert stopped.state == "finished"
    assert "error_sums" in stopped.tables
    rows = stopped.table("error_sums")
    assert (rows["block"] < 0).any()  # single draws of blocks that are not whole are not lost
    assert "bound" not in stopped.tables
    bound(walk, 2 * LEAST_DRAWS)
    assert _tables(walk) == _tables(proved)
    assert {name.partition("/")[0] for name in _tables(walk)} == {"bound", "error_sums", "draws"}


def test_what_is_committed_is_not_computed_again(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = list[tuple[str, ...]]()

    class Counting(SerialPool):
        def run(self, tasks: Any) -> Any:
            for outcome in super().run(tasks):
                blocks.extend(work.ids for work in outcome.task.work if work.summed)
                yield outcome

    monkeypatch.setattr("pfdist.questions.at_work.make_pool", lambda *_, **__: Counting())
    bound(walk, LEAST_DRAWS)
    first = len(blocks)
    rounds, rest = divmod(first - 40, 20)  # growing windows; the bound, and the truth's places
    assert rounds >= 1
    assert rest == 0
    for _ in range(2):
        bound(walk, 2 * LEAST_DRAWS)  # the windows are chosen as before
        assert len(blocks) == first + 40


def test_a_comparison_of_many_draws_is_used_and_not_computed_again(run_of: RunOf) -> None:
    run = pfdist.open_run(run_of(*WALK, f"comparison.draws={SET_DRAWS}"))
    found, statistics = bound(run.path, LEAST_DRAWS, work=0), statistics_of(run)
    for gap in found.gaps:
        mse = statistics.mse[gap.name]
        assert gap.expected_mse.value == mse.mean
        assert gap.expected_mse.standard_error == mse.standard_error
        assert not gap.reason
    of_bounds = pfdist.open_run(run.path).table("draws").groupby("evaluation").size()
    variances = min(SET_DRAWS, 12 * LEAST_DRAWS)  # 12 draws for each draw of the bound
    assert (of_bounds == variances).sum() == len(found.gaps)  # the variances alone


def test_more_compared_draws_are_proved_again(proved: Path) -> None:
    assert set(pfdist.open_run(proved).table("bound")["compared_draws"]) == {300}
    job = load_job(proved / "job.toml", ["comparison.draws=400", "execution.pool=serial"])
    run = pfdist.run(job, proved, figures=False, bound_draws=2 * LEAST_DRAWS)
    assert set(run.table("bound")["compared_draws"]) == {400}


def test_a_run_of_another_version_is_proved_and_not_written_to(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.identity.version", lambda name: "99")
    said, before = list[str](), sorted(walk.rglob("*"))
    found = bound(walk, LEAST_DRAWS, work=0, say=said.append)
    assert not any(gap.reason for gap in found.gaps)
    change = f"is of another program (pfdist: {pfdist.__version__} -> 99)"
    assert any(change in line for line in said)
    assert sorted(walk.rglob("*")) == before


def test_the_growth_of_windows_is_foreseen(walk: Path) -> None:
    work, built = 1e6, build(load_job(walk / "job.toml"))
    steps = [Prover(built, BoundSettings(draws=LEAST_DRAWS, work=each)).steps for each in (0, work)]
    assert steps[1] - steps[0] == work


# --- what users see -------------------------------------------------------------------------------


def test_the_table_has_a_row_for_each_set_window_and_number_of_draws(proved: Path) -> None:
    found = bound(proved, 2 * LEAST_DRAWS, figures=True)
    assert [file.name for file in (proved / "figures").iterdir()] == ["bound.svg"]
    bound(proved, LEAST_DRAWS, window=1)
    run = pfdist.open_run(proved)
    rows, summary = run.table("bound"), results_of(run)
    looks = rows[["window", "draws"]].drop_duplicates().to_numpy().tolist()
    assert looks == [[1, LEAST_DRAWS], [2, LEAST_DRAWS], [2, 2 * LEAST_DRAWS]]
    assert list(rows["name"][:3]) == [gap.name for gap in found.gaps]
    last = rows[(rows["window"] == 2) & (rows["draws"] == 2 * LEAST_DRAWS)]
    assert list(last["gap_at_most"]) == [gap.gap_at_most for gap in found.gaps]
    assert [tuple(path) for path in last["path"]] == [gap.path for gap in found.gaps]
    for gap in found.gaps:  # the proof of most work
        assert summary[gap.name].bound_gap == gap.gap
        assert last_bounds(run)[gap.name]["window"] == 2
    assert main(["verify", str(proved)]) == 0


def test_work_that_may_be_left_out_is_told_apart(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The proof of a plan may take too long, and draws beyond a look may not be needed."""
    seen = list[Progress]()
    again: Any = {"figures": False, "pool": "serial", "progress": seen.append}
    job = load_job(walk / "job.toml").with_changes(["seed=2"])
    pfdist.run(job, walk.parent / "other", bound_draws=LEAST_DRAWS, **again)
    phases = {each.phase: each for each in seen}
    assert 0 < phases["random"].optional < phases["random"].total
    assert phases["random"].optional == phases["comparison"].optional
    assert phases["proof, step 3 of 3"].optional == 0
    assert seen[-1].done == seen[-1].total
    seen.clear()
    monkeypatch.setattr("pfdist.questions.run.PATIENCE", 0.0)  # the bound would take too long
    with pytest.warns(PfdistWarning, match="Not proved: `pfdist bound"):
        pfdist.run(job, walk.parent / "without", bound_draws=LEAST_DRAWS, **again)
    assert {each.optional for each in seen} == {0}
    assert max(each.done / each.total for each in seen if each.phase == "random") > 0.1
    seen.clear()
    bound(walk, 2 * LEAST_DRAWS, within=1e-4, progress=seen.append)
    last = "proof, step 3 of 3"
    looks = [each.optional for each in seen if each.phase == last and each.evaluations]
    first, second = dict.fromkeys(looks)  # 480 of 960 draws, then all
    assert first > second == 0
    growing = {each.total for each in seen if each.phase == "proof, step 2 of 3"}
    assert len(growing) == 1  # their work is known before
    assert max(each.done / each.total for each in seen) == 1.0


def test_the_work_of_a_bound_is_counted_not_timed(small_job: Job) -> None:
    """The minutes of a particle-step follow the operations of the formulas, on each machine."""
    minutes = list[float]()
    for changes in ([], ["problem.horizon=120"], ["model.name=lorenz63"]):
        built = build(small_job.with_changes(changes), Path("none"))
        prover = prover_of(built, BoundSettings(draws=LEAST_DRAWS))
        minutes.append(minutes_of_bound(built, prover) / prover.steps)
    assert minutes[0] == pytest.approx(minutes[1])
    assert minutes[2] / minutes[0] == pytest.approx(13, abs=2)  # as 848 operations to 64


def test_it_takes_draws_until_the_gaps_are_within_what_is_demanded(
    proved: Path, said: Callable[..., str]
) -> None:
    whole = bound(proved, 2 * LEAST_DRAWS)
    widest = max(gap.gap_at_most for gap in whole.gaps[1:])  # without the reference's
    soon = bound(proved, within=0.9)
    late = bound(proved, 2 * LEAST_DRAWS, within=widest / 2)
    assert (soon.draws, late.draws) == (LEAST_DRAWS, 2 * LEAST_DRAWS)
    reached = (whole.within_reached, soon.within_reached, late.within_reached)
    assert reached == (None, True, False)
    assert f"Not all limits are at most {50 * widest:g} %" in late._repr_html_()
    # With two looks, each limit holds with 1 - 0.05/2.
    assert late.confidence == pytest.approx(1 - 0.05 / 2)
    for gap, other in zip(whole.gaps, late.gaps, strict=True):
        assert gap.bound == other.bound
        assert gap.gap_at_most < other.gap_at_most
    demand = ["--pool", "serial", "--draws", "480", "--within", "0.0001", "--no-report"]
    assert "Not all limits are at most 0.01 % with 480 draws." in said(
        "bound", proved / "job.toml", *demand
    )


def test_the_command_says_how_much_is_left(exact: Path, said: Callable[..., str]) -> None:
    words = ["bound", str(exact / "job.toml"), "--pool", "serial"]
    answer = json.loads(said(*words, "--json"))
    assert list(answer["sets"]) == ["regular", "genetic", "random"]
    assert answer == bound(exact).as_json()
    text = " ".join(said(*words).split())
    for name, gap in answer["sets"].items():
        percent = f"{100 * rounded_up(gap['gap']):.2g} %"
        sentence = (
            f"Proved: no other 4 times lower the expected MSE by more than a further {percent}."
        )
        assert (f"For the {name} plan: {sentence}" in text) == (name != "regular")


def test_a_bound_from_80_percent_on_is_no_proof() -> None:
    """A limit of 80 % leaves room for an error that is five times lower. The largest part helps."""
    row = {"budget": 4, "bound_error": 1.0, "confidence": 0.95, "gap": 0.7, "relaxation": 0.6}
    assert gap_sentence(row | {"gap_at_most": 0.79}, 4).startswith("Proved: ")
    for part, text in (
        ("relaxation", "work of the proof"),
        ("estimate", "particles"),
        ("filter_model", "mod"),
    ):
        sentence = gap_sentence(row | {"gap_at_most": 0.801, part: 0.65}, 4)
        assert sentence.startswith("The bound says nothing yet: ")
        assert text in sentence
    assert "draws of the proof" in gap_sentence(row | {"gap_at_most": 1.0, "gap": 0.2}, 4)
    exact = gap_sentence(row | {"bound_error": 0.0, "gap": 0.9, "gap_at_most": 0.9}, 4)
    assert exact.startswith("The bound says nothing yet: ")
    nats = {"expected_mse": -2.0, "budget": 4, "bound_error": 0.1, "gap_at_most": 4.0}
    assert (
        Information()
        .proof_sentence(nats, 4, has_fewer=False)
        .startswith("The bound says nothing yet: ")
    )


def test_the_sentence_states_the_limit_rounded_up_and_then_the_estimate() -> None:
    for gap, printed in ((0.02901, "3.0 %"), (0.029, "2.9 %"), (0.1, "10 %"), (0.0, "0 %")):
        row = {"reason": "", "budget": 4, "bound_error": 1.0, "confidence": 0.95, "gap": 0.0123}
        sentence = gap_sentence(row | {"gap_at_most": gap}, 4).replace("\xa0", " ")
        sure = f"a further {printed} (95 % confidence; estimate 1.2 %)."
        assert sentence == f"Proved: no other 4 times lower the expected MSE by more than {sure}"
