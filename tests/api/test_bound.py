"""Lower bounds of finished runs, against brute force and where a filter fools itself."""

import json
import math
import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import Job, Run, load_job
from pfdist.api.bound import Bound
from pfdist.api.bound import bound as bound_of
from pfdist.cli.bound_lines import proof_lines
from pfdist.cli.main import main
from pfdist.errors import JobError, ModelError, StoreError
from pfdist.evaluation.evaluator import Evaluator
from pfdist.filters.simulation import simulate
from pfdist.pools.base import SerialPool
from pfdist.runner.bound_settings import LEAST_DRAWS, BoundSettings
from pfdist.runner.build import build
from pfdist.runner.progress import Progress
from pfdist.runner.prover import Prover
from pfdist.runner.sets_alone import SET_DRAWS

SHARP = Path(__file__).parents[1] / "oracles" / "sharp_sensor.toml"
QUICK = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]
CLUTTERED = """
import numpy as np
from pfdist import StateSpaceModel, where

def sensor(x, v, u, clutter, p):
    return where(u < 0.01, 3 * clutter, x + p.sd * v)

def log_density(y, x, p):
    sharp = 0.99 / p.sd * np.exp(-0.5 * ((y - x) / p.sd) ** 2)
    return np.log(sharp + 0.01 / 3 * np.exp(-0.5 * (y / 3) ** 2))

def log_likelihood(y, x, t, p):
    left = log_density(y[0], x[0], p) + log_density(y[1], x[1], p)
    return left + log_density(y[2], x[2], p) + log_density(y[3], x[3], p)

model = StateSpaceModel(
    name="cluttered",
    initial=lambda w, p: w,
    transition=lambda x, t, w, p: x,
    measurement=lambda x, t, v, p: (
        sensor(x[0], v[0], v[8], v[4], p), sensor(x[1], v[1], v[9], v[5], p),
        sensor(x[2], v[2], v[10], v[6], p), sensor(x[3], v[3], v[11], v[7], p),
    ),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal",) * 4,
    process_noise=(),
    measurement_noise=("normal",) * 8 + ("uniform",) * 4,
    parameters={"sd": 0.01},
)
"""


def bound(run: Path | pfdist.Run, draws: int | None = None, **options: Any) -> Bound:
    names = {field.name for field in fields(BoundSettings)} & options.keys()
    settings = BoundSettings(**{"draws": draws} | {name: options.pop(name) for name in names})
    job = run if isinstance(run, pfdist.Run) else run / "job.toml"
    return bound_of(job, settings, **{"pool": "serial", "figures": False} | options)


def _run(job: Job, folder: Path, *changes: str) -> pfdist.Run:
    return pfdist.run(job.with_changes([*QUICK, *changes]), folder, figures=False)


@pytest.mark.parametrize("window", [1, 2, 5])
def test_where_everything_is_known_it_lies_below_the_optimum(
    small_job: Job, tmp_path: Path, window: int
) -> None:
    found = bound(_run(small_job, tmp_path / "run", *EXACT).path, window=window)
    job = small_job.with_changes(EXACT)
    evaluator = Evaluator(pfdist.load_model("random_walk"), 12, engine="kalman")
    optimum = min(evaluator.expected_mse(list(job.problem.feasible.every())))
    assert found.draws == found.particles == 0
    for gap in found.gaps:
        assert gap.bound.value <= optimum * (1 + 1e-12)
        assert gap.bound.standard_error == 0.0
        assert gap.gap == gap.gap_at_most
        assert gap.gap * gap.expected_mse.value == pytest.approx(
            gap.expected_mse.value - gap.bound.value
        )
    if window == 5:  # nothing is added to 4 measurements, and no gap is too long
        assert found.gaps[0].bound.value == pytest.approx(optimum)


def test_with_particles_it_lies_below_the_optimum_but_for_its_error(
    small_job: Job, tmp_path: Path
) -> None:
    run = _run(small_job, tmp_path / "run", "model.name=random_walk", "filter.particles=200")
    found = bound(run, LEAST_DRAWS)
    evaluator = Evaluator(pfdist.load_model("random_walk"), 12, engine="kalman")
    optimum = min(evaluator.expected_mse(list(small_job.problem.feasible.every())))
    for gap in found.gaps:
        assert not gap.reason
        assert gap.bound.value < optimum + 4 * gap.bound.standard_error
        assert gap.bound.value > 0.9 * optimum
        assert gap.gap < gap.gap_at_most < gap.gap + 0.1
        parts = gap.relaxation.value + gap.estimate.value + gap.filter_model.value
        assert parts == pytest.approx(gap.gap * gap.expected_mse.value)
        assert gap.filter_model.value == 0.0
    assert bound(run, LEAST_DRAWS).as_json() == found.as_json()
    assert pfdist.open_run(run.path).state == "finished"


