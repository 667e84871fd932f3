"""Scenarios: parameters that the truth may have, plans for their mean and for the worst."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.results_of import results_of
from oracles.walks import (
    HORIZON,
    NOMINAL,
    SCENARIOS,
    WALK,
    WEIGHTS,
    combined,
    costs,
    expected_mse,
)
from pfdist.common.scenario import Scenario
from pfdist.errors import JobError, ModelError
from pfdist.filters.criterion import WorstScenario
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse
from pfdist.filters.scenarios import scenarios_of_draws
from pfdist.filters.variants import knowing_truth
from pfdist.filters.work import BLOCK, Estimation, FilterWork, with_truth
from pfdist.pages.terminal import lines_of
from pfdist.problem.scenarios_section import Scenarios
from pfdist.questions.compared_page import criterion_effect
from pfdist.questions.run_page import answer_of
from pfdist.results.columns import Row
from pfdist.runner import search_phase
from pfdist.runner.build import build

SETS = list(combinations(range(HORIZON + 1), 4))
# The least error that each scenario allows. Divided by it, the worst scenario has the largest loss
# ("standardized maximin", Dette 1997).
SCALES = costs(SETS, told=True).min(axis=0).tolist()


def problem(criterion: str = "mean", **keys: Any) -> pfdist.Problem:
    """The restless walk with three scenarios, four measurements and a filter that is told."""
    section = {"parameters": SCENARIOS, "weights": WEIGHTS, "criterion": criterion}
    if "scales" in keys:
        section["scales"] = keys.pop("scales")
    return pfdist.Problem(
        WALK,
        horizon=HORIZON,
        measurement_budget=4,
        proposal="plain",
        scenarios=section | {"filter": keys.pop("filter", "told")},
        **keys,
    )


# --- the draws ------------------------------------------------------------------------------------


def test_each_block_is_a_systematic_sample_and_each_draw_has_the_shares() -> None:
    shares = (0.1, 0.25, 0.65)
    draws = BLOCK * 4000
    numbers = scenarios_of_draws(shares, 7, range(draws)).reshape(-1, BLOCK)
    for number, share in enumerate(shares):
        counts = np.sum(numbers == number, axis=1)
        assert np.all(np.abs(counts - share * BLOCK) < 1.0)  # systematic sampling
        first_draws = numbers[:, 0] == number  # one of each block: these are independent
        error = np.sqrt(share * (1 - share) / len(numbers))
        assert abs(first_draws.mean() - share) < 4 * error


def test_the_scenario_of_a_draw_depends_on_its_key_alone() -> None:
    shares, whole = (0.5, 0.5), scenarios_of_draws((0.5, 0.5), 3, range(200))
    assert np.array_equal(scenarios_of_draws(shares, 3, range(31, 97)), whole[31:97])
    assert not np.array_equal(scenarios_of_draws(shares, 4, range(200)), whole)


def test_a_scenario_without_a_share_has_no_draw() -> None:
    assert {*scenarios_of_draws((0.0, 1.0, 0.0), 3, range(500)).tolist()} == {1}


def test_a_work_may_be_cut_between_any_two_draws() -> None:
    evaluator = build(problem(particles=20).job()).evaluator
    work = FilterWork(((0, 4), (3,)), (HORIZON,) * 2, (5, 5), 9, (0, 60), Estimation(20))
    whole = evaluator(work).mse
    parts = [evaluator(replace(work, draws=draws)).mse for draws in ((0, 7), (7, 8), (8, 60))]
    assert np.array_equal(np.concatenate(parts), whole)


def test_each_draw_is_that_of_a_model_with_the_parameters_of_its_scenario() -> None:
    evaluator = build(problem(particles=20).job()).evaluator
    work = FilterWork(((0, 4),), (HORIZON,), (5,), 9, (0, 60), Estimation(20))
    mse = evaluator(work).mse
    numbers = scenarios_of_draws([0.25, 0.25, 0.5], 9, range(60))
    for number, parameters in enumerate(SCENARIOS):
        model = WALK.with_parameters(parameters)
        alone = build(pfdist.Problem(model, horizon=HORIZON, measurement_budget=4).job()).evaluator
        assert np.array_equal(alone(work).mse[numbers == number], mse[numbers == number])


@pytest.mark.parametrize("keys", [{}, {"instant_weights": [1.0, 3.0] + [1.0] * (HORIZON - 1)}])
def test_the_squared_errors_of_a_scenario_are_divided_by_its_scale(keys: dict[str, Any]) -> None:
    plain, scaled = problem(particles=20, **keys), problem(particles=20, scales=(2, 4, 0.5), **keys)
    first, second = (pfdist.evaluate(each, [0, 6], draws=120) for each in (plain, scaled))
    assert first.scenarios is not None
    np.testing.assert_allclose(first.mse / np.array([2, 4, 0.5])[first.scenarios], second.mse)


def test_one_scenario_of_the_models_own_parameters_changes_no_number() -> None:
    plain = pfdist.Problem(WALK, horizon=HORIZON, measurement_budget=4, particles=20)
    same = plain.with_changes(scenarios={"parameters": [NOMINAL]})
    first, second = (pfdist.evaluate(each, [0, 6], draws=50) for each in (plain, same))
    assert np.array_equal(first.mse, second.mse)


# --- costs ----------------------------------------------------------------------------------------


def test_the_filter_has_nominal_parameters_or_is_told() -> None:
    times = (0, 3, 7, 10)
    for filter_, told in (("nominal", False), ("told", True)):
        evaluation = pfdist.evaluate(
            problem(filter=filter_, particles=200), times, draws=BLOCK * 100
        )
        for number, own in evaluation.of_scenarios.items():
            believed = SCENARIOS[number] if told else NOMINAL
            exact = expected_mse(times, SCENARIOS[number], believed)
            # 200 particles cost about 1 / 200 more than the Kalman filter
            assert abs(own.expected_mse / 1.005 - exact) < 4 * own.standard_error


# --- plans, by brute force ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("criterion", "method"),
    [("mean", "exchange"), ("mean", "relaxation"), ("worst", "relaxation")],
)
def test_searches_with_the_kalman_filter_find_the_optimum_of_brute_force(
    criterion: str, method: str, tmp_path: Path
) -> None:
    exact = combined(costs(SETS, told=True) / SCALES, criterion)
    run = pfdist.run(
        problem(criterion, engine="kalman", scales=SCALES).job(
            search=[{"method": method}], comparison={"draws": 100}, execution={"pool": "serial"}
        ),
        tmp_path / "run",
        figures=False,
    )
    found = combined(costs([run.sets[method]], told=True) / SCALES, criterion)
    assert found[0] == pytest.approx(exact.min(), rel=1e-12)
    believed = run.table("compared").set_index("name")["search_mse"][method]
    assert believed == pytest.approx(exact.min(), rel=1e-9)


def test_a_search_for_the_worst_believes_the_error_of_the_worst_of_each_finalist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of the sets that the search for the best mean found."""
    found, costs_of = search_phase._Found, list[tuple[float, float]]()

    def seen(finalists: list[Evaluation], polished: bool) -> Any:
        for each in finalists:
            means = [own.expected_mse for own in each.of_scenarios.values()]
            costs_of.append((each.expected_mse, max(means)))
        return found(finalists, polished)

    monkeypatch.setattr(search_phase, "_Found", seen)
    changes = ["comparison.draws=48", "search.relaxation.evaluation.draws=48"]
    changes += ["problem.horizon=8", "problem.measurement_budget=3"]
    asked = problem("worst", filter="nominal", particles=40)
    pfdist.plan(
        asked, tmp_path / "run", changes=changes, pool="serial", bound_draws=0, figures=False
    )
    assert len(costs_of) > 1
    assert all(cost == largest for cost, largest in costs_of)


