"""Answers of an exploration: against `pfdist.evaluate`, and intervals computed by hand."""

import contextlib
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import pfdist
from oracles.explored import SMALL, job_of
from oracles.in_turn import in_turn
from pfdist.common.estimate import Estimate
from pfdist.common.parsing import parse_toml
from pfdist.common.streams import CHOOSING, PROVING, stream_of
from pfdist.errors import JobError, MeasurementTimesError, PfdistError, StoreError
from pfdist.plugins.explorer import filtered
from pfdist.plugins.explorer.filtered import FilteredSets
from pfdist.plugins.explorer.session import ON_THESE_DRAWS, ExplorerSession, reply
from pfdist.results.moments import Pairs

MINE, OTHER = (1, 4, 6, 12), (0, 4, 8, 11)


def facts_of(session: ExplorerSession, times: tuple[int, ...], draws: int = 0) -> dict[str, str]:
    return dict(session.answer(times, draws)["facts"])


def own(fact: str) -> str:
    """Part of a fact that is about one's own times."""
    return fact.partition(";")[0].removeprefix("yours ")


# --- answers --------------------------------------------------------------------------------------


def test_an_answer_is_that_of_evaluate_on_the_same_draws() -> None:
    session = ExplorerSession(job_of())
    session.played = FilteredSets(session.built, stream_of("evaluate", session.job.seed))
    answer, facts = session.answer(MINE, 240), facts_of(session, MINE, 240)
    known = pfdist.evaluate(session.job, {"a": MINE}, draws=240, profile=True)["a"]
    assert known.profile is not None
    np.testing.assert_allclose(
        np.square(answer["curves"]["yours"][0]), known.profile["error"], rtol=1e-12
    )
    mean, error = map(float, own(facts["expected MSE"]).split(" ± "))
    assert mean == pytest.approx(known.expected_mse, abs=0.06 * known.standard_error)
    assert error == pytest.approx(known.standard_error, rel=0.05)
    assert float(own(facts["typical error"])) == pytest.approx(known.expected_mse**0.5, rel=0.005)


def test_the_gain_is_that_of_the_same_draws_with_its_interval() -> None:
    session = ExplorerSession(job_of())
    played = session.played
    mine, even = (played.errors(times, 480).mse for times in (MINE, session.even))
    ((head, text), *_) = session.answer(MINE, 480)["facts"]
    assert head == "against regular times"  # there is no plan
    is_unclear, value, side, low, high, amount, amount_error = re.fullmatch(  # type: ignore[union-attr]
        r"(no clear difference: )?([\d.]+) % (\w+) \(95 % CI (-?[\d.]+) to (-?[\d.]+) %\), "
        r"by ([\d.]+) ± ([\d.]+)",
        text,
    ).groups()
    gain = 100 * (1 - mine.mean() / even.mean()) * (1 if side == "lower" else -1)
    assert float(value) == pytest.approx(gain, abs=0.1)
    # The delta method agrees with Fieller's theorem where the errors are small.
    ratio = mine.mean() / even.mean()
    error = 100 * np.std(mine - ratio * even, ddof=1) / even.mean() / 480**0.5
    assert float(high) - float(low) == pytest.approx(2 * 1.965 * error, rel=0.1)
    assert bool(is_unclear) == (float(low) <= 0 <= float(high))
    apart = mine - even  # draw by draw
    assert float(amount) == pytest.approx(abs(apart.mean()), abs=0.06 * apart.std() / 480**0.5)
    assert float(amount_error) == pytest.approx(apart.std(ddof=1) / 480**0.5, rel=0.05)


