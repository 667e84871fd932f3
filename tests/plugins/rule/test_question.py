"""A rule that is tuned, judged and used: on small jobs, and against fixed times."""

import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles import beliefs, watched
from oracles.bytes_of import hashes
from oracles.file_layer import Ended, FileLayer
from oracles.limits import limits as limits_of
from oracles.modes import model as two_modes
from pfdist import Job, Problem, Run, load_job
from pfdist.cli.main import main
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError, StoreError
from pfdist.filters.strategy import follow
from pfdist.filters.variants import results
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.rules import ALWAYS, NEVER, Thresholds
from pfdist.plugins.rule import every_strategy, ruling
from pfdist.plugins.rule.every_strategy import bound_of_strategies
from pfdist.plugins.rule.needs import RULES
from pfdist.plugins.rule.next_by_rule import NextByRule
from pfdist.plugins.rule.question import (
    Ruled,
    _compared,
    _draw,
    unit_of,
)
from pfdist.plugins.rule.rule_file import _Written, keep_rule, rule_json, rule_of
from pfdist.problem.feasible import Feasible
from pfdist.problem.sections import Execution
from pfdist.questions.planned_run import filter_of
from pfdist.runner import door
from pfdist.runner.build import build, make_pool
from pfdist.runner.door import RunSession, complete
from pfdist.search.first_windows import relaxation_for
from pfdist.store import Store, listing
from pfdist.store.verify import verify_run

SMALL = (Path(__file__).parents[2] / "small.toml").read_text()
COUNTED = Feasible(horizon=12, measurement_budget=4)


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(every_strategy, "CHOICE_DRAWS", 6)
    monkeypatch.setattr(every_strategy, "DRAWS", 24)
    monkeypatch.setattr(ruling, "_HALVINGS", 8)
    monkeypatch.setattr(ruling, "_RANGE", 1900.0)
    monkeypatch.setattr(ruling.tuned, "__kwdefaults__", {"draws": 300})


@pytest.fixture
def run(finished: Callable[..., Path], tmp_path: Path) -> Run:
    return pfdist.open_run(shutil.copytree(finished(), tmp_path / "run"))


def asked(run: Run, **options: Any) -> Ruled:
    return pfdist.rule(run.path / "job.toml", results=run.path, figures=False, **options)


@pytest.mark.plugins("online")
def test_a_rule_is_compared_with_online_times_on_the_draws_that_have_them(
    finished: Callable[..., Path],
) -> None:
    exact = ["model.name=random_walk", "filter.engine=kalman"]
    run = pfdist.open_run(finished(*exact, "online.draws=20"))
    table, labels = _compared(run, None)
    assert labels == {"mse_online": "online times"}
    np.testing.assert_array_equal(table["mse_online"], run.table("online")["mse"])
    plan = run.names[1]
    np.testing.assert_array_equal(table[f"mse_{plan}"], run.table("comparison", 20)[f"mse_{plan}"])
    assert _compared(pfdist.open_run(finished()), None)[1] == {}


def test_the_rule_is_judged_on_the_draws_of_the_comparison(run: Run) -> None:
    found = asked(run)
    assert found.rule[1:] == (0.0, 0.0)
    assert len({*found.rule.thresholds}) > 6
    compared = run.table("comparison")
    for name in found.labels:
        np.testing.assert_array_equal(found.table[f"mse_{name}"], compared[f"mse_{name}"])
    answer = found.as_json()
    own, error, plan = (
        answer["sets"][found.plan],
        found.table["mse_rule"],
        compared[f"mse_{found.plan}"],
    )
    assert own["gain"] == pytest.approx(1 - error.mean() / plan.mean())
    apart = error - (1 - own["gain"]) * plan  # the delta method, on paired draws
    half = 1.97 * apart.std() / np.sqrt(len(apart)) / plan.mean()
    assert own["gain_high"] - own["gain_low"] == pytest.approx(2 * half, rel=0.1)
    mean = found.spent
    assert mean.value - 3 * mean.standard_error < found.budget == 4
    assert mean.value > 3.4
    bound = answer["bound"]
    assert bound["at_least"] < bound["value"] < error.mean()
    assert bound["share"] == pytest.approx(
        (plan.mean() - error.mean()) / (plan.mean() - bound["at_least"])
    )
    assert f"{100 * bound['share']:.0f} % of what any strategy can win at most" in repr(
        found._page()
    )
    counted = answer["measurements"]["draws_by_number"]
    assert sum(counted.values()) == answer["draws"] == 250
    assert str(run.path) not in (run.path / "rule.json").read_text()
    assert json.loads((run.path / "rule.json").read_text())["rule"] == rule_json(
        found.rule, found.feasible
    )