def test_a_wrong_model_of_the_filter_is_a_part_of_the_gap(small_job: Job, tmp_path: Path) -> None:
    wrong = ["model.name=random_walk", "model.filter.parameters.step_sd=5.0"]
    found = bound(_run(small_job, tmp_path / "run", *wrong).path, LEAST_DRAWS)
    for gap in found.gaps:
        assert gap.filter_model.value > 4 * gap.filter_model.standard_error > 0


@pytest.mark.slow
@pytest.mark.parametrize("sharp", [0.03, 0.01])
def test_a_filter_that_fools_itself_gives_no_false_bound(sharp: float, tmp_path: Path) -> None:
    """The "bound" by squared errors would be 3.45 for 0.03, above a set that costs 1.00."""
    changes = [f"model.parameters.sharp={sharp}", "comparison.draws=1000"]
    run = pfdist.plan(load_job(SHARP, changes), tmp_path / "run", figures=False)
    for gap in bound(run, LEAST_DRAWS).gaps:
        assert gap.reason or gap.bound.value < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("sd", [0.01, pytest.param(0.001, marks=pytest.mark.slow)])
def test_the_bound_holds_however_few_particles_meet_the_likelihood(
    small_job: Job, tmp_path: Path, sd: float
) -> None:
    """A position in four dimensions: the median of three readings is a filter, too."""
    (small_job.path.parent / "cluttered.py").write_text(CLUTTERED)
    changes = ["problem.horizon=8", "problem.measurement_budget=3", "filter.particles=100"]
    changes += ["model.name=cluttered.py:model", f"model.parameters.sd={sd}"]
    run = _run(small_job, tmp_path / "run", *changes)
    draws = simulate(build(load_job(run.path / "job.toml")).evaluator.model, 8, range(20_000), 1)
    readings = np.stack([draws.y[:, 0], *[np.median(draws.y[:, :3], axis=1)] * 8], axis=1)
    readings[:, 1] = draws.y[:, 0]
    errors = ((readings - draws.z) ** 2).sum(axis=2).mean(axis=1)
    for gap in bound(run, LEAST_DRAWS).gaps:
        slack = 4 * math.hypot(gap.bound.standard_error, errors.std() / math.sqrt(errors.size))
        assert not gap.reason
        assert 0.0 <= gap.bound.value < errors.mean() + slack
        assert gap.gap_at_most <= 1.0


INFLATED = """
from dataclasses import replace
from pfdist import load_model
walk = load_model("random_walk")
model = replace(walk, log_likelihood=lambda y, x, t, p:
    -0.5 * ((y[0] - x[0]) / (1.2 * p.measurement_sd)) ** 2, linear_gaussian=False)
"""


@pytest.mark.slow
def test_a_likelihood_that_is_not_the_truths_gives_no_bound(small_job: Job, tmp_path: Path) -> None:
    """A likelihood with a larger sd than the noise: its variance exceeds the squared error."""
    (small_job.path.parent / "inflated.py").write_text(INFLATED)
    changes = ("model.name=inflated.py:model", "filter.particles=200")
    for gap in bound(_run(small_job, tmp_path / "run", *changes).path, LEAST_DRAWS).gaps:
        assert "exceeds their squared error" in gap.reason or "costs less" in gap.reason


def test_a_reference_that_is_not_feasible_has_no_gap(small_job: Job, tmp_path: Path) -> None:
    changes = ("comparison.reference=[1, 3, 6, 9]", "problem.forbidden=[3, 4]")
    found = bound(_run(small_job, tmp_path / "run", *EXACT, *changes).path)
    reasons = {gap.name: gap.reason for gap in found.gaps}
    assert reasons == {"reference": "the set is not feasible", "genetic": "", "random": ""}


def test_where_nothing_is_unknown_the_gap_is_zero(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "known.py").write_text(
        "from pfdist import linear_gaussian\n"
        "model = linear_gaussian('known', initial_noise=[[0.0]], transition=[[1.0]],\n"
        "    process_noise=[[0.0]], measurement=[[1.0]], measurement_noise=[[1.0]],\n"
        "    quantity_of_interest=[[1.0]])\n"
    )
    changes = ("model.name=known.py:model", "filter.engine=kalman")
    for gap in bound(_run(small_job, tmp_path / "run", *changes).path).gaps:
        assert (gap.gap, gap.gap_at_most, gap.reason) == (0.0, 0.0, "")