def test_numbers_that_stand_together_are_of_the_same_draws(small_run: pfdist.Run) -> None:
    """So the mean of few draws never looks like an improvement over that of many before it."""
    session = ExplorerSession(small_run)
    sets = (MINE, session.plan, session.even)
    session.answer(session.plan, 3840)  # what a user has seen before the move
    answer = session.answer(MINE, 120)
    heads, texts = zip(*answer["facts"], strict=True)
    assert heads[:5] == (
        "against the plan",
        "against regular times",
        "expected MSE",
        "typical error",
        "MSE afterwards",
    )
    afterwards = next(iter(session._beside.values())).errors(MINE, 24)
    value, error = map(float, re.findall(r"yours ([\d.]+) ± ([\d.]+)", texts[4])[0])
    assert value == pytest.approx(afterwards.mse.mean(), abs=0.06 * error)
    assert value < session.played.errors(MINE, 24).mse.mean()
    means = [session.played.errors(times, 120).mse.mean() for times in sets]
    shown = re.findall(r"(yours|the plan|regular times) ([\d.]+) ± ([\d.]+)", texts[2])
    assert [name for name, *_ in shown] == ["yours", "the plan", "regular times"]
    for mean, (_, value, error) in zip(means, shown, strict=True):
        assert float(value) == pytest.approx(mean, abs=0.06 * float(error))
    for text, other in zip(texts, means[1:], strict=False):
        assert ("lower" if means[0] < other else "higher") in text
    assert dict(session.answer(session.plan)["facts"])["against the plan"] == "the same times"


def test_further_draws_give_the_bits_of_one_computation() -> None:
    in_steps, at_once = ExplorerSession(job_of()), ExplorerSession(job_of())
    for draws in (48, 120, 336):
        in_steps.answer(MINE, draws)
    assert in_steps.answer(MINE, 336) == at_once.answer(MINE, 336)
    again = in_steps.answer(MINE, 120)
    assert again == ExplorerSession(job_of()).answer(MINE, 120) | {"finer": again["finer"]}


def test_nothing_is_computed_twice_and_old_sets_are_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session, computed = ExplorerSession(job_of()), list[tuple[int, ...]]()
    original = FilteredSets._computed
    monkeypatch.setattr(
        FilteredSets, "_computed", lambda self, times, *args: (
            computed.append(times) if self is session.played else None,
            original(self, times, *args))[1],
    )  # fmt: skip
    session.answer(MINE, 48)
    session.answer(MINE, 48)
    session.answer(MINE, 24)
    assert sorted(computed) == sorted([MINE, session.even])
    one_set = 48 * 13 * 8
    monkeypatch.setattr(filtered, "MOST_BYTES", 2 * one_set)
    session.answer(OTHER, 48)  # forgets MINE, which was used before the reference
    session.answer(MINE, 48)
    assert computed[2:] == [OTHER, MINE] or computed[2:] == [OTHER, session.even, MINE]


def test_the_first_draws_of_a_fast_model_are_480_and_those_of_a_slow_one_fewer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert ExplorerSession(job_of("filter.particles=5")).first_draws == 480
    monkeypatch.setattr(FilteredSets, "seconds_a_draw", lambda *_: 0.001)
    slow = ExplorerSession(job_of())
    assert slow.first_draws == 72
    assert slow.answer(MINE)["draws"] == 72
    assert slow.answer(MINE)["finer"] == 144
    assert slow.answer(MINE, 10_000)["draws"] == 16 * 72
    assert slow.answer(MINE, 10_000)["finer"] is None


def test_an_exact_engine_is_exact() -> None:
    job = job_of("model.name=random_walk", "filter.engine=kalman")
    session = ExplorerSession(job)
    answer = session.answer(MINE)
    known = pfdist.evaluate(job, {"a": MINE}, profile=True)["a"]
    assert known.profile is not None
    assert answer["mark"] == "exact"
    assert answer["finer"] is None
    np.testing.assert_allclose(
        np.square(answer["curves"]["yours"][0]), known.profile["error"], rtol=1e-12
    )
    session.judge("a", MINE)
    (only,) = session.judge("b", OTHER)[1:]  # an exact gain needs no second judgement
    assert only["interval"] == [only["gain"]] * 2


def test_weights_leave_the_curve_in_the_unit_of_z() -> None:
    weights = [2.0, *[1.0] * 11, 0.0]
    plain, weighted = (
        ExplorerSession(job_of()),
        ExplorerSession(job_of(f"problem.instant_weights={weights}")),
    )
    same = [session.answer(MINE, 48)["curves"]["yours"] for session in (plain, weighted)]
    assert same[0] == same[1]
    assert facts_of(plain, MINE, 48)["expected MSE"] != facts_of(weighted, MINE, 48)["expected MSE"]


