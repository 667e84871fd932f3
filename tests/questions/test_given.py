"""A standard error that comes with each reading, in a column of the table: [problem.given]."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal

import pfdist
from oracles.in_turn import in_turn
from pfdist import StateSpaceModel
from pfdist.densities import normal_logpdf
from pfdist.errors import JobError, MeasurementsError, ModelError, PfdistWarning
from pfdist.problem.problem import as_job

pytestmark = pytest.mark.plugins("backtest", "check", "filter", "fit", "online", "simulate")

U = [0.3, 0.5, 0.1]
Y = [1.1, 0.4, 0.9]


def _problem(u: Any = (0.2,), sd: float = 1.0, **more: Any) -> pfdist.Problem:
    """The problem of a plan for the constant."""
    job = {"horizon": 6, "measurement_budget": 2, "engine": "kalman", "given": {"u": "error"}}
    return pfdist.Problem(_constant(u, sd), **{**job, **more})


def _constant(u: Any, sd: float = 1.0) -> StateSpaceModel:
    """A constant, N(0, sd^2), read with the error u: conjugate, so that its posterior is known."""
    model = StateSpaceModel(
        name="constant",
        initial=lambda w, p: (p.sd * w[0],),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (x[0] + p.u[t] * v[0],),
        log_likelihood=lambda y, x, t, p: normal_logpdf(y[0], x[0], p.u[t]),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=(),
        measurement_noise=("normal",),
        parameters={"u": (0.2,), "sd": 1.0},
        normalised=True,
        linear_gaussian=True,
    )
    return model.with_parameters({"u": u, "sd": sd})


def _posterior(u: list[float]) -> tuple[float, float]:
    precision = 1 + sum(1 / each**2 for each in u)
    mean = sum(y / each**2 for y, each in zip(Y, u, strict=True)) / precision
    return mean, 1 / math.sqrt(precision)


@pytest.mark.parametrize("u", [(0.2,), [0.2] * 7])
def test_each_reading_is_weighed_by_its_own_error(u: Any, tmp_path: Path) -> None:
    """Gelman et al., Bayesian Data Analysis, section 2.5: precisions add up."""
    table = pd.DataFrame({"t": [0, 2, 5], "y0": Y, "error": U})
    table.to_csv(tmp_path / "rows.csv", index=False)
    for source in (table, tmp_path / "rows.csv"):
        found = pfdist.filter_measurements(_problem(u), source, report=False)
        last = found.table.iloc[-1]
        assert [last["mean_0"], last["sd_0"]] == pytest.approx(_posterior(U), rel=1e-12)
    plain = pfdist.filter_measurements(_problem([0.2] * 7, given=None), table.drop(columns="error"))
    assert plain.table["mean_0"].iloc[-1] == pytest.approx(_posterior([0.2] * 3)[0], rel=1e-12)


def test_a_filter_of_one_system_takes_them_with_each_reading() -> None:
    """The same posterior, measurement by measurement; the smoothed estimate agrees with it."""
    model = _constant([0.2] * 7)
    for engine, tolerance in (("kalman", 1e-12), ("compiled", 0.05)):
        filtering = pfdist.Filter(model, particles=20_000, engine=engine, horizon=6)
        for t, y, u in zip((0, 2, 5), Y, U, strict=True):
            filtering.update(t, y, u=u)
        mean, sd = _posterior(U)
        assert filtering.now.mean[0] == pytest.approx(mean, abs=tolerance)
        assert filtering.now.standard_deviation[0] == pytest.approx(sd, rel=2 * tolerance)
        assert filtering.smoothed()[0].mean[0] == pytest.approx(mean, abs=tolerance)
    with pytest.raises(MeasurementsError, match="sd must be a parameter of the model with a value"):
        filtering.update(6, 1.0, sd=0.1)


@in_turn("clock", [None, range(7)])
def test_a_single_value_holds_at_each_instant(clock: Any) -> None:
    """As in a job: the readings without an error of their own have the model's."""
    single, every = _constant((0.2,)), _constant([0.2] * 7)
    if clock:
        single, every = single.on_clock(clock), every.on_clock(clock)
    with pytest.warns(PfdistWarning, match="u of the model: one value, which holds at each inst"):
        filtering = pfdist.Filter(single, seed=3)
    for each in (filtering, wanted := pfdist.Filter(every, seed=3)):
        each.update(2, 1.1, u=0.3)
        each.update(6, 0.4)
    assert filtering.now.mean == wanted.now.mean
    assert filtering.now.standard_deviation == wanted.now.standard_deviation