def test_with_a_hard_limit_no_draw_is_measured_more_often(run: Run) -> None:
    found = asked(run, hard=True, draws=200)
    assert found.rule.limit == 4
    assert found.table["measurements"].max() <= 4
    assert len(found.table) == 200


def test_it_resumes_and_depends_neither_on_the_workers_nor_on_when_rows_are_committed(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rule that is tried with few draws, and then with more, may find its rows or not."""
    other = pfdist.open_run(shutil.copytree(run.path, tmp_path / "other"))
    monkeypatch.setattr(door, "COMMIT_SECONDS", 0.0)
    whole = asked(run, pool="threads", workers=2)
    monkeypatch.setattr(door, "COMMIT_SECONDS", 1e9)

    class EndedError(Exception):
        pass

    class Stops:
        seen = 0

        def __call__(self, progress: Any) -> None:
            assert not self.seen or progress.evaluations > 0
            self.seen += 1
            if self.seen == 5:
                raise EndedError

    with pytest.raises(EndedError):
        asked(other, pool="serial", progress=Stops())
    again = asked(other, pool="serial")
    pd.testing.assert_frame_equal(again.table, whole.table)
    assert again.rule == whole.rule
    assert hashes(other.path) == hashes(run.path)


def test_it_computes_nothing_twice(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    first = asked(run)
    monkeypatch.setattr(ruling.RuleWork, "result", None)
    pd.testing.assert_frame_equal(asked(run).table, first.table)
    assert pfdist.open_run(run.path).state == "finished"


def test_a_figure_shows_a_draw_even_if_others_are_degenerate(run: Run) -> None:
    found = asked(run)
    found.table["degenerate"] = True
    built = build(load_job(run.path / "job.toml"))
    assert _draw(found, built) == []
    found.table.loc[7, "degenerate"] = False
    assert [file.name for file in _draw(found, built)] == ["rule.svg"]


@pytest.mark.parametrize("rule", [Thresholds((3.0,)), Thresholds((2.0,), 0.5, 4.0)])
def test_the_draw_of_the_figure_is_measured_where_its_deviation_exceeds_the_level(
    small_job: Job, rule: Thresholds
) -> None:
    built = build(small_job)
    work = ruling.work_of(built, rule, 8)
    spent = work.result(built.evaluator).mse[:, 1]
    for draw in range(8):
        shown = ruling.followed(built.evaluator, work, draw)
        before = {t: k for k, t in reversed([*enumerate(shown.instants)])}  # the first of two
        high = [t for t, k in before.items() if shown.deviation[k] > shown.level[k, 0]]
        assert sorted(high) == shown.measured
        assert len(high) == spent[draw]
    assert spent.any()


@pytest.mark.parametrize("weights", [[1] * 13, [1, 0, 2] * 4 + [1]])
def test_errors_and_measurements_count_up_to_each_end(small_job: Job, weights: list[int]) -> None:
    """They are those of a filter that stops there, and no two works share an id."""
    built = build(small_job.with_changes([f"problem.instant_weights={weights}"]))
    given = built, Thresholds((3.0,)), 20
    several = ruling.work_of(*given, ends=(0, 4, 9))
    mse, spent = np.split(several.result(built.evaluator).mse, 2, axis=1)
    ids = {*several.ids}
    for place, end in enumerate((0, 4, 9)):
        alone = ruling.work_of(*given, ends=(end,))
        found = alone.result(built.evaluator).mse.T
        np.testing.assert_allclose(mse[:, place], found[0], rtol=1e-12)
        np.testing.assert_array_equal(spent[:, place], found[1])
        assert alone.steps_a_draw == (end + 1) * built.comparing.particles
        assert ids.isdisjoint(alone.ids)
        ids |= {*alone.ids}
    assert several.steps_a_draw == alone.steps_a_draw
    assert ids.isdisjoint(ruling.work_of(*given).ids)
    assert 0 < spent[:, 1].mean() < spent[:, 2].mean()
    flipped = [ruling.work_of(*given, flipped=7, ends=ends).ids for ends in ((), (4,), (9,))]
    assert len({*flipped[0], *flipped[1], *flipped[2]}) == 9


def test_where_no_rule_is_better_than_the_plan_the_answer_is_the_plan(tmp_path: Path) -> None:
    problem = Problem(
        beliefs.CHAIN, horizon=beliefs.HORIZON, measurement_budget=beliefs.BUDGET, particles=100,
        proposal="plain",
    )  # fmt: skip
    fewer = ["comparison.draws=400", "search.exhaustive.evaluation.draws=100"]
    given: Any = {"results": tmp_path / "run", "figures": False, "pool": "serial"}
    planned = pfdist.plan(problem, search="exhaustive", changes=fewer, bound_draws=0, **given)
    found = pfdist.rule(planned, figures=False, pool="serial")
    assert found.verdict == "the plan"
    assert "Deciding on the way wins nothing here: the rule is the plan." in repr(found)
    assert found.gain(found.plan) == (0.0, 0.0, 0.0)
    assert (found.table["measurements"] == beliefs.BUDGET).all()
    own = found.table["mse_rule"] + 0.02 * np.arange(400) / 400
    worse = replace(found, table=found.table.assign(mse_rule=own))
    worse = replace(worse, labels={**found.labels, found.plan: "the exhaustive plan"})
    assert worse.verdict == "worse"
    assert "so keep the exhaustive plan." in repr(worse)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (["model.name=random_walk", "filter.engine=kalman"], "a rule is a fixed set"),
        (["problem.criterion=worst_instant"], "got the expected error at the worst instant"),
        (["search=[]", "comparison.sets.mine=[0, 4, 8]"], "no plan"),
    ],
)
def test_other_problems_are_not_accepted(small_job: Job, changes: list[str], what: str) -> None:
    built = build(small_job.with_changes(changes))
    assert what in RULES.lacks(built.job, built.evaluator)


def watched_run(folder: Path, draws: int) -> Run:
    """A run of a walk that two sensors with prices watch."""
    problem = Problem(
        watched.WALK, horizon=watched.HORIZON, total_price=watched.BUDGET, particles=200,
        sensors={name: {"price": price} for name, (price, _) in watched.SENSORS.items()},
        engine="compiled", proposal="plain", minimum_spacing=1,
    )  # fmt: skip
    fewer = [f"comparison.draws={draws}", "search.random.evaluations=10"]
    given: Any = {"figures": False, "pool": "serial", "search": "random", "changes": fewer}
    return pfdist.plan(problem, results=folder / "run", bound_draws=0, **given)


@pytest.fixture(scope="module")
def watched_by_two(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return watched_run(tmp_path_factory.mktemp("watched"), 100)


def test_each_sensor_has_a_threshold_and_prices_are_within_the_budget(
    watched_by_two: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = watched_by_two
    monkeypatch.setattr(ruling.tuned, "__kwdefaults__", {"draws": 100})
    monkeypatch.setattr(ruling, "_CLEARLY", -np.inf)
    found = pfdist.rule(run, figures=False, pool="serial")
    answer, mean = found.as_json(), found.spent
    assert list(answer["rule"]["threshold"]) == [*watched.SENSORS]
    assert 6.0 < mean.value < watched.BUDGET + 3 * mean.standard_error
    assert answer["price"]["mean"] == mean.value
    assert found.numbers[found.plan] == watched.BUDGET
    assert "(sharp)" in repr(found._page())
    hard = pfdist.rule(run, hard=True, figures=False, pool="serial")
    assert hard.table["price"].max() == watched.BUDGET == hard.rule.limit
    assert rule_of(run.path, hard.feasible) == hard.rule


def test_no_strategy_of_two_sensors_with_prices_is_below_the_bound(watched_by_two: Run) -> None:
    """The variances do not depend on y, so no strategy is better than the best set.

    A strategy on average may choose one of two sets by chance. With a hard limit the bound is at
    least that on average: such a strategy is one on average, too.
    """
    session = RunSession(build(load_job(watched_by_two.path)), Store(watched_by_two.path))
    given = make_pool(Execution(pool="serial"))
    average, hard = (
        complete(bound_of_strategies(session, is_hard=is_hard), given) for is_hard in (False, True)
    )
    best = {price: watched.best_set(price) for price in range(27)}
    pairs = [(a, b) for a in best for b in best if a <= watched.BUDGET < b]
    hull = min(np.interp(watched.BUDGET, pair, [best[each] for each in pair]) for pair in pairs)
    assert average.value <= hard.value
    for bound, least in ((average, hull), (hard, best[watched.BUDGET])):
        assert 0.9 * least < bound.value < least + 3 * bound.standard_error


@pytest.mark.plugins("online")
def test_next_names_the_sensor_of_the_highest_level_that_can_be_paid_for(
    watched_by_two: Run,
) -> None:
    run, table = watched_by_two, pd.DataFrame({"t": [0], "sensor": "sharp", "y0": 1.0})
    feasible = build(load_job(run.path / "job.toml")).feasible
    for rule, now, following in (
        (
            Thresholds((1.2, 1.6)),
            None,
            "2 cheap",
        ),  # the deviation is 1.02 at t = 1, and 1.43 at t = 2
        (Thresholds((1.2, 1.6)), 2, "3 sharp"),  # 1.74, above both levels
        (Thresholds((1.2, 1.6), 0.0, 3.0), 2, "3 cheap"),  # 1 is left, and the sharp one costs 2
        (Thresholds((np.inf, 1.6), 0.0, 3.0), 2, None),
    ):
        keep_rule(run.path, {"rule": rule_json(rule, feasible)})
        found = pfdist.next_time(run, table, rule=True, now=now)
        assert isinstance(found, NextByRule)
        assert (found.measured, found.next) == (("0 sharp",), following)


def test_a_rule_is_read_as_it_was_written() -> None:
    def read(rule: Any) -> Thresholds:
        return _Written.read(json.loads(json.dumps(rule))).rule([""], COUNTED.horizon + 1)

    mixed = Thresholds((2.0, ALWAYS, NEVER, 0.0) * 3 + (1.0,), 0.5, 3.0)
    assert read(rule_json(mixed, COUNTED)) == mixed
    with pytest.raises(ValueError, match="12 instants, not of 13"):
        read({"threshold": [2.0] * 12, "exponent": 0.0, "limit": 0.0})


@pytest.mark.slow
def test_the_tuned_thresholds_of_two_sensors_are_about_the_best(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ruling.tuned, "__kwdefaults__", {"draws": 3000})
    found = pfdist.rule(watched_run(tmp_path, 6000), figures=False, pool="serial")
    best, _ = watched.best_thresholds(watched.BUDGET)
    alone = [watched.best_thresholds(watched.BUDGET, only=sensor)[0] for sensor in (0, 1)]
    error = found.error()
    assert watched.best_set(watched.BUDGET) < best < min(alone)
    assert error.value < min(alone) - 3 * error.standard_error
    assert error.value < 1.1 * best  # 200 particles decide as the exact deviation would, nearly


@pytest.mark.slow
def test_a_rule_that_measures_more_often_with_more_particles_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A state of two values: few particles exclude one of them, and the rule does not measure.

    With 100 times the particles it measures more often, too, by an evaluation of its own.
    """
    monkeypatch.undo()  # as many draws as usual
    problem = Problem(two_modes(0.05, 0.3), horizon=8, measurement_budget=3, particles=200)
    changes = ["comparison.draws=20000"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    found = pfdist.rule(run, figures=False)
    assert found.finer is not None
    assert found.finer.value > max(2 * found.finer.standard_error, 0.02 * 3)
    assert "With 4 times the particles the rule spends 3." in repr(found)
    built = build(problem.job())
    more = ruling.work_of(built, found.rule, 1000, particles=20_000)
    spent = results(built.evaluator, [more])[0].mse[:, 1]
    assert spent.mean() > 3.0 + 3 * spent.std() / math.sqrt(spent.size)


def test_the_id_of_a_bound_names_the_constraints(tmp_path: Path) -> None:
    """They decide which strategies there are, also where the windows are the same."""
    windows, ids = list[Any](), list[str]()
    for changes in ([], ["problem.required=[4]"], ["problem.minimum_spacing=2"]):
        (tmp_path / "job.toml").write_text(SMALL)
        built = build(pfdist.load_job(tmp_path / "job.toml", changes))
        relaxation = relaxation_for(built.feasible, 1, built.study.usual, 20_000)
        session = RunSession(built, Store(tmp_path / "run"))
        [batch] = islice(every_strategy._least(session, relaxation, 0.0, "draws", 2), 1)
        windows.append((relaxation.windows, relaxation.ends.tolist()))
        ids += batch.works[0].ids[:1]
    assert windows[0] == windows[1] == windows[2]
    assert len({*ids}) == 3


def test_a_quantile_is_judged_as_elsewhere(
    finished: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ruling, "_CLEARLY", -np.inf)
    given = finished("problem.criterion=quantile 0.9")
    run = pfdist.open_run(shutil.copytree(given, tmp_path / "run"))
    found = asked(run)
    mse = np.sort(found.table["mse_rule"])
    assert found.error().value == mse[int(np.ceil(0.9 * mse.size)) - 1]
    own = run.table("sets").set_index("name")
    written = json.loads((run.path / "rule.json").read_text())
    for name in found.labels:
        assert written["sets"][name]["quantile"] == own.loc[name, "quantile"]
    assert "rule's 90 % quantile of the MSE" in repr(found)
    assert found.as_json()["bound"] is None  # a quantile is no mean


@pytest.mark.slow
def test_parameters_that_are_learned_have_a_rule(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    prior = "scenarios.parameters={process_sd={uniform=[0.5, 3.0]}}"
    given = finished(prior, "scenarios.filter=learned")
    found = asked(pfdist.open_run(shutil.copytree(given, tmp_path / "run")))
    assert 3.0 < found.spent.value < 4.0 + 3 * found.spent.standard_error


def test_each_set_has_its_own_number_of_measurements(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    given = finished("comparison.reference=[0, 5, 10]")
    found = asked(pfdist.open_run(shutil.copytree(given, tmp_path / "run")))
    assert [found.as_json()["sets"][name]["measurements"] for name in found.labels] == [4, 3]
    *_, table = found._page().sections[0].blocks
    assert [row[1].text for row in table.rows[1:]] == ["4", "3"]


def test_a_plan_says_what_a_single_threshold_wins(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.questions.run.SHARE", 1.0)
    changes = [
        "problem.horizon=30", "problem.measurement_budget=10", "filter.particles=100",
        "comparison.draws=1000",
    ]  # fmt: skip
    given: Any = {"figures": False, "pool": "serial", "report": False}
    planned = pfdist.plan(small_job, tmp_path / "run", changes=changes, bound_draws=480, **given)
    said = re.search(r"about (\d+) % less with a single threshold", " ".join(repr(planned).split()))
    assert said
    built = build(load_job(planned.path / "job.toml"))

    def values(rule: Thresholds, draws: int, sweep: int | None = None) -> Any:
        return ruling.work_of(built, rule, draws, "rule", sweep=sweep).result(built.evaluator).mse

    def most(threshold: float) -> float:  # measurements of a draw, with 95 % confidence
        number = values(Thresholds((threshold,)), 300)[:, 1]
        return float(number.mean() + 1.645 * number.std(ddof=1) / np.sqrt(300))

    lowest = next(c for c in np.geomspace(1.0, 20.0, 100) if most(c) <= 10)
    plan = ruling.rule_of_set(
        built.job.problem.points.read(planned.best.measurement_times), built.feasible
    )
    own, other = (values(each, 900, -1)[:, 0].mean() for each in (Thresholds((lowest,)), plan))
    assert 100 * (1 - own / other) == pytest.approx(int(said[1]), abs=1.5)  # a grid of 3 %


def test_the_standard_deviation_of_an_angle_has_no_unit() -> None:
    robot, tumour = map(pfdist.load_model, ("robot", "tumour"))
    assert (robot.named("z")[0].unit, unit_of(robot)) == ("rad", "")
    assert unit_of(tumour) == tumour.named("z")[0].unit


def code_of_the_manual() -> list[str]:
    text = (Path(__file__).parents[3] / "docs" / "rule.md").read_text(encoding="utf-8")
    return [part.partition("```")[0] for part in text.split("```python\n")[1:]]


@pytest.mark.filterwarnings("ignore:The estimate is that of a few particles")
@pytest.mark.parametrize("hard", [False, True])
def test_the_loop_in_the_manual_measures_as_the_filter_of_the_run(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, hard: bool
) -> None:
    job = small_job.with_changes(["problem.minimum_spacing=2", "problem.required=[6]"])
    built = build(job)
    rule = Thresholds((4.0, 2.0, NEVER) * 4 + (ALWAYS,), 0.3 * hard, 4.0 * hard)
    (tmp_path / "results" / "robot").mkdir(parents=True)
    answer = {
        "rule": rule_json(rule, built.feasible),
        "constraints": built.feasible.step_limits.recorded,
    }
    (tmp_path / "results/robot/rule.json").write_text(json.dumps(answer))
    monkeypatch.chdir(tmp_path)
    same_noise = (stream_of("filter", job.seed),)  # as `pfdist.Filter` has it
    work = replace(ruling.work_of(built, rule, 4), filter_streams=same_noise)
    for draw in range(4):
        y = built.evaluator.draws(range(draw, draw + 1), work.draws_stream).y[0]
        measured = list[int]()

        def look(t: int, y: Any = y, measured: list[int] = measured) -> Any:
            measured.append(t)
            return y[t]

        monkeypatch.setattr(
            pfdist, "Filter", lambda *_, draw=draw, **__: filter_of(built, draw=draw)
        )
        exec(code_of_the_manual()[0], {"look": look})
        used, belief = pfdist.Rule.load("results/robot/rule.json"), filter_of(built, draw=draw)
        follow(used, belief, lambda t, _, y=y: y[t], range(used.instants), {})
        assert [t for t, _ in belief.seen] == measured
        assert measured == ruling.followed(built.evaluator, work, draw).measured
        assert 6 in measured
        assert len(measured) <= (4 if hard else 7)


@pytest.mark.plugins("filter")
def test_the_loop_with_two_sensors_filters_as_the_command() -> None:
    """One of them fails once, and has its error with each reading."""
    sensors = {
        "ping": pfdist.Sensor(
            lambda x, t, v, p: (x[0] + v[0],),
            lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
            ("normal",),
        ),
        "gps": pfdist.Sensor(
            lambda x, t, v, p: (x[0] + p.gps_sd[t] * v[0], x[1] + p.gps_sd[t] * v[1]),
            lambda y, x, t, p: (
                -0.5 * ((y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2) / p.gps_sd[t] ** 2
                - 2 * np.log(p.gps_sd[t])
            ),
            ("normal", "normal"),
        ),
    }
    boat = pfdist.StateSpaceModel(
        name="boat",
        initial=lambda w, p: (w[0], w[1]),
        transition=lambda x, t, w, p: (x[0] + w[0], x[1] + w[1]),
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal",) * 2,
        process_noise=("normal",) * 2,
        sensors=sensors,
        parameters={"gps_sd": (3.0,)},
    )
    problem = Problem(
        boat, horizon=6, measurement_budget=9, particles=200, given={"gps_sd": "error"},
        sensors={"ping": {}, "gps": {"fails": 0.2}},
    )  # fmt: skip
    fixes = iter([(0.5, -0.5, 0.4), (math.nan, math.nan, None), (2.0, 1.0, 0.8)])
    thresholds = [ALWAYS, NEVER, NEVER, ALWAYS, ALWAYS, ALWAYS, NEVER, ALWAYS] + [NEVER] * 6
    rule = pfdist.Rule(Thresholds(tuple(thresholds)), StepLimits(), ["ping", "gps"])
    names = {"rule": rule, "belief": pfdist.Filter(problem), "read_ping": lambda: 0.7}
    exec(code_of_the_manual()[1], {**names, "read_gps": lambda: next(fixes)})
    assert rule.spent == 5
    table = pd.DataFrame(
        [(0, "ping", 0.7, None, None), (1, "gps", 0.5, -0.5, 0.4), (2, "ping", 0.7, None, None),
         (2, "gps", None, None, None), (3, "gps", 2.0, 1.0, 0.8)],
        columns=["t", "sensor", "y0", "y1", "error"],
    )  # fmt: skip
    found = pfdist.filter_measurements(problem, table)
    assert found.failed == ("2 gps",)
    last = found.table.iloc[-1]
    assert [*names["belief"].now.mean] == [last["mean_0"], last["mean_1"]]


def test_a_rule_in_use_keeps_what_is_spent_and_takes_back_what_was_not_made() -> None:
    limits = limits_of(prices=(1.0, 2.0) * 4, delays=(0, 1))
    used = pfdist.Rule(Thresholds((1.0, 2.0) * 4, 0.0, 5.0), limits, ["cheap", "sharp"])
    assert used.decide(0.5, 0) == []
    assert used.decide(1.5, 1) == ["cheap"]
    assert used.spent == 1.0
    used.not_made()
    assert used.spent == 0.0
    assert used.decide(np.float64(3.0), 2) == ["cheap", "sharp"]  # one value arrives at t = 3
    assert used.spent == 3.0
    for belief in (np.nan, -1.0, "3", None):
        with pytest.raises(ArgumentError, match="belief must be a Filter, or a number"):
            used.decide(belief, 3)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"t must lie in 3\.\.3, got 2"):
        used.decide(3.0, 2)
    assert used.decide(3.0, 3) == ["cheap"]  # a value of the sharp one would come too late


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        ({}, "constraints is missing"),
        ({"constraints": {"prices": [1, 2]}}, "constraints.prices is not that of these sensors"),
        ({"constraints": {"prices": ["one"] * 13}}, "prices.0: .*, got 'one'"),
        ({"constraints": {"steps": [["apart", [-1, 1], [0]]]}}, "constraints.steps is not"),
        ({"constraints": {"steps": [["nothing", [-1], [0]]]}}, "constraints.steps is not"),
        ({"constraints": {"steps": [["most_within", [3, *[1] * 27], [0, 0]]]}}, "constraints.st"),
        ({"constraints": {"steps": [["store", [3, 13, *[1] * 26], [0, -9]]]}}, "constraints.steps"),
        ({"constraints": {"delays": [-1]}}, "constraints.delays is not"),
        ({"constraints": {"required": [13]}}, "constraints.required is not"),
        ({"constraints": {"more": 1}}, "more: .*, got 1"),
        ({"rule": {"threshold": [2.0], "exponent": -1, "limit": 0.0}}, "exponent: .*, got -1"),
        ({"rule": {"threshold": [2.0], "limit": 0.0}}, "exponent: Field required"),
        ({"rule": {"threshold": [-0.5], "exponent": 0.0, "limit": 0.0}, "constraints": {}},
         "a threshold must be at least 0"),
    ],
)  # fmt: skip
def test_a_rule_is_loaded_only_with_right_values_and_the_error_names_the_key(
    tmp_path: Path, wrong: dict[str, Any], what: str
) -> None:
    file = tmp_path / "rule.json"
    file.write_text(json.dumps({"rule": rule_json(Thresholds((2.0,)), COUNTED), **wrong}))
    said = rf"is damaged \({what}.*\), or an earlier version wrote it: `pfdist rule"
    with pytest.raises(StoreError, match=said):
        pfdist.Rule.load(file)


def test_the_function_in_the_manual_decides_as_the_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = code_of_the_manual()[-1]
    (tmp_path / "results" / "plan").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    mixed = (2.0, ALWAYS, NEVER, 0.0) * 3 + (1.0,)
    rules = (
        Thresholds((2.0,)),
        Thresholds((2.0,), 0.5, 3),
        Thresholds((2.0,), 40.0, 3),
        Thresholds(mixed),
        Thresholds(mixed, 0.5, 3),
    )
    for rule in rules:
        answer = json.dumps({"rule": rule_json(rule, COUNTED)})
        Path("results/plan/rule.json").write_text(answer, encoding="utf-8")
        names = dict[str, Any]()
        exec(code, names)
        for t, spent in product(range(13), range(5)):
            (level,) = rule.levels([t], 13 - t, spent)
            for deviation in (0.0, 1.99, 2.01, max(0.0, level - 0.01), max(0.0, level + 0.01)):
                assert names["measures"](deviation, t, 12, spent) is (deviation > level)
        assert names["measures"](1e9, 12, 12, 2, price=2) is (rule.limit == 0)


@pytest.mark.plugins("online")
def test_next_measures_where_the_filter_of_the_run_would(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.DataFrame({"t": [1], "y0": [0.5]})
    given = {"results": run.path, "rule": True}
    with pytest.raises(StoreError, match="has no rule"):
        pfdist.next_time(run.path / "job.toml", table, **given)
    rule = asked(run).rule
    found = pfdist.next_time(run.path / "job.toml", table, **given)
    assert isinstance(found, NextByRule)
    own = pfdist.Filter("ungm", 40, 1, resampling="multinomial", horizon=12)
    own.update(1, 0.5)
    spread = {t: float(own.predict(t).standard_deviation[0]) for t in range(2, 13)}
    assert found.next == next(t for t in spread if spread[t] > rule.thresholds[t])
    assert found.standard_deviation == pytest.approx(spread[found.next])
    later = pfdist.next_time(run.path / "job.toml", table, now=found.next, **given)
    assert later.next > found.next
    ended = pfdist.next_time(run.path / "job.toml", table, now=12, **given).as_json()
    assert (ended["next"], ended["standard_deviation"], ended["level"]) == (None, None, None)
    table.to_csv(tmp_path / "one.csv", index=False)
    assert main(["next", str(run.path), str(tmp_path / "one.csv"), "--rule", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["next"] == found.next
    keep_rule(run.path, {"rule": rule_json(Thresholds((1.0,), 0.5, 1), COUNTED)})
    assert pfdist.next_time(run.path / "job.toml", table, **given).next is None


def test_a_rule_is_read_only_as_it_was_written(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    """Listed with its hash, a plain file, of finite numbers, none below 0 but -1 for always."""
    run = shutil.copytree(finished(), tmp_path / "run")
    right, file = rule_json(Thresholds((2.0,), 0.5, 4), COUNTED), run / "rule.json"
    wrong = {"threshold": ["1e999", "2", 2.5, None, True, [2.0], [-0.5] * 13, ["2"] * 13],
             "exponent": [-1, None], "limit": ["inf", -3], "more": [1]}  # fmt: skip
    for name, value in [(name, value) for name, values in wrong.items() for value in values]:
        keep_rule(run, {"rule": right | {name: value}})
        with pytest.raises(StoreError, match=rf"rule\.json is damaged \(.*{name}.*\): `pfdist"):
            rule_of(run, COUNTED)
    for answer in ([], {}, {"rule": None}, {"rule": {}}):
        keep_rule(run, answer)  # type: ignore[arg-type]
        with pytest.raises(StoreError, match="is damaged"):
            rule_of(run, COUNTED)
    keep_rule(run, {"rule": right})
    assert rule_of(run, COUNTED) == Thresholds((2.0,) * 13, 0.5, 4)
    file.write_text(file.read_text().replace("2.0", "3.0"))
    with pytest.raises(StoreError, match=r"damaged: its content has another hash"):
        rule_of(run, COUNTED)
    assert ["rule.json" in fault for fault in verify_run(run)] == [True]
    file.rename(tmp_path / "else.json")
    file.symlink_to(tmp_path / "else.json")
    with pytest.raises(StoreError, match="must be a plain file, got a link"):
        rule_of(run, COUNTED)
    with pytest.raises(StoreError, match="must be a plain file, got a link"):
        pfdist.open_run(run)
    file.unlink()
    with pytest.raises(StoreError, match="has no rule"):
        rule_of(run, COUNTED)


@pytest.mark.parametrize("fault", ["ended", "ENOSPC", "EIO", "EROFS"])
def test_a_kill_or_a_full_disk_leaves_the_former_rule_or_the_new_one(
    fault: str, finished: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each operation on a file; then the rule can be written again."""
    run, rules = (
        shutil.copytree(finished(), tmp_path / "run"),
        (Thresholds((1.0,) * 13), Thresholds((2.0,) * 13)),
    )
    answers = [{"rule": rule_json(rule, COUNTED)} for rule in rules]
    layer = FileLayer(monkeypatch, tmp_path)
    keep_rule(run, answers[0])
    count = layer.run(lambda: keep_rule(run, answers[1]))
    for at in range(count):
        keep_rule(run, answers[0])
        with pytest.raises((Ended, StoreError)):
            layer.run(lambda: keep_rule(run, answers[1]), fault, at)
        listing._known.clear()
        assert rule_of(run, COUNTED) in rules
        keep_rule(run, answers[1])
        assert rule_of(run, COUNTED) == rules[1]
        assert list(verify_run(run)) == []


@pytest.mark.plugins("online")
def test_next_counts_a_failed_measurement_as_spent_and_may_ask_within_the_spacing(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    given = finished("problem.sensor.fails=0.2", "problem.minimum_spacing=3")
    run = shutil.copytree(given, tmp_path / "run")
    keep_rule(run, {"rule": rule_json(Thresholds((1e-3,), 1.0, 4), COUNTED)})
    table = pd.DataFrame({"t": [1, 4], "y0": [0.5, np.nan]})
    found = pfdist.next_time(run, table, rule=True)
    assert isinstance(found, NextByRule)
    assert (found.measured, found.next) == ((1, 4), 7)
    assert found.level == pytest.approx(1e-3 * (13 - 7) / 2)
    assert pfdist.next_time(run, table, now=5, rule=True).next == 7  # within the spacing


@pytest.mark.plugins("online")
def test_next_by_rule_says_when_the_budget_is_spent(run: Run) -> None:
    """Off the plan, a rule that is a set of times would measure too often."""
    table = pd.DataFrame({"t": [0, 1, 2, 3], "y0": 0.5})
    levels = tuple(ALWAYS if t in (1, 4, 7, 10) else NEVER for t in range(13))
    for rule, next_times in (
        (Thresholds(levels), [1, 4, 4, None]),
        (Thresholds((1e-9,), 1.0, 4), [1, 2, 3, None]),
        (Thresholds((1e-9,)), [1, 2, 3, 4]),
    ):
        keep_rule(run.path, {"rule": rule_json(rule, COUNTED)})
        for number, following in enumerate(next_times, 1):
            found = pfdist.next_time(run, table[:number], rule=True, say=print)
            assert isinstance(found, NextByRule)
            assert found.next == following
            is_beyond = any("The budget is spent" in each for each in found.doubts)
            assert is_beyond == (following is not None and number == 4)


@pytest.mark.plugins("online")
def test_required_times_and_visits_hold_in_each_draw(
    finished: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ruling, "_CLEARLY", -np.inf)  # the rule is not the plan
    monkeypatch.setattr(ruling, "_SWEEPS", ())
    given = finished("problem.required=[6]", "problem.visits.most=2", "problem.visits.within=3")
    run = pfdist.open_run(shutil.copytree(given, tmp_path / "run"))
    found = asked(run, hard=True)
    assert not found.is_plan
    assert found.table["measurements"].between(1, 4).all()
    built = build(load_job(run.path / "job.toml"))
    for draw in range(3):
        shown = ruling.followed(built.evaluator, ruling.work_of(built, found.rule, 3), draw)
        assert 6 in shown.measured
        assert built.feasible.allows(shown.measured)
        assert len(shown.measured) == found.table["measurements"][draw]
    assert json.loads((run.path / "rule.json").read_text())["rule"]["threshold"][6] == ALWAYS
    keep_rule(run.path, {"rule": rule_json(Thresholds((1e-9,), 0.0, 4), built.feasible)})
    for t, following in (([1, 2], 3), ([0, 1, 2], 6)):
        table = pd.DataFrame({"t": t, "y0": 0.5})
        assert pfdist.next_time(run, table, rule=True).next == following


def test_a_budget_of_decimal_prices_is_spent_whole(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    sold = "allowed = [2, 5, 8]\nprice = {'0:12' = 1.1}\ntotal_price = 3.3"  # 3 * 1.1 > 3.3
    given = finished(job=SMALL.replace("measurement_budget = 4", sold))
    found = asked(pfdist.open_run(shutil.copytree(given, tmp_path / "run")))
    assert (found.table["price"] == 3.3).all()


def test_a_filter_that_is_more_unsure_than_z_varies_keeps_its_budget(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    calm, unsure = "{initial_sd=0.1, step_sd=0.1}", "{initial_sd=5.0, step_sd=20.0}"
    changes = ["model.name=random_walk", f"model.parameters={calm}",
               "model.filter.name=random_walk", f"model.filter.parameters={unsure}"]  # fmt: skip
    found = asked(pfdist.open_run(shutil.copytree(finished(*changes), tmp_path / "run")))
    mean = found.spent
    assert mean.value <= found.budget + 3 * mean.standard_error