def test_a_late_value_is_a_point_when_it_arrives() -> None:
    """The points 5 and 6 are measured at t = 3 and 4; 0 and 1 would have been measured before 0."""
    late = ExplorerSession(job_of("problem.sensor.delay=2", "problem.forbidden=[9]"))
    state = late.state()
    assert ([*state["delays"]], [*state["forbidden"]]) == ([2], [0, 1, 11])
    assert "mine=3,4" in late.command_line({"mine": [5, 6]})
    late.played = FilteredSets(late.built, stream_of("evaluate", late.job.seed))
    known = pfdist.evaluate(late.job, {"a": (3, 4)}, draws=240)["a"].expected_mse
    found = float(own(facts_of(late, (5, 6), 240)["expected MSE"]).split(" ± ")[0])
    assert found == pytest.approx(known, rel=0.02)


def test_the_worst_scenario_decides() -> None:
    scenarios = "scenarios={parameters=[{step_sd=1.0}, {step_sd=9.0}], criterion='worst'}"
    model = "model.name=random_walk"
    search = "search=[{method='genetic'}]"
    session = ExplorerSession(job_of(model, scenarios, search))
    known = pfdist.evaluate(session.job, {"a": MINE}, draws=480)["a"]
    facts = facts_of(session, MINE, 480)
    value, error = map(float, own(facts["expected MSE"]).split(" ± "))
    assert value == pytest.approx(known.expected_mse, abs=5 * (error + known.standard_error))
    assert value > 1.5 * known.mse.mean()  # that of both scenarios
    assert float(own(facts["typical error"])) == pytest.approx(value**0.5, rel=0.02)


def test_broken_constraints_are_named(
    session: ExplorerSession, of_sensors: ExplorerSession
) -> None:
    broken = session.answer((0, 7, 8))["broken"]
    assert [each.partition(" ")[0] for each in broken] == [
        "measurement_budget", "forbidden:", "required:", "minimum_spacing"
    ]  # fmt: skip
    assert session.answer(session.even)["broken"] == []
    (forbidden,) = of_sensors.answer((0, 10, 20, 30))["broken"]
    assert forbidden == "forbidden: 3 far is measured"


def test_times_that_are_none_are_refused(session: ExplorerSession) -> None:
    with pytest.raises(MeasurementTimesError, match=r"must lie in 0..12, got 13"):
        session.answer((13,))
    with pytest.raises(MeasurementTimesError, match="got 1 twice"):
        session.answer((1, 1))


# --- a run ----------------------------------------------------------------------------------------