def test_the_filter_of_a_job_is_that_of_the_commands(tmp_path: Path) -> None:
    """Bit for bit; arguments of the constructor replace the job's values."""
    job = {"given": {"u": "error"}, "particles": 40, "engine": "auto"}
    problem = _problem((0.2,), times=[0, 0.5, 1, 2, 4, 8, 9], **{"horizon": None, **job})
    table = pd.DataFrame({"t": [0, 1, 8], "y0": Y, "error": U})
    seeded = problem.job().with_changes(["seed=5"])
    for source in (problem, seeded):
        last = pfdist.filter_measurements(source, table, report=False).table.iloc[-2]
        filtering = pfdist.Filter(source)
        for t, y, u in zip((0, 2, 5), Y, U, strict=True):
            filtering.update(t, y, u=u)
        assert filtering.now.mean[0] == last["mean_0"]
        assert filtering.now.standard_deviation[0] == last["sd_0"]
        assert filtering.horizon == 6
    other = pfdist.Filter(problem, particles=50, seed=4, horizon=3, resample="below 0.5")
    assert other.unmeasured.settings.particles == 50
    assert other.horizon == 3
    assert other.stream != filtering.stream
    with pytest.raises(JobError, match=r"cannot read .*none\.toml"):
        pfdist.Filter(tmp_path / "none.toml")
    with pytest.raises(ModelError, match="must be a StateSpaceModel, a name, or a job, got 3"):
        pfdist.Filter(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("engine", ["kalman", "auto"])
def test_a_planner_takes_them_with_each_reading(engine: str) -> None:
    """Its filter has the posterior, and the truths of simulated systems have it, too."""
    planner = pfdist.Planner(_problem(measurement_budget=6, engine=engine, particles=4000))
    for t, y, u in zip((0, 2, 5), Y, U, strict=True):
        estimate = planner.update(y, t, u=u)
    mean, sd = _posterior(U)
    tolerance = 1e-9 if engine == "kalman" else 0.03
    assert estimate.mean[0] == pytest.approx(mean, abs=tolerance)
    left = planner.expected([])[0].expected_mse  # nothing more is measured: the variance
    assert left == pytest.approx(sd**2, rel=1e-9 if engine == "kalman" else 0.15)
    if engine == "auto":
        truths = planner.rest.now.prior.truths.x[0]
        assert [truths.mean(), truths.std()] == pytest.approx([mean, sd], abs=0.03)


def test_a_reading_that_is_refused_leaves_no_error_behind() -> None:
    filtering = pfdist.Filter(_constant([0.2] * 7), engine="compiled", horizon=6)
    for wrong in (math.nan, "0.1"):
        with pytest.raises(MeasurementsError, match="u must be a finite number, got"):
            filtering.update(2, 1.0, u=wrong)
    with pytest.raises(MeasurementsError, match="no particle"):
        filtering.update(2, 1e200, u=0.5)
    assert filtering.model.parameters["u"] == (0.2,) * 7


def test_a_plan_has_the_errors_of_the_job() -> None:
    """Exact readings are worth more: the plan measures where the job foresees small errors."""
    expected = pfdist.evaluate(_problem((0.2,)), [0, 1]).expected_mse
    early = pfdist.evaluate(_problem([0.2, 0.1, *[0.2] * 5]), [0, 1]).expected_mse
    of_all = [1 / (1 + n / 0.04) for n in (1, *[2] * 6)]
    assert expected == pytest.approx(np.mean(of_all), rel=1e-9)
    assert early < expected


def test_a_plan_has_the_distribution_of_errors_that_the_model_draws() -> None:
    """The manual's recipe: y has the error, too. E[1 / (1 + 1 / u^2)] by Gauss-Hermite nodes."""

    def error(v: Any) -> Any:
        return 0.5 * np.exp(0.8 * v[1])

    drawn = replace(
        _constant([0.2] * 2),
        measurement=lambda x, t, v, p: (x[0] + error(v) * v[0], error(v)),
        log_likelihood=lambda y, x, t, p: normal_logpdf(y[0], x[0], y[1]),
        measurement_noise=("normal", "normal"),
        normalised=False,
        linear_gaussian=False,
    )
    job = {"horizon": 1, "measurement_budget": 1, "particles": 1000}
    found = pfdist.evaluate(pfdist.Problem(drawn, **job), [0], draws=4000)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    u = 0.5 * np.exp(0.8 * nodes)
    right = np.average(1 / (1 + 1 / u**2), weights=weights)
    assert abs(found.expected_mse - right) < 4 * found.standard_error
    assert found.standard_error < 0.02 < right - 0.2  # 0.2 with u = 0.5 alone
    rows = pd.DataFrame({"t": [0], "y0": [1.1], "y1": [0.3]})
    problem = pfdist.Problem(drawn, **{**job, "particles": 20_000})
    table = pfdist.filter_measurements(problem, rows, report=False).table
    assert table["mean_0"].iloc[0] == pytest.approx(1.1 / 1.09, abs=0.02)


def test_next_fit_and_backtest_read_the_column(tmp_path: Path) -> None:
    table = pd.DataFrame({"t": [0, 2, 5], "y0": Y, "error": U})
    assert pfdist.next_time(_problem(measurement_budget=4), table).measured == (0, 2, 5)
    rng = np.random.default_rng(1)
    rows = [
        {"who": k, "t": t, "y0": 2 * x + u * rng.normal(), "error": u}
        for k, x in enumerate(rng.normal(size=20))
        for t, u in enumerate(rng.choice([0.1, 3.0], 7))
    ]
    fitted = pfdist.fit(_problem(), pd.DataFrame(rows), ["sd"], replicate="who", pool="serial")
    assert fitted.log_likelihood == pytest.approx(_log_likelihood(rows, fitted.parameters["sd"]))
    near = [_log_likelihood(rows, fitted.parameters["sd"] * each) for each in (0.95, 1.05)]
    assert max(near) < fitted.log_likelihood
    run = pfdist.plan(_problem(sd=2.0), tmp_path / "run", bound_draws=0, figures=False)
    judged = pfdist.backtest(run, pd.DataFrame(rows), replicate="who", within=3, pool="serial")
    assert "wrong" not in judged._page().sections[0].blocks[0].text  # errors of 0.2 would be wrong


def _log_likelihood(rows: list[dict[str, Any]], sd: float) -> float:
    """The density of each system's readings: normal, with the covariance sd^2 + diag(error^2)."""
    total = 0.0
    for _, each in pd.DataFrame(rows).groupby("who"):
        covariance = sd**2 + np.diag(each["error"] ** 2)
        total += multivariate_normal(np.zeros(len(each)), covariance).logpdf(each["y0"])
    return total


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ({"t": [0], "y0": [1.0]}, "columns must be columns of the table, t, y0, got 'error'"),
        (
            {"t": [0, 0], "y0": [1.0, 2.0], "error": [0.1, 0.2]},
            r"0.1 and 0.2 at t = 0; if u is a standard error, give such readings as one: their",
        ),
        ({"t": [0], "y0": [1.0], "error": [math.inf]}, "one finite value .* got inf at t = 0$"),
    ],
)
def test_a_wrong_column_is_explained(rows: dict[str, Any], words: str) -> None:
    with pytest.raises(MeasurementsError, match=words):
        pfdist.filter_measurements(_problem(), pd.DataFrame(rows))