def test_a_summary_compares_the_belief_of_a_search_with_the_error_of_the_worst(
    tmp_path: Path,
) -> None:
    """With the Kalman filter the search knows the error of the worst exactly, so chance is left."""
    asked = problem("worst", scales=SCALES, engine="kalman")
    search = {"method": "exhaustive", "evaluation": {"draws": 120}}
    job = asked.job(search=[search], comparison={"draws": 600})
    run = pfdist.run(job, tmp_path / "run", figures=False)
    rows = run.table("scenarios").query("name == 'exhaustive'")
    fresh = rows.loc[rows["expected_mse"].idxmax()]
    assert fresh["expected_mse"] > 1.05 * run.best.expected_mse  # the mean is another error
    believed = run.best.search_mse / fresh["expected_mse"]
    assert run.best.search_cause == "its draws chose the set"
    assert run.best.search_excess == pytest.approx(believed - 1, rel=1e-9, abs=1e-12)
    assert abs(run.best.search_excess) < 4 * fresh["standard_error"] / fresh["expected_mse"]


@pytest.mark.plugins("budget")
def test_each_number_of_measurements_has_the_optimum_of_brute_force(tmp_path: Path) -> None:
    numbers = range(2, 6)
    run = pfdist.budget(
        problem(engine="kalman"), numbers, draws=48, results=tmp_path / "run", figures=False
    )
    rows = run.table("sets").query("kind == 'found'").set_index("measurements")
    for number in numbers:
        sets = list(combinations(range(HORIZON + 1), number))
        exact = combined(costs(sets, told=True), "mean").min()
        assert rows["search_mse"][number] == pytest.approx(exact, rel=1e-9)
        assert rows["bound"][number] == pytest.approx(exact, rel=1e-9)