@pytest.mark.plugins("why")
def test_a_run_shows_its_plan_its_bound_and_its_windows(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    changes = "model.name=random_walk", "filter.particles=20", "comparison.draws=300"
    quick = "search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"
    run = pfdist.open_run(shutil.copytree(finished(*quick, *changes, proved=960), tmp_path / "run"))
    pfdist.why(run, draws=40, figures=False)
    session = ExplorerSession(run)
    state, best = session.state(), run.best
    assert [*state["plan"]] == best.measurement_times
    assert {int(each) for each in state["windows"]} == {*state["plan"]}
    assert all(int(m) in inside for m, inside in state["windows"].items())
    gap, error, bound = re.fullmatch(  # type: ignore[union-attr]
        r"([\d.]+) ± ([\d.]+) % \(bound ([\d.]+) ± [\d.]+\)",
        facts_of(session, state["plan"])["gap to the bound"],
    ).groups()
    assert float(bound) == pytest.approx(best.bound, abs=0.06 * best.bound_error)
    # At the plan it is the gap of the run, on no other draws.
    assert float(gap) == pytest.approx(100 * best.bound_gap, abs=0.06 * float(error))
    assert 100 * (best.bound_gap_at_most - best.bound_gap) > 1.6 * float(error)  # one-sided 95 %
    assert "gap to the bound" not in facts_of(session, (1, 2, 3))  # of another number
    assert "against the plan" in facts_of(session, MINE)
    assert ExplorerSession(str(run.path)).plan == session.plan


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (Estimate(1.0), "10.0 ± 3.0 %"),
        # 1 - 0.9 / 1.2; its error by the delta method: sqrt(0.03^2 + (0.75 * 0.048)^2) / 1.2
        (Estimate(1.2, 0.048), "25.0 ± 3.9 %"),
        (Estimate(0.91, 0.01), "not above its error, 3.5 %"),  # 1.1 %
        (Estimate(0.5), "not above its error, 6.0 %"),  # below the bound: nothing is cut off at 0
    ],
)
def test_no_gap_below_its_own_error_is_shown(
    session: ExplorerSession, monkeypatch: pytest.MonkeyPatch, ratio: Estimate, said: str
) -> None:
    zero = {"filter_model": 0.0, "filter_model_error": 0.0}
    proof = {"expected_mse": 20.0, "bound": 18.0, "bound_error": 0.5, "reason": "", **zero}
    parts = {"relaxation": 1.5, "relaxation_error": 0.36, "estimate": 0.5, "estimate_error": 0.48}
    monkeypatch.setattr(session, "_proof", proof | parts)
    assert session._gap(ratio) == f"{said} (bound 18.00 ± 0.50)"
    exact = dict.fromkeys(("relaxation_error", "estimate_error", "bound_error"), 0.0)
    monkeypatch.setattr(session, "_proof", proof | parts | exact)
    assert session._gap(Estimate(0.9)) == "none (bound 18.000)"  # 1 - 0.9 / 0.9 is not exactly 0


def test_with_a_plan_sets_are_judged_against_it(small_run: pfdist.Run) -> None:
    session = ExplorerSession(small_run)
    stream = stream_of("judge", session.job.seed, 0, MINE)
    work = session.built.evaluator.work(
        (MINE, session.plan), stream, stream, (0, session.judging_draws), session.built.comparing
    )
    mine, plan = session.built.evaluator(work).mse.T
    (row,) = session.judge("mine", MINE)
    assert row["gain"] == pytest.approx(1 - mine.mean() / plan.mean(), rel=1e-12)
    with pytest.raises(JobError, match="these are the times of the plan"):
        session.judge("plan", session.plan)
    plan = ",".join(map(str, session.plan))
    expected = f" --times regular --times plan={plan} --times mine=1,4,6,12"
    assert session.command_line({"mine": MINE}).endswith(expected)


def test_evenly_spaced_times_of_a_run_have_that_name(small_job: pfdist.Job, tmp_path: Path) -> None:
    """Without them, regular times are shown by their own name."""
    changes = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=2"]
    changes += ["comparison.reference='evenly spaced'", "problem.horizon=11"]
    session = ExplorerSession(
        pfdist.run(small_job, tmp_path / "run", changes=changes, figures=False)
    )
    assert session.even != session.feasible.regular()
    assert session.state()["even_label"] == "evenly spaced"
    assert "against evenly spaced" in facts_of(session, OTHER)
    even = ",".join(map(str, session.even))
    assert f" --times even={even} --times plan=" in session.command_line({"mine": OTHER})