@pytest.mark.slow
def test_a_set_with_degenerate_draws_has_no_gap(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "cut.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from pfdist import load_model, where\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, log_likelihood=lambda y, x, t, p:\n"
        "    where(abs(y[0] - x[0]) > 3.5, -np.inf, -0.5 * (y[0] - x[0]) ** 2))\n"
    )
    changes = ("model.name=random_walk", "model.filter.name=cut.py:model")
    leave_out = ("evaluation.degenerate_draws=leave_out", "filter.particles=5")
    for gap in bound(_run(small_job, tmp_path / "run", *changes, *leave_out).path).gaps:
        assert gap.reason == "a draw is degenerate or infinite with the set itself"


def test_the_command_says_how_much_is_left(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _run(small_job, tmp_path / "run", *EXACT)
    assert main(["bound", str(run.path / "job.toml"), "--json", "--pool", "serial"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert list(answer["sets"]) == ["regular", "genetic", "random"]
    assert answer == bound(run).as_json()
    assert main(["bound", str(run.path / "job.toml"), "--pool", "serial"]) == 0
    text = capsys.readouterr().out
    for name, gap in answer["sets"].items():
        assert f"{name}: 4 measurements" in text
        percent = f"{100 * gap['gap']:.2g} %"
        assert f"No other 4 times can lower the error by more than another {percent}." in text


def test_an_unfinished_run_and_wrong_numbers_are_refused(small_job: Job, tmp_path: Path) -> None:
    def stop(progress: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(small_job, tmp_path / "run", progress=stop, figures=False)
    with pytest.raises(StoreError, match="is not finished"):
        bound(tmp_path / "run")
    for wrong in (
        {"draws": LEAST_DRAWS - 1},
        {"draws": 100_001},
        {"draws": 0},
        {"particles": 0},
        {"window": 0},
        {"window": 7},
        {"within": 0.0},
        {"within": 1.0},
    ):
        (name,) = wrong
        with pytest.raises(JobError, match=f"{name} must be"):
            bound(tmp_path / "run", **wrong)  # type: ignore[arg-type]


def test_many_measurements_are_counted_one_by_one(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _run(small_job, tmp_path / "run", *EXACT).path
    expected = [gap.bound.value for gap in bound(run).gaps]
    monkeypatch.setattr("pfdist.bounds.first_windows.MOST_UNITS", 3)  # less than N
    assert [gap.bound.value for gap in bound(run).gaps] == expected
    assert all(value > 0 for value in expected)


@pytest.mark.parametrize("costs", [[3 + t % 2 for t in range(13)], [40 + t for t in range(13)]])
def test_where_measurements_cost_money_it_lies_below_the_optimum(
    small_job: Job, tmp_path: Path, costs: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, money = small_job.path.read_text(), 6 * min(costs) + 2
    path = small_job.path.with_name("priced.toml")
    path.write_text(text.replace("measurement_budget = 4", f"total_cost = {money}\ncost = {costs}"))
    job = load_job(path).with_changes(EXACT)
    evaluator = Evaluator(pfdist.load_model("random_walk"), 12, engine="kalman")
    optimum = min(evaluator.expected_mse(list(job.problem.feasible.every())))
    run = _run(load_job(path), tmp_path / "run", *EXACT).path
    for gap in bound(run).gaps:
        assert gap.budget == job.problem.feasible.total
        assert gap.bound.value <= optimum * (1 + 1e-12)
        assert gap.bound.value > 0.95 * optimum
    finely = bound(run, window=5).gaps[0].bound.value
    assert finely == pytest.approx(optimum)
    monkeypatch.setattr("pfdist.bounds.first_windows.MOST_UNITS", 7)  # costs are rounded down
    roughly = bound(run, window=5).gaps[0].bound.value
    assert roughly <= finely


def test_a_relaxation_that_is_too_large_is_refused_before_a_pool_starts(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = _run(small_job, tmp_path / "run", *EXACT).path
    monkeypatch.delattr("pfdist.api.at_work.make_pool")
    with pytest.raises(JobError, match=r"; take a smaller window, or more memory$") as refused:
        bound(run, window=6, memory=1)
    assert refused.value.argument == "window"


def test_where_no_bound_is_known_one_line_says_why(small_job: Job, tmp_path: Path) -> None:
    mine = small_job.path.parent / "mine.py"
    mine.write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model\n"
        "model = replace(load_model('ungm'), error=lambda z, e, t, p: abs(z[0] - e[0]))\n"
    )
    changes = ("model.name=mine.py:model", "filter.engine=numpy", "evaluation.draws=3")
    with pytest.raises(ModelError, match="squared Euclidean norm"):
        bound(_run(small_job, tmp_path / "own", *changes).path)


WALK = ("model.name=random_walk", "filter.particles=20", "comparison.draws=300")


@pytest.fixture(scope="module")
def finished_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    job = load_job(Path(__file__).parents[1] / "small.toml")
    return _run(job, tmp_path_factory.mktemp("walk") / "run", *WALK).path


@pytest.fixture
def walk(finished_walk: Path, tmp_path: Path) -> Path:
    """A finished run, in a copy of its own."""
    return shutil.copytree(finished_walk, tmp_path / "run")


def _tables(run: Path) -> dict[str, bytes]:
    """The published files of a bound."""
    paths = (run / "tables").glob("*/bound.proof*.parquet")
    found = {f"{path.parent.name}/{path.name}": path.read_bytes() for path in paths}
    return {name: content for name, content in found.items() if not name.startswith("timings")}


def _stopped(run: Path, reports: int, **options: Any) -> None:
    """Stop a bound after so many reports of its progress."""
    left = iter(range(reports))

    def stop(progress: object) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bound(run, progress=stop, **options)


def test_a_bound_that_was_stopped_goes_on_and_ends_with_the_same_bytes(
    walk: Path, tmp_path: Path
) -> None:
    shutil.copytree(walk, tmp_path / "other")
    _stopped(walk, 30, draws=2 * LEAST_DRAWS)
    stopped = pfdist.open_run(walk)
    assert stopped.state == "finished"
    assert stopped.has("error_sums")
    assert not stopped.has("bound")
    bound(walk, 2 * LEAST_DRAWS)
    bound(tmp_path / "other", 2 * LEAST_DRAWS)
    assert _tables(walk) == _tables(tmp_path / "other")
    assert {name.partition("/")[0] for name in _tables(walk)} == {"bound", "error_sums", "draws"}


@pytest.mark.slow
def test_it_has_the_same_bytes_with_two_workers_of_ray(
    walk: Path, tmp_path: Path, ray_cluster: None
) -> None:
    shutil.copytree(walk, tmp_path / "other")
    bound(walk)
    bound(tmp_path / "other", pool="ray", workers=2)
    assert _tables(walk) == _tables(tmp_path / "other")


def test_what_is_committed_is_not_computed_again(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = list[tuple[str, ...]]()

    class Counting(SerialPool):
        def run(self, tasks: Any) -> Any:
            for outcome in super().run(tasks):
                blocks.extend(work.ids for work in outcome.task.work if work.summed)
                yield outcome

    monkeypatch.setattr("pfdist.api.at_work.make_pool", lambda execution: Counting())
    bound(walk, LEAST_DRAWS)
    first = len(blocks)
    rounds, rest = divmod(first - 20, 20)  # of growing windows; the bound
    assert rounds >= 1
    assert rest == 0
    bound(walk, 2 * LEAST_DRAWS)  # the windows are chosen as before
    assert len(blocks) == first + 20
    bound(walk, 2 * LEAST_DRAWS)
    assert len(blocks) == first + 20


def test_the_table_has_a_row_for_each_set_window_and_number_of_draws(walk: Path) -> None:
    found = bound(walk, 2 * LEAST_DRAWS)
    bound(walk, LEAST_DRAWS, window=1)
    rows = pfdist.open_run(walk).bounds()
    looks = rows[["window", "draws"]].drop_duplicates().to_numpy().tolist()
    assert looks == [[1, LEAST_DRAWS], [2, LEAST_DRAWS], [2, 2 * LEAST_DRAWS]]
    assert list(rows["name"][:3]) == [gap.name for gap in found.gaps]
    last = rows[(rows["window"] == 2) & (rows["draws"] == 2 * LEAST_DRAWS)]
    assert list(last["gap_at_most"]) == [gap.gap_at_most for gap in found.gaps]
    assert [tuple(path) for path in last["path"]] == [gap.path for gap in found.gaps]
    summary = pfdist.open_run(walk).summary()["results"]
    for gap in found.gaps:  # the proof of most work
        assert summary[gap.name]["lower_bound"]["gap"] == gap.gap
        assert summary[gap.name]["lower_bound"]["window"] == 2
    assert main(["verify", str(walk)]) == 0


@pytest.mark.parametrize("work", [1e6, 3e6])
def test_the_growth_of_windows_is_foreseen(walk: Path, work: float) -> None:
    built = build(load_job(walk / "job.toml"))
    steps = [Prover(built, BoundSettings(LEAST_DRAWS, work=each)).steps for each in (0, work)]
    assert steps[1] - steps[0] == work
    seen = list[Progress]()
    bound(walk, LEAST_DRAWS, work=work, progress=seen.append)
    assert len({each.total for each in seen if each.phase == "windows of the bound"}) == 1
    assert max(each.done / each.total for each in seen) == 1.0
    assert seen[-1].done == seen[-1].total


def test_a_plan_whose_windows_would_grow_for_long_has_no_bound_yet(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Prover, "_most_steps", 1e13)
    said = list[str]()
    job = small_job.with_changes([*WALK, "comparison.draws=20"])
    run = pfdist.plan(job, tmp_path / "plan", figures=False, pool="serial", say=said.append)
    assert not run.has("bound")
    assert any(line.startswith("there is no lower bound yet: ") for line in said)
    said.clear()
    pfdist.plan(job, tmp_path / "plan", figures=False, pool="serial", say=said.append)
    assert len(said) == 1  # no pool was started
    assert said[0].startswith("there is no lower bound yet: pfdist bound would take about ")


def test_a_run_whose_comparison_was_slow_has_no_bound_yet(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The speed is that of the run's own comparison, not a guess for all models."""
    timings = Run.timings

    def slow(run: Run) -> pd.DataFrame:
        return timings(run).assign(seconds=lambda rows: 1e7 * rows["seconds"])

    said = list[str]()
    again = {"figures": False, "pool": "serial", "bound_draws": LEAST_DRAWS, "say": said.append}
    with monkeypatch.context() as patched:
        patched.setattr(Run, "timings", slow)
        assert not pfdist.run(walk / "job.toml", walk, **again).has("bound")
    assert said[0].startswith("there is no lower bound yet: pfdist bound would take about ")
    assert pfdist.run(walk / "job.toml", walk, **again).has("bound")


def test_it_takes_draws_until_the_gaps_are_within_what_is_demanded(walk: Path) -> None:
    whole = bound(walk, 4 * LEAST_DRAWS)
    widest = max(gap.gap_at_most for gap in whole.gaps[1:])  # without the reference's
    soon = bound(walk, within=0.9)
    assert soon.draws == LEAST_DRAWS
    late = bound(walk, 4 * LEAST_DRAWS, within=widest / 2)
    assert late.draws == 4 * LEAST_DRAWS
    # With three looks, each limit holds with 1 - 0.05/3.
    assert late.confidence == pytest.approx(1 - 0.05 / 3)
    for gap, other in zip(whole.gaps, late.gaps, strict=True):
        assert gap.bound == other.bound
        assert gap.gap_at_most < other.gap_at_most


def test_a_comparison_of_many_draws_is_used_and_not_computed_again(
    small_job: Job, tmp_path: Path
) -> None:
    changes = ("model.name=random_walk", "filter.particles=20", f"comparison.draws={SET_DRAWS}")
    run = _run(small_job, tmp_path / "run", *changes)
    found = bound(run, LEAST_DRAWS)
    statistics = run.statistics()
    for gap in found.gaps:
        mse = statistics.mse[gap.name]
        assert gap.expected_mse.value == mse.mean
        assert gap.expected_mse.standard_error == mse.standard_error
        assert not gap.reason
    of_bounds = pfdist.open_run(run.path).draws().groupby("evaluation").size()
    assert (of_bounds == SET_DRAWS).sum() == len(found.gaps)  # the variances alone


@pytest.mark.slow
def test_plan_says_how_good_its_times_are(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str], no_figures: None
) -> None:
    path = small_job.path
    changes = ["--set", "model.name=random_walk", "filter.particles=50", "comparison.draws=200"]
    command = ["plan", str(path), *changes, "--pool", "serial", "--results"]
    assert main([*command, str(tmp_path / "plan")]) == 0
    text = capsys.readouterr().out
    assert "No other 4 times can lower the error by more than another" in text
    assert "(95 %: " in text
    assert len(pfdist.open_run(tmp_path / "plan").bounds()) == 2  # regular and found times
    tables = _tables(tmp_path / "plan")
    assert main([*command, str(tmp_path / "plan")]) == 0  # nothing is left to do
    assert _tables(tmp_path / "plan") == tables
    assert main([*command, str(tmp_path / "bare"), "--bound-draws", "0"]) == 0
    assert not pfdist.open_run(tmp_path / "bare").has("bound")


@pytest.mark.slow
def test_a_plan_without_a_bound_says_why_and_stands(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "mine.py").write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model\n"
        "model = replace(load_model('ungm'), error=lambda z, e, t, p: abs(z[0] - e[0]))\n"
    )
    said = list[str]()
    job = small_job.with_changes(["model.name=mine.py:model", "comparison.draws=20"])
    run = pfdist.plan(job, tmp_path / "plan", figures=False, pool="serial", say=said.append)
    assert run.state == "finished"
    assert any(line.startswith("there is no lower bound: ") for line in said)


def test_the_figure_shows_the_bound_against_its_work(walk: Path) -> None:
    bound(walk, 2 * LEAST_DRAWS, figures=True)
    assert {file.name for file in (walk / "figures").iterdir()} == {"bound.png", "bound.svg"}


def test_a_run_of_another_version_is_proved_and_not_written_to(
    walk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.identity.version", lambda name: "99")
    said, before = list[str](), sorted(walk.rglob("*"))
    found = bound(walk, LEAST_DRAWS, say=said.append)
    assert not any(gap.reason for gap in found.gaps)
    assert any("is of another program (pfdist: 0.3.0 -> 99)" in line for line in said)
    assert sorted(walk.rglob("*")) == before


def test_more_compared_draws_are_proved_again(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes([*QUICK, *WALK])
    job = job.with_changes(["comparison.draws=300"])

    def proved(draws: int) -> pd.DataFrame:
        more = job.with_changes([f"comparison.draws={draws}"])
        run = pfdist.run(more, tmp_path / "run", figures=False, bound_draws=LEAST_DRAWS)
        return run.bounds()

    assert set(proved(300)["compared_draws"]) == {300}
    assert set(proved(300)["compared_draws"]) == {300}
    assert set(proved(400)["compared_draws"]) == {400}


def test_a_damaged_file_of_a_bound_is_made_again_by_the_bound(walk: Path) -> None:
    bound(walk, LEAST_DRAWS)
    before = _tables(walk)
    for path in (walk / "tables").glob("bound*/*.parquet"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    bound(walk, LEAST_DRAWS)
    assert _tables(walk) == before
    assert pfdist.open_run(walk).state == "finished"
    assert main(["verify", str(walk)]) == 0


@pytest.mark.slow
def test_a_state_that_the_likelihood_excludes_is_a_reason(small_job: Job, tmp_path: Path) -> None:
    """The true state is among the particles, so only a wrong likelihood has degenerate draws."""
    (small_job.path.parent / "cut.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from pfdist import load_model, where\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, linear_gaussian=False, log_likelihood=lambda y, x, t, p:\n"
        "    where(abs(y[0] - x[0]) > 3.0, -np.inf, -0.5 * (y[0] - x[0]) ** 2))\n"
    )
    changes = ("model.name=cut.py:model", "evaluation.degenerate_draws=leave_out")
    run = _run(small_job, tmp_path / "run", *changes, "filter.particles=5")
    bound(run, LEAST_DRAWS)
    rows = pfdist.open_run(run.path).bounds()
    assert all("degenerate or infinite" in reason for reason in rows["reason"])
    assert main(["bound", str(run.path / "job.toml"), "--pool", "serial"]) == 0


def test_a_limit_is_printed_rounded_up(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for gap, printed in ((0.02901, "3.0 %"), (0.029, "2.9 %"), (0.1, "10 %"), (0.0, "0 %")):
        row = {"reason": "", "budget": 4, "bound_error": 1.0, "confidence": 0.95, "gap": 0.0}
        (line,) = proof_lines(row | {"gap_at_most": gap}, 4, is_constrained=False)
        assert line.endswith(f"(95 %: {printed}).")


def test_more_than_is_demanded_is_said(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [
        "bound",
        str(walk / "job.toml"),
        "--pool",
        "serial",
        "--draws",
        "480",
        "--within",
        "0.0001",
    ]
    assert main(command) == 0
    assert "The limit of a found set is above 0.01 % with 480 draws." in capsys.readouterr().out
    assert bound(walk, LEAST_DRAWS, within=0.0001).within_reached is False
    assert bound(walk, LEAST_DRAWS, within=0.99).within_reached is True
    assert bound(walk, LEAST_DRAWS).within_reached is None