@pytest.mark.plugins("why")
def test_why_gives_the_exact_worth_of_each_measurement_to_the_mean(tmp_path: Path) -> None:
    asked, times = problem(engine="kalman"), [0, 4, 8, 11]
    sets: Any = {"mine": times, "late": [9, 10, 11, 12]}
    run = pfdist.compare(asked, times=sets, results=tmp_path / "run", draws=48, figures=False)
    rows = pfdist.why(run, figures=False).worth.query("name == 'mine'").set_index("t")
    without = [[t for t in times if t != out] for out in times]
    cost, *others = combined(costs([times, *without], told=True), "mean")
    assert rows["removed"].loc[times].tolist() == pytest.approx([each - cost for each in others])


@pytest.mark.slow
def test_a_nominal_filter_finds_the_optimum_and_the_bound_lies_below(tmp_path: Path) -> None:
    of_sets, criterion = combined(costs(SETS, told=False), "worst"), "worst"
    own = {"draws": 120, "particles": 40, "noise": "common"}
    search = [{"method": "exhaustive", "evaluation": own}]
    asked = problem(criterion, filter="nominal", particles=100)
    job = asked.job(search=search, comparison={"draws": 900})
    run = pfdist.run(job, tmp_path / "run", figures=False)
    times = run.sets["exhaustive"]
    rows = run.table("scenarios")
    own = rows[rows["name"] == "exhaustive"].set_index("scenario")
    exact = costs([times], told=False)[0]
    # 100 particles cost about 1 / 100 more than the Kalman filter
    assert np.all(abs(own["expected_mse"] / 1.01 - exact) < 4 * own["standard_error"])
    error = own["standard_error"].max()
    assert combined(exact[None], criterion)[0] - of_sets.min() < 2 * error
    gap = {each.name: each for each in pfdist.bound(run, 480).gaps}["exhaustive"]
    told = combined(costs(SETS, told=True), criterion).min()
    assert gap.reason == ""
    assert gap.bound.value < told + 4 * gap.bound.standard_error
    assert gap.bound.value > 0.8 * told  # or the test could not fail


@pytest.mark.parametrize("criterion", ["mean", "worst"])
def test_the_exact_bound_is_that_of_brute_force_but_for_a_duality_gap(
    criterion: str, tmp_path: Path
) -> None:
    of_scenarios = costs(SETS, told=True) / SCALES
    best = combined(of_scenarios, criterion).min()
    run = pfdist.run(
        problem(criterion, engine="kalman", scales=SCALES).job(
            search=[{"method": "exhaustive"}], comparison={"draws": 100}
        ),
        tmp_path / "run",
        figures=False,
    )
    answer = pfdist.bound(run, progress=True)  # its exact errors take no particle-steps
    bound = {each.name: each for each in answer.gaps}["exhaustive"].bound.value
    if criterion == "mean":
        assert bound == pytest.approx(best, rel=1e-9)
        return
    # No weighting on a grid gives a larger bound, and no bound lies above the best worst case.
    steps = np.linspace(0.0, 1.0, 41)
    grid = [(a, b, 1 - a - b) for a in steps for b in steps if a + b <= 1.0]
    dual = max((of_scenarios @ np.array(shares)).min() for shares in grid)
    assert bound <= best * (1 + 1e-12)
    assert bound >= dual * (1 - 2e-3)
    assert sum(answer.shares) == pytest.approx(1.0)


