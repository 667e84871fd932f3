"""`check-model` returns soon for slow models, and checks a job's filter as the job uses it."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.three_sensors import HORIZON, ThreeSensors
from pfdist import Problem, StateSpaceModel, load_model, ode, sde
from pfdist.common.measurement_times import regular
from pfdist.common.sensing import Sensing
from pfdist.errors import MeasurementsError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.kalman import expected_mse
from pfdist.filters.work import Estimation
from pfdist.models.sensed import sensed
from pfdist.plugins.check import model_checks as checks_of_models
from pfdist.plugins.check.model_checks import Check, check_loaded
from pfdist.plugins.check.question import checks_of

WALK = load_model("random_walk")


def checked(model: StateSpaceModel, horizon: int, particles: int) -> dict[str, Check]:
    return {check.name: check for check in check_loaded(lambda: model, horizon, particles)}


def takes(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a draw of 500 particles at 13 instants take so long."""
    monkeypatch.setattr(checks_of_models, "seconds_a_step", lambda *_: seconds / (500 * 13))


def test_a_slow_model_has_fewer_draws_and_its_checks_say_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A check takes about 20 s: four filters of each draw, so 20 draws of 0.25 s."""
    takes(0.24, monkeypatch)
    checks = checked(WALK, 12, 500)
    says = r"0\.00% of draws with 4 regular times .* \(only 20 draws: each takes 0\.24 s\)"
    assert re.fullmatch(says, checks["degenerate draws"].text), checks["degenerate draws"]
    assert checks["expected MSE"].state == "ok"
    assert checks["particles"].text.startswith("500 particles lose ")
    assert "particles after 4 measurements" in checks["effective sample size"].text


def test_of_a_model_that_is_too_slow_nothing_is_filtered_but_the_time_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    takes(2.6, monkeypatch)
    checks = checked(WALK, 12, 500)
    assert "degenerate draws" not in checks
    assert (checks["an evaluation"].state, checks["an evaluation"].text) == (
        "note",
        "2600 s for 1,000 draws on one core; so nothing else is filtered here",
    )


@pytest.mark.parametrize(
    ("seconds", "says"),
    [(1e-5, "; 500 are enough"), (0.4, "; no more, up to 20,000, can be tried in 20 s")],
)
def test_more_particles_are_tried_only_if_there_is_time(
    seconds: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    takes(seconds, monkeypatch)
    check = checked(WALK, 12, 5)["particles"]
    assert check.state == "note"
    assert check.text.endswith(says), check.text


def test_long_horizons_have_fewer_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks_of_models, "_MOST_STEPS", 1000)
    checks = checked(WALK, 12, 100)
    assert checks["simulate"].text == "x, y and z are finite in 76 draws of 13 instants"
    assert checks["every instant"].state == "ok"


# --- the filter of a job --------------------------------------------------------------------------


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """No larger numbers of particles are tried."""
    monkeypatch.setattr(checks_of_models, "enough_particles", lambda *given: given[-1])


def by_name(problem: Problem | Path) -> dict[str, tuple[str, str]]:
    """State and text of each check; of a name that comes again, the last."""
    rows = pfdist.check_model(problem).itertuples()
    return {row.check: (row.state, row.text) for row in rows}


def estimated(text: str) -> tuple[float, float]:
    """Value and standard error of a text like "1.68 ± 0.02 with these times"."""
    value, _, error, *_ = text.split()
    return float(value), float(error)


def test_a_job_is_checked_at_its_own_regular_times() -> None:
    problem = Problem(WALK, horizon=12, measurement_budget=3, forbidden=range(9), particles=500)
    checks = by_name(problem)
    times = problem.job().problem.feasible.regular()
    assert checks["degenerate draws"][1] == (
        "0.00% of draws with 3 regular times and 500 particles"
    )
    mse, error = estimated(checks["expected MSE"][1])
    assert mse == pytest.approx(expected_mse(WALK, 12, [times])[0], abs=4 * error)


@pytest.mark.usefixtures("soon")
def test_the_sensors_of_a_job_are_filtered_together_and_once() -> None:
    system = ThreeSensors(0.4, 0.95, 0.5, ((1, 0), (0, 1), (1, 1)), (0.6, 0.5, 0.7))
    costs: dict[str, Any] = {name: {"price": cost} for name, cost in zip(
        ("near", "far", "both"), (1, 2, 3), strict=True
    )}  # fmt: skip
    problem = Problem(
        system.as_model(), horizon=HORIZON, total_price=9, sensors=costs, particles=500
    )
    table = pfdist.check_model(problem)
    names, texts = table["check"].tolist(), dict(zip(table["check"], table["text"], strict=True))
    assert names.count("log_likelihood") == 3
    assert names.count("particles") == names.count("expected MSE") == 1
    times = problem.job().problem.feasible.regular()
    assert f"with {len(times)} regular times" in texts["degenerate draws"]
    mse, error = estimated(texts["expected MSE"])
    assert mse == pytest.approx(system.expected_mse(times), abs=4 * error)


@pytest.mark.usefixtures("soon")
def test_sensors_without_a_job_measure_in_turn() -> None:
    system = ThreeSensors(0.4, 0.95, 0.5, ((1, 0), (0, 1), (1, 1)), (0.6, 0.5, 0.7))
    found = list(check_loaded(system.as_model, HORIZON, 500))
    assert [check.name for check in found].count("particles") == 1
    (cost,) = (check.text for check in found if check.name == "expected MSE")
    mse, error = estimated(cost)
    times = (0, 4 * 3 + 1, 8 * 3 + 2, 12 * 3)
    assert mse == pytest.approx(system.expected_mse(times), abs=4 * error)


@pytest.mark.usefixtures("soon")
def test_a_job_whose_filter_has_another_model_has_one_loss_on_its_own_draws() -> None:
    """A filter with less process noise than the truth; the loss is that of its own model."""
    wrong = replace(WALK, parameters={**WALK.parameters, "step_sd": 0.3})
    keys: dict[str, Any] = {"horizon": 12, "measurement_budget": 4, "particles": 100}
    checks = by_name(Problem(WALK, filter_model=wrong, **keys))
    alone = by_name(Problem(wrong, **keys))
    assert {"log_likelihood", "filter: log_likelihood"} < set(checks)
    assert "filter: particles" not in checks
    assert checks["effective sample size"] == alone["effective sample size"]
    (truth, error), (own, own_error) = (
        estimated(each["expected MSE"][1]) for each in (checks, alone)
    )
    assert truth - own > 4 * np.hypot(error, own_error)


def test_a_wrong_formula_of_the_filters_model_ends_the_checks_of_a_job() -> None:
    wrong = replace(WALK, transition=lambda x, t, w, p: (x[0] / 0.0 + w[0],))
    problem = Problem(WALK, filter_model=wrong, horizon=12, measurement_budget=4)
    assert "expected MSE" not in by_name(problem)


def test_what_only_the_job_shows_is_a_row_of_the_checks() -> None:
    problem = Problem(
        WALK, horizon=12, measurement_budget=4, scenarios={"parameters": [{"steps": 1.0}]}
    )
    state, text = by_name(problem)["filter"]
    assert state == "wrong"
    assert "scenarios.parameters: model random_walk: unknown parameter 'steps'" in text


def test_a_job_that_finds_its_number_of_particles_is_checked_with_the_usual_number() -> None:
    checks = by_name(Problem(WALK, horizon=12, measurement_budget=4, particles="auto"))
    assert checks["particles"][1].startswith("500 particles lose ")


def test_a_job_with_the_kalman_filter_has_no_particles() -> None:
    problem = Problem(WALK, horizon=12, measurement_budget=4, engine="kalman")
    checks = by_name(problem)
    assert checks["degenerate draws"] == ("ok", "0.00% of draws with 4 regular times")
    assert not {"particles", "effective sample size"} & set(checks)
    mse, error = estimated(checks["expected MSE"][1])
    exact = expected_mse(WALK, 12, [problem.job().problem.feasible.regular()])[0]
    assert mse == pytest.approx(exact, abs=4 * error)


# --- differential equations -----------------------------------------------------------------------


def stiff(substeps: int) -> StateSpaceModel:
    """A level that returns to 1 at a rate that varies between draws, and is seldom high."""
    level = ode(lambda x, t, p: (x[1] * (1.0 - x[0]), 0.0), substeps=substeps)
    return replace(
        WALK,
        name="stiff",
        initial=lambda w, p: (1.0 + 0.3 * w[0], np.minimum(np.exp(0.8 * w[1]), 8.6)),
        transition=lambda x, t, w, p: (level(x, t, (), p)[0] + 0.3 * w[0], x[1]),
        initial_noise=("normal", "normal"),
        parameters={**WALK.parameters, "measurement_sd": 0.2},
        x_names=(),
        linear_gaussian=False,
    )


def on_substeps(model: StateSpaceModel, **others: Any) -> tuple[str, str]:
    """State and text of the check of sub-steps; those behind it are not computed."""
    keys: dict[str, Any] = {"horizon": 20, "measurement_budget": 7, "particles": 100}
    checks = checks_of(Problem(model, **keys, **others))
    return next((each.state, each.text) for each in checks if each.name == "substeps")


def test_steps_that_are_too_long_for_rare_draws_are_found() -> None:
    """Runge and Kutta's method is unstable beyond 2.785 rates a step (Hairer, Wanner, IV.2).

    Rates above 8.355 have a probability of 0.4 %. The change is that of a model with twice the
    steps on the same draws.
    """
    state, text = on_substeps(stiff(3))
    assert (state, "give twice the substeps=" in text) == ("note", True), text
    evaluators = [Evaluator(stiff(substeps), 20) for substeps in (3, 6)]
    work = evaluators[0].work((regular(20, 7),), 3, 3, (0, 1000), Estimation(100))
    few, many = (each(work).mse.mean() for each in evaluators)
    change, _ = estimated(text.partition(" by ")[2])
    assert change == pytest.approx(100 * (many / few - 1), abs=0.5)  # as many digits as it has
    state, text = on_substeps(stiff(12))
    assert (state, "give" in text) == ("ok", False), text


def test_the_brownian_motions_of_an_equation_are_the_same_with_more_steps() -> None:
    """A walk in continuous time has the same states with any steps, as truth and in the filter."""
    flow = sde(lambda x, t, p: (0.0,), lambda x, t, p: (p.step_sd,), noises=1, substeps=4)
    model = replace(WALK, transition=flow, process_noise=flow.process_noise)
    state, text = on_substeps(model, filter_model=replace(model, name="own"))
    assert state == "ok"
    assert "x by 0.0 % of its standard deviation (root mean square; at most 0 %)" in text


def test_a_right_model_whose_sensor_fails_is_right() -> None:
    """A failed measurement lacks both components of y, which the model need not take one by one."""
    model = StateSpaceModel(
        name="pair",
        initial=lambda w, p: (w[0], w[1]),
        transition=lambda x, t, w, p: (0.9 * x[0] + w[0], 0.5 * x[1] + w[1]),
        measurement=lambda x, t, v, p: (x[0] + v[0], x[1] + v[1]),
        log_likelihood=lambda y, x, t, p: (
            -0.5 * ((y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2) - np.log(2 * np.pi)
        ),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal", "normal"),
        normalised=True,
    )
    problem = Problem(model, horizon=6, measurement_budget=2, particles=100, sensor={"fails": 0.2})
    found = by_name(problem)
    assert "missing components" not in found
    assert not [name for name in found if name.startswith("filter: ")]  # it is the same model
    assert not [name for name, (state, _) in found.items() if state == "wrong"], found
    with_nan = replace(model, missing_components=True)  # its log_likelihood takes no NaN
    state, text = by_name(problem.with_changes(model=with_nan))["missing components"]
    assert (state, text.startswith("where y[0] is missing")) == ("wrong", True)
    failing = sensed(model, {"": Sensing(fails=0.2)})
    with pytest.raises(MeasurementsError, match="all components of y must be measured or none"):
        pfdist.Filter(failing, 10, engine="numpy").update(0, [0.3, np.nan])