def test_readings_of_one_time_are_their_weighted_mean() -> None:
    """The remedy of the error: the precision of the mean is the sum of theirs."""
    precision = [1 / each**2 for each in U]
    mean = np.average(Y, weights=precision)
    table = pd.DataFrame({"t": [3], "y0": [mean], "error": [sum(precision) ** -0.5]})
    found = pfdist.filter_measurements(_problem(), table, report=False).table.iloc[-1]
    assert [found["mean_0"], found["sd_0"]] == pytest.approx(_posterior(U), rel=1e-12)


def test_a_reading_without_its_error_has_that_of_the_job_and_a_line_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = pd.DataFrame({"t": [0, 2, 5], "y0": Y, "error": [0.3, 0.5, math.nan]})
    found = pfdist.filter_measurements(_problem(), table, report=False, say=print).table.iloc[-1]
    assert [found["mean_0"], found["sd_0"]] == pytest.approx(_posterior([0.3, 0.5, 0.2]), rel=1e-12)
    line = "u is empty in 1 row with a reading: there the job's value counts"
    assert line in capsys.readouterr().out


def test_it_names_a_parameter_of_the_model_and_a_column_once() -> None:
    with pytest.raises(JobError, match="a column for each parameter, got 'error' twice"):
        as_job(_problem(given={"u": "error", "sd": "error"}))
    with pytest.raises(ModelError, match="given must be parameters of the model, u, sd, got"):
        pfdist.simulate(_problem(given={"v": "error"}))
    assert "wrong" not in {*pfdist.check_model(_problem())["state"]}


def test_an_empty_table_asks_for_the_first_time() -> None:
    """Also with the column of [problem.given], whose readings have not come yet."""
    empty = pd.DataFrame({name: [] for name in ("t", "y0", "error")})
    asked, alone = (
        pfdist.next_time(problem, each)
        for problem, each in (
            (_problem(), empty),
            (_problem((0.2,) * 7, given=None), empty[["t", "y0"]]),
        )
    )
    assert asked.plan == alone.plan