@pytest.mark.plugins("runs")
def test_a_list_of_runs_names_the_best_set_as_the_run_does(tmp_path: Path) -> None:
    sets = {"early": (0, 1, 2, 3), "mean": (0, 8, 11, 12), "worst": (5, 6, 11, 12)}
    for criterion in ("mean", "worst"):
        best = combined(costs([*sets.values()], told=True), criterion).argmin()
        assert [*sets][best] == criterion
        asked, path = problem(criterion, engine="kalman"), tmp_path / criterion
        run = pfdist.compare(asked, times=sets, results=path, draws=120, figures=False)
        assert run.best.measurement_times == list(sets[criterion])
        assert pfdist.list_runs(path)["best"].tolist() == [criterion]


def test_the_best_of_several_sets_for_the_worst_is_chosen_by_draws(tmp_path: Path) -> None:
    """An exact engine knows the mean error, but errors of worst scenarios are those of draws."""
    searches = [{"method": "random", "name": f"s{k}", "evaluations": 2} for k in range(2)]
    job = problem("worst", engine="kalman").job(search=searches, comparison={"draws": 96})
    run = pfdist.run(job, tmp_path / "run", figures=False)
    worst = run.table("scenarios").groupby("name")["expected_mse"].max()
    assert results_of(run)["s0"].criterion_value == worst["s0"]
    assert run.best.name == worst[["s0", "s1"]].idxmin()
    said = " ".join(lines_of(answer_of(run)))
    assert "Picking the best of several makes it look slightly better" in " ".join(said.split())
    assert "known exactly" not in said


def test_a_nominal_filter_has_exact_errors() -> None:
    """The mean over scenarios of the filter that believes the nominal parameters, by draws."""
    sets = [(), (0, 4, 8, 11), (2, 3, 9, 10)]
    evaluator = build(problem(engine="kalman", filter="nominal").job()).evaluator
    exact, told = exact_mse(evaluator, sets), exact_mse(knowing_truth(evaluator), sets)
    assert exact is not None
    assert told is not None
    assert (exact[1:] > told[1:]).all()
    mse = evaluator(evaluator.work(sets, 1, 2, (0, 6000), Estimation(10))).mse
    assert np.abs((mse.mean(axis=0) - exact) / (mse.std(axis=0) / 6000**0.5)).max() < 3.5


def test_the_truth_in_the_cloud_of_a_told_filter_costs_no_more_than_the_kalman_filter() -> None:
    evaluator = knowing_truth(build(problem(filter="nominal", particles=30).job()).evaluator)
    draws = 200 * BLOCK
    work = FilterWork(((0, 6),), (HORIZON,), (5,), 9, (0, draws), with_truth(30))
    variance = evaluator.filtered(work).mse[:, 0]
    exact = combined(costs([(0, 6)], told=True), "mean")[0]
    error = variance.std() / np.sqrt(draws)
    assert 0.8 * exact < variance.mean() < exact + 4 * error


# --- the section ----------------------------------------------------------------------------------


def test_a_distribution_has_a_scenario_for_each_part_of_equal_probability() -> None:
    section = Scenarios(
        parameters={"k": {"uniform": (0.0, 8.0)}, "l": {"normal": (1.0, 2.0)}}, count=4
    )
    values = sorted(each.parameters["k"] for each in section.each)
    assert values == [1.0, 3.0, 5.0, 7.0]
    assert sum(each.share for each in section.each) == 1.0
    normal = sorted(each.parameters["l"] for each in section.each)
    quartile = 0.3186393639643752  # of a standard normal variate, 62.5 %: tables
    assert normal[2] == pytest.approx(1.0 + 2.0 * quartile)
    assert normal[1] == pytest.approx(1.0 - 2.0 * quartile)