def test_a_job_file_finds_its_run(finished: Callable[..., Path], tmp_path: Path) -> None:
    shutil.copytree(finished(), tmp_path / "results" / "small")
    (tmp_path / "jobs").mkdir()
    job = shutil.copy(Path(__file__).parents[2] / "small.toml", tmp_path / "jobs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        assert ExplorerSession(job).plan is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path / "jobs")
        assert ExplorerSession("small.toml").plan is None


def test_an_unfinished_run_is_refused(small_run: pfdist.Run) -> None:
    shutil.rmtree(small_run.path / "tables" / "comparison")
    with pytest.raises((StoreError, PfdistError)):
        ExplorerSession(small_run.path)


@pytest.mark.plugins("why")
def test_a_calendar_gives_dates(tmp_path: Path) -> None:
    clock = "{start=2026-03-28T08:00:00, step='6 h', timezone='Europe/Brussels'}"
    sections = {"problem": {"horizon": "2026-03-31T09:00:00", "measurement_budget": 3}}
    exact = ["model.name=random_walk", "filter.engine=kalman", "search=[{method='exhaustive'}]"]
    job = pfdist.load_job(SMALL, [f"problem.clock={clock}", *exact], sections)
    run = pfdist.run(job, tmp_path / "run", figures=False)
    pfdist.why(run, figures=False)
    session = ExplorerSession(run)
    state = session.state()
    assert state["labels"][:4] == [  # summer time begins in the night to 29 March
        "2026-03-28T08:00", "2026-03-28T14:00", "2026-03-28T20:00", "2026-03-29T03:00"
    ]  # fmt: skip
    assert state["unit"] == ""
    assert {*map(int, state["windows"])} == {*(session.plan or ())}
    (judged,) = session.judge("a", (0, 5, 9))
    assert judged["written"] == "2026-03-28T08:00, 2026-03-29T15:00, 2026-03-30T15:00"
    file = tmp_path / "explored.toml"
    file.write_text(session.job_text({"a": (0, 5, 9)}))
    assert pfdist.load_job(file).given_sets["a"] == (0, 5, 9)


# --- judging --------------------------------------------------------------------------------------


def test_the_draws_of_play_judge_nothing() -> None:
    assert "explore" in CHOOSING
    assert "judge" in PROVING
    session = ExplorerSession(job_of())
    assert session.answer(MINE)["mark"].startswith(ON_THESE_DRAWS)
    assert session.answer(MINE)["mark"].endswith("press Judge for a fair comparison")
    session.judge("mine", MINE)
    assert session.answer(MINE)["mark"].endswith("judged on fresh draws below")
    assert session.answer(OTHER)["mark"].endswith("press Judge for a fair comparison")


def test_judgements_have_draws_of_their_own_and_simultaneous_intervals() -> None:
    session = ExplorerSession(job_of("comparison.draws=250"))
    seed, even = session.job.seed, session.even

    def by_hand(number: int, times: tuple[int, ...], judged: int) -> tuple[float, ...]:
        stream = stream_of("judge", seed, number, times)
        evaluator = session.built.evaluator
        work = evaluator.work((times, even), stream, stream, (0, 250), session.built.comparing)
        own, reference = evaluator(work).mse.T
        errors = Pairs()
        errors.add(own, reference)
        low, high = errors.ratio_interval(1 - 0.05 / judged)
        return 1 - own.mean() / reference.mean(), 1 - high, 1 - low

    (first,) = session.judge("mine", MINE)
    assert (first["gain"], *first["interval"]) == pytest.approx(by_hand(0, MINE, 1), rel=1e-12)
    rows = session.judge("other", OTHER)
    best = max(rows[:2], key=lambda row: row["gain"])
    assert [row["again"] for row in rows] == [False, False, True]
    assert rows[2]["times"] == best["times"]
    sets = (MINE, OTHER, tuple(best["times"]))
    for number, (row, times) in enumerate(zip(rows, sets, strict=True)):
        assert (row["gain"], *row["interval"]) == pytest.approx(
            by_hand(number, times, 3), rel=1e-12
        )
    assert rows[0]["interval"][0] < first["interval"][0]  # the first has widened
    assert len(session.judge("other again", OTHER)) == 4  # the best was judged twice already


def test_the_reference_is_not_judged(session: ExplorerSession) -> None:
    with pytest.raises(JobError, match="these are regular times"):
        session.judge("even", session.even)


def test_intervals_of_judgements_hold_together() -> None:
    """At most 5 % of users who judge four sets may find an interval without the true gain.

    More than 8 of 40 users would have a probability below 1e-4.
    """
    job = job_of("model.name=random_walk", "filter.particles=20", "comparison.draws=40")
    many = FilteredSets(ExplorerSession(job).built, stream_of("evaluate", 99))
    sets = [MINE, OTHER, (2, 5, 8, 11), (3, 6, 9, 12)]
    even = job.problem.feasible.regular()
    means = [each.expected_mse for each in many.evaluations([*sets, even], 20_000)]
    true = [1 - mean / means[-1] for mean in means]
    missed = 0
    for seed in range(40):
        user = ExplorerSession(job.with_changes(settings={"seed": seed}))
        for number, times in enumerate(sets):
            user.judge(str(number), times)
        rows = [row for row in user.judgements() if not row["again"]]
        missed += any(
            not row["interval"][0] <= gain <= row["interval"][1]
            for row, gain in zip(rows, true, strict=False)
        )
    assert missed <= 8


# --- what the user takes away ---------------------------------------------------------------------


def test_the_job_and_the_command_have_the_sets(
    session: ExplorerSession, of_sensors: ExplorerSession, tmp_path: Path
) -> None:
    file = tmp_path / "explored.toml"
    file.write_text(session.job_text({"mine": MINE}))
    assert pfdist.load_job(file).given_sets["mine"] == MINE
    assert pfdist.load_job(file).problem == session.job.problem
    named = parse_toml(of_sensors.job_text({"mine": (0, 4)}))["comparison"]["sets"]
    assert named["mine"] == ["0 near", "1 far"]
    path = session.job.path
    expected = f"pfdist compare {path} --times regular --times mine=1,4,6,12"
    assert session.command_line({"mine": MINE}) == expected
    assert of_sensors.command_line({"mine": (0, 4)}).startswith("pfdist.compare(problem, times=")


@pytest.mark.parametrize("name", ["<img src=x onerror=alert(1)>", "regular"])
def test_a_name_that_no_job_may_have_is_refused(session: ExplorerSession, name: str) -> None:
    answer = reply(session, {"ask": "take", "sets": {name: [1, 2]}, "id": 7})
    assert answer.keys() == {"id", "ask", "error"}
    assert "comparison.sets" in answer["error"]


@in_turn(
    "message",
    [
        None, 3, [], {}, {"ask": "no"}, {"ask": "answer", "times": None},
        {"ask": "answer", "times": "0"}, {"ask": "answer", "times": [1.5]},
        {"ask": "judge", "times": [99]}, {"ask": "take", "sets": 3}, {"ask": "take", "sets": [1]},
        {"ask": "answer", "times": [True]},
    ],
)  # fmt: skip
def test_a_message_that_is_none_is_answered_with_one_line(
    session: ExplorerSession, message: object
) -> None:
    answer = reply(session, message)
    assert "\n" not in answer["error"]
    assert answer["error"]


@pytest.mark.parametrize("error", [MemoryError(), KeyboardInterrupt(), ZeroDivisionError("a\nb")])
def test_a_message_is_answered_whatever_it_causes(error: BaseException) -> None:
    def answer(_: object, __: int) -> None:
        raise error

    found, session = dict[str, object](), cast("ExplorerSession", SimpleNamespace(answer=answer))
    with contextlib.suppress(KeyboardInterrupt):  # it would end pytest
        found = reply(session, {"ask": "answer", "id": "v-1"})
    assert str(found.pop("error", "")).startswith(f"{type(error).__name__}: ")
    assert found == {"id": "v-1", "ask": "answer"}


# --- the widget -----------------------------------------------------------------------------------


@pytest.mark.needs("explore")
def test_the_widget_answers_messages() -> None:
    widget = pfdist.explore(job_of())
    sent: list[dict[str, object]] = []
    widget.send = sent.append
    widget._handle_custom_msg({"ask": "answer", "times": [*MINE], "id": "v-1"}, [])
    assert sent == [reply(widget.session, {"ask": "answer", "times": [*MINE], "id": "v-1"})]
    assert "export default" in str(widget._esm)


def test_without_the_extra_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, call: Callable[..., object]
) -> None:
    from pfdist.plugins.explorer import widget

    monkeypatch.setitem(sys.modules, "anywidget", None)
    widget._widget_class.cache_clear()
    with pytest.raises(PfdistError, match=r"pip install -e '.\[explore\]'"):
        pfdist.explore(job_of())
    monkeypatch.delitem(sys.modules, "pfdist.plugins.explorer.server", raising=False)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    code, out, error = call(f"explore {Path(__file__).parents[2] / 'small.toml'}")  # type: ignore[misc]
    assert (code, out) == (1, "")
    assert error == "pfdist: explore needs pip install -e '.[explore]', got no uvicorn\n"