def test_weights_become_shares() -> None:
    section = Scenarios(parameters=({"k": 1.0}, {"k": 2.0}), weights=(1.0, 3.0))
    assert section.each == (Scenario(0.25, {"k": 1.0}), Scenario(0.75, {"k": 2.0}))


@in_turn(
    ("section", "says"),
    [
        ({"parameters": [{"early": 1.0}, {"late": 1.0}]}, "must have the same parameters"),
        ({"parameters": SCENARIOS, "weights": [1.0]}, "a number for each of 3 scenarios, got 1"),
        ({"parameters": SCENARIOS, "scales": [1.0, 0.0, 1.0]}, "scenarios.scales"),
        ({"parameters": SCENARIOS, "count": 3}, "has no scenarios.count, got 3"),
        ({"parameters": {"early": {"normal": [1.0, 0.1]}}}, "need scenarios.count"),
        ({"parameters": {"early": {"normal": [1.0, -1.0]}}, "count": 3}, "sd and a median above 0"),
        ({}, "scenarios.parameters"),
    ],
)
def test_a_wrong_section_is_refused_in_a_line(section: dict[str, Any], says: str) -> None:
    with pytest.raises(JobError, match=says) as caught:
        problem().with_changes(scenarios=section)
    assert "\n" not in str(caught.value)


def test_an_unknown_parameter_is_refused_by_name() -> None:
    wrong = problem().with_changes(scenarios={"parameters": [{"erly": 1.0}]})
    with pytest.raises(ModelError, match=r"scenarios\.parameters: .*unknown parameter 'erly'"):
        build(wrong.job())


def test_the_worst_needs_searches_that_compare_whole_sets() -> None:
    with pytest.raises(JobError, match=r"needs searches that compare whole sets .*got corridor"):
        problem("worst").job(search=[{"method": "corridor"}])


@pytest.mark.plugins("budget", "filter", "online", "why")
def test_other_questions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="online needs no scenarios, or"):
        problem().job(online={})
    with pytest.raises(JobError, match=r"budget needs scenarios.criterion = 'mean', got 'worst'"):
        problem("worst").job(budget={"least": 3, "most": 5})
    worst = problem("worst", engine="kalman")
    few = ["comparison.draws=48"]
    pfdist.plan(worst, tmp_path / "run", changes=few, bound_draws=0, figures=False)
    with pytest.raises(JobError, match=r"^why needs scenarios.criterion = 'mean', got 'worst' "):
        pfdist.why(worst, results=tmp_path / "run", changes=few, figures=False)


@pytest.mark.plugins("online")
def test_a_planner_and_a_told_filter_are_refused() -> None:
    with pytest.raises(JobError, match=r"no scenarios, or scenarios.filter"):
        pfdist.Planner(problem(), times=[0, 3, 6, 9])


@pytest.mark.parametrize(
    ("scenario", "interval"),
    # Independent draws: 1 - exp(log(2 / 4) -+ 1.96 * hypot(0.01, 0.01))
    [(1, "49.0 to 51.0"), (0, "48.6 to 51.4")],
)
def test_the_answer_for_the_worst_names_its_error_and_its_gain(
    scenario: int, interval: str
) -> None:
    ends = {"gain_of_means_low": 0.49, "gain_of_means_high": 0.51}
    rows = [
        {"name": name, "scenario": number, "expected_mse": mse, "standard_error": 0.01 * mse} | ends
        for name, errors in (("found", (1.0, 2.0)), ("regular", (3.0, 3.0)))
        for number, mse in enumerate(errors)
    ]
    rows[2 + scenario] |= {"expected_mse": 4.0, "standard_error": 0.04}
    subject = SimpleNamespace(
        scenarios=[Row(**row) for row in rows],
        criterion=WorstScenario(),
        error="the expected MSE in the worst scenario",
        reference_row=Row(name="regular"),
        reference="evenly spaced times",
    )
    said = (
        f"The expected MSE in the worst scenario is 50.0 % lower (95 % CI {interval} %) than "
        "with evenly spaced times: 2.000 ± 0.020 instead of 4.000 ± 0.040."
    )
    assert criterion_effect(subject, Row(name="found", criterion_gain=None)) == said
