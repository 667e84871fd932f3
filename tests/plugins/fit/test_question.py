"""Maximum likelihood: the exact optimum for a linear-Gaussian model, by Kalman's likelihood."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

import pfdist
from oracles.systems import one_state
from pfdist.errors import MeasurementsError
from pfdist.filters.evaluator import recorded_evaluator
from pfdist.plugins.fit.evidence import exact_log_evidence
from pfdist.plugins.fit.question import Fitted

pytestmark = pytest.mark.plugins("simulate")

HORIZON, SYSTEMS = 10, 15
TRUE = {"a": 0.9, "sd": 0.5, "noise": 0.7}
START = {"a": 0.6, "sd": 1.0, "noise": 1.0}


def model_with(**parameters: float) -> pfdist.StateSpaceModel:
    """A stationary autoregression that is measured with noise."""
    return one_state(
        "autoregression",
        initial=lambda w, p: (p.sd / np.sqrt(1 - p.a**2) * w[0],),
        transition=lambda x, t, w, p: (p.a * x[0] + p.sd * w[0],),
        measurement=lambda x, t, v, p: (x[0] + p.noise * v[0],),
        log_likelihood=lambda y, x, t, p: pfdist.densities.normal_logpdf(y[0], x[0], p.noise),
        parameters=parameters,
        parameter_ranges={"a": (0.0, 0.99), "sd": (1e-3, 10.0), "noise": (1e-3, 10.0)},
        linear_gaussian=True,
        normalised=True,
    )


@pytest.fixture(scope="module")
def data() -> pd.DataFrame:
    """Measurements of fifteen systems; every fifth instant was not measured."""
    problem = pfdist.Problem(model_with(**TRUE), horizon=HORIZON, measurement_budget=4)
    draws = pfdist.simulate(problem, draws=SYSTEMS, seed=3)
    draws = draws.rename(columns={"draw": "system", "y_0": "y0"})[["system", "t", "y0"]]
    return draws[draws["t"] % 5 != 4]


def problem(**keys: object) -> pfdist.Problem:
    """The problem with wrong values of the parameters."""
    start = model_with(**START)
    return pfdist.Problem(start, horizon=HORIZON, measurement_budget=4, **keys)


@pytest.fixture(scope="module")
def fitted(data: pd.DataFrame) -> Fitted:
    """The fit of all parameters by the exact likelihood."""
    return pfdist.fit(problem(engine="kalman"), data, [*START], pool="serial")


def test_the_fit_finds_the_maximum_of_the_exact_likelihood(
    data: pd.DataFrame, fitted: Fitted
) -> None:
    """Another search of the same likelihood, with derivatives, ends at the same place."""
    loss = loss_of(data)
    bounds = [(-9, np.log(0.99)), (-2, 2), (-2, 2)]
    best = minimize(loss, np.log([*TRUE.values()]), method="L-BFGS-B", bounds=bounds, tol=1e-7)
    assert fitted.is_converged
    assert fitted.error == 0.0
    assert fitted.log_likelihood == pytest.approx(-best.fun, abs=0.02)
    assert [*fitted.parameters.values()] == pytest.approx(np.exp(best.x).tolist(), abs=0.02)
    assert fitted.log_likelihood > fitted.started_at
    assert fitted.log_likelihood >= -loss(np.log([*TRUE.values()]))


def test_profiles_and_correlation_are_those_of_the_likelihood(data: pd.DataFrame) -> None:
    """Near the maximum by its second derivatives; far from it by a search with another method."""
    names, every = ("a", "sd"), loss_of(data)
    given: Any = {"changes": [f"model.parameters.noise={TRUE['noise']}"], "pool": "serial"}
    fitted = pfdist.fit(problem(engine="kalman"), data, names, **given, profile=True)

    def loss(logs: np.ndarray) -> float:
        return every(np.append(logs, np.log(TRUE["noise"])))

    best, unit = np.log([*fitted.parameters.values()]), 2e-3 * np.eye(2)
    curved = [
        [sum(s * r * loss(best + s * a + r * b) for s in (1, -1) for r in (1, -1)) for b in unit]
        for a in unit
    ]
    covariance = np.linalg.inv(curved)
    deviation = np.sqrt(np.diag(covariance))
    assert fitted.profile is not None
    assert fitted.correlation is not None
    expected = covariance / np.outer(deviation, deviation)
    np.testing.assert_allclose(fitted.correlation, expected, atol=0.1)
    far = fitted.profile.groupby("parameter").tail(1).set_index("parameter")
    for k, name in enumerate(names):
        held = np.log(far.loc[name, name])
        least = minimize(
            lambda rest, k=k, held=held: loss(np.insert(rest, k, held)), np.delete(best, k),
            method="L-BFGS-B", bounds=[(-6, 2)],
        ).fun - loss(best)  # fmt: skip
        assert far.loc[name, "below"] == pytest.approx(least, abs=0.1)
        assert far.loc[name, "below"] > 1.92
    assert len(fitted.as_json()["profile"]) == len(fitted.profile)


def test_what_data_cannot_tell_apart_is_named() -> None:
    """The measurements have the variance a^2 + b^2, and nothing else depends on a and b."""
    model = one_state(
        "two noises",
        initial=lambda w, p: (0.0 * w[0],),
        transition=lambda x, t, w, p: (0.0 * x[0] + 0.0 * w[0],),
        measurement=lambda x, t, v, p: (x[0] + p.a * v[0] + p.b * v[1],),
        log_likelihood=lambda y, x, t, p: pfdist.densities.normal_logpdf(
            y[0], x[0], np.sqrt(p.a**2 + p.b**2)
        ),
        measurement_noise=("normal", "normal"),
        parameters={"a": 1.0, "b": 1.0},
        parameter_ranges={"a": (0.01, 9.0), "b": (0.01, 9.0)},
        linear_gaussian=True,
        normalised=True,
    )
    y = np.random.default_rng(1).standard_normal(9)
    table = pd.DataFrame({"system": 0, "t": range(9), "y0": y})
    job = pfdist.Problem(model, horizon=8, measurement_budget=4, engine="kalman")
    fitted = pfdist.fit(job, table, ["a", "b"], pool="serial", profile=True)
    assert "a and b are hard to tell apart: the correlation of their estimates is -" in str(fitted)


def loss_of(data: pd.DataFrame) -> Callable[[np.ndarray], float]:
    """Kalman's likelihood, with its sign changed, by the logarithms of all parameters."""
    y = np.full((SYSTEMS, HORIZON + 1, 1), np.nan)
    y[data["system"], data["t"], 0] = data["y0"]
    model = model_with(**START)
    recorded = recorded_evaluator(model, model, horizon=HORIZON).model

    def loss(logs: np.ndarray) -> float:
        values = np.minimum(np.exp(logs), [0.99, 10.0, 10.0]).tolist()
        there = recorded.with_parameters(dict(zip(START, values, strict=True)))
        return -float(exact_log_evidence(there, y).sum())

    return loss


def test_particles_find_nearly_the_same(data: pd.DataFrame) -> None:
    """The fit by particles loses little of Kalman's likelihood: less than a 95 % region, 3.9."""
    parameters = ["sd"]
    exact = pfdist.fit(problem(engine="kalman"), data, parameters, pool="serial")
    fitted = pfdist.fit(problem(particles=100), data, parameters, evaluations=20, pool="threads")
    start = pfdist.Problem(
        model_with(**(START | fitted.parameters)),
        horizon=HORIZON,
        measurement_budget=4,
        engine="kalman",
    )
    again = pfdist.fit(start, data, parameters, evaluations=1, pool="serial")
    assert exact.log_likelihood - again.started_at < 2.0
    assert 0.0 < fitted.error < 3.0
    assert abs(fitted.log_likelihood - again.started_at) < 6 * fitted.error


def test_training_replicates_alone_are_used(data: pd.DataFrame) -> None:
    marked = data.assign(train=(data["system"] < 10).astype(int))
    fitted = pfdist.fit(problem(engine="kalman"), marked, ["noise"], pool="serial")
    first = pfdist.fit(
        problem(engine="kalman"), data[data["system"] < 10], ["noise"], pool="serial"
    )
    assert fitted.replicates == first.replicates == 10
    assert fitted.parameters == first.parameters


@pytest.mark.parametrize("bounds", [(0.9, 2.0), (0.01, 0.1)])
def test_a_maximum_outside_of_the_bounds_is_on_a_bound(
    data: pd.DataFrame, bounds: tuple[float, float]
) -> None:
    """The likelihood has one maximum, at .17, because other parameters are wrong."""
    start = np.clip(START["noise"], *bounds)
    job, changes = problem(engine="kalman"), [f"model.parameters.noise={start}"]
    fitted = pfdist.fit(job, data, {"noise": bounds}, changes=changes, pool="serial")
    nearest = float(np.clip(0.17, *bounds))
    assert fitted.parameters == {"noise": nearest}
    assert fitted.on_bound == ("noise",)
    assert f"noise lies on its bound, {nearest:.4f}" in str(fitted)


def cubic(**parameters: float) -> pfdist.StateSpaceModel:
    """Measurements k^2 and .3 k of a constant k: with k = -1, another maximum is near k = .9."""
    return one_state(
        "cubic",
        initial=lambda w, p: (p.spread * w[0],),
        transition=lambda x, t, w, p: (x[0] + 0.0 * w[0],),
        measurement=lambda x, t, v, p: (x[0] + p.k**2 + 0.1 * v[0], 0.3 * p.k + 0.1 * v[1]),
        log_likelihood=lambda y, x, t, p: (
            pfdist.densities.normal_logpdf(y[0], x[0] + p.k**2, 0.1)
            + pfdist.densities.normal_logpdf(y[1], 0.3 * p.k, 0.1)
        ),
        measurement_noise=("normal", "normal"),
        parameters={"k": 0.8, "spread": 0.02, **parameters},
        parameter_ranges={"spread": (0.0, 9.0)},
        linear_gaussian=True,
        normalised=True,
    )


MEASURED = pd.DataFrame({"system": 0, "t": range(9), "y0": 1.0, "y1": -0.3})


def exact(start: float, bounds: tuple[float, float]) -> Fitted:
    """The fit of k by the exact likelihood."""
    job = pfdist.Problem(cubic(k=start), horizon=8, measurement_budget=4, engine="kalman")
    return pfdist.fit(job, MEASURED, {"k": bounds}, pool="serial")


def test_a_start_on_a_bound_is_left() -> None:
    """At k = -1 both measurements are those that are expected: no value has a larger likelihood."""
    fitted = exact(0.0, (-2.0, 0.0))
    assert fitted.parameters["k"] == pytest.approx(-1.0, abs=1e-3)
    assert fitted.is_converged
    assert fitted.on_bound == ()


def test_of_two_maxima_the_larger_is_found() -> None:
    """The search from the start alone finds the other maximum, on the positive side."""
    fitted = exact(0.95, (-4.0, 9.0))
    assert fitted.parameters["k"] == pytest.approx(-1.0, abs=1e-3)
    assert fitted.is_converged
    assert fitted.starts > 2  # the first two do not agree


def test_a_deviation_without_which_the_data_are_most_likely_is_0() -> None:
    """A logarithm only comes near 0. All measurements are the same, so the states differ by 0."""
    job = pfdist.Problem(cubic(k=-1.0), horizon=8, measurement_budget=4, engine="kalman")
    fitted = pfdist.fit(job, MEASURED, ["spread"], pool="serial")
    assert fitted.parameters == {"spread": 0.0}
    assert fitted.on_bound == ("spread",)


def test_without_two_starts_that_agree_the_search_has_not_converged(data: pd.DataFrame) -> None:
    """The first search alone, which needs more evaluations than these, proves nothing."""
    fitted = pfdist.fit(problem(engine="kalman"), data, ["noise"], evaluations=9, pool="serial")
    assert fitted.evaluations == 9
    assert not fitted.is_converged
    assert "no two distant starts" in str(fitted)


def test_the_error_contains_that_of_the_maximum() -> None:
    """Few particles: the exact likelihood of k = -1, the largest, beside that of what is found."""
    settings = {"horizon": 8, "measurement_budget": 4}
    few = pfdist.Problem(cubic(), **settings, particles=10)
    fitted = pfdist.fit(few, MEASURED, {"k": (-2.0, 0.8)}, changes=["seed=1"], pool="serial")
    most, found = (
        pfdist.fit(
            pfdist.Problem(cubic(k=k), **settings, engine="kalman"),
            *(MEASURED, ["k"]),
            evaluations=1,
        ).started_at
        for k in (-1.0, fitted.parameters["k"])
    )
    assert fitted.is_converged
    assert most - found < fitted.error
    assert abs(fitted.log_likelihood - most) < 3 * fitted.error


def test_a_likelihood_without_its_constant_is_not_fitted(data: pd.DataFrame) -> None:
    model = replace(model_with(**START), normalised=False)
    without = pfdist.Problem(model, horizon=HORIZON, measurement_budget=4)
    with pytest.raises(pfdist.PfdistError, match="normalised=True"):
        pfdist.fit(without, data, ["noise"])


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (["nois"], "did you mean 'noise'"),
        ([], "at least one"),
        ({"noise": (2.0, 3.0)}, "must start in 2..3, got 1"),
    ],
)
def test_wrong_parameters_end_in_one_line(
    data: pd.DataFrame, parameters: list[str], said: str
) -> None:
    with pytest.raises(pfdist.PfdistError, match=said):
        pfdist.fit(problem(engine="kalman"), data, parameters)


def test_a_fitted_parameter_has_no_column(data: pd.DataFrame) -> None:
    with pytest.raises(pfdist.PfdistError, match="no column in the table, got noise"):
        pfdist.fit(problem(engine="kalman"), data.assign(noise=0.7), ["noise"])


@pytest.mark.parametrize("kind", ["learned", "told"])
def test_a_parameter_that_differs_between_systems_is_not_fitted(
    data: pd.DataFrame, kind: str
) -> None:
    """The filter would not use its value, so every value would be as likely."""
    scenarios = {"parameters": [{"a": 0.5}, {"a": 0.6}], "filter": kind}
    with pytest.raises(pfdist.PfdistError, match=r"the same for all systems, got a.*a_factor"):
        pfdist.fit(problem(scenarios=scenarios, particles=100), data, ["a", "sd"])


def test_a_likelihood_does_not_depend_on_when_values_arrive(
    data: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a delay, rows near the horizon arrive in time; the path has the same law."""
    monkeypatch.chdir(tmp_path)
    given = {"parameters": ["noise"], "evaluations": 1, "pool": "serial"}
    for engine in ("kalman", "numpy"):
        late = problem(engine=engine, particles=200, sensor={"delay": 3}, lag=2)
        found = pfdist.fit(late, data, **given)
        assert (
            found.started_at
            == pfdist.fit(problem(engine=engine, particles=200), data, **given).started_at
        )
    run = pfdist.run(problem(engine="kalman", sensor={"delay": 3}), "late", bound_draws=0)
    early = pfdist.fit(run.path, data[data["t"] <= HORIZON - 3], **given)
    assert early.started_at == pytest.approx(
        pfdist.fit(problem(engine="kalman"), data[data["t"] <= HORIZON - 3], **given).started_at
    )
    with pytest.raises(MeasurementsError, match="give the job file, not the folder of its run"):
        pfdist.fit(run.path, data, **given)


def relaxing() -> pfdist.StateSpaceModel:
    """An Ornstein-Uhlenbeck process without ranges: a rate below 0 has no stationary variance."""

    def transition(x, t, w, p):  # type: ignore[no-untyped-def]
        kept = np.exp(-p.rate * p.dt[t])
        return (kept * x[0] + p.sd * np.sqrt(1 - kept**2) * w[0],)

    return one_state(
        "relaxing",
        initial=lambda w, p: (p.sd * w[0],),
        transition=transition,
        measurement=lambda x, t, v, p: (x[0] + 0.3 * v[0],),
        log_likelihood=lambda y, x, t, p: pfdist.densities.normal_logpdf(y[0], x[0], 0.3),
        parameters={"rate": 0.2, "sd": 0.1},
        linear_gaussian=True,
        normalised=True,
    )


def relaxed() -> tuple[pfdist.Problem, pd.DataFrame]:
    """A problem, and measurements of one system at uneven times."""
    rng, rows, x, last = np.random.default_rng(4), list[tuple[str, float, float]](), 0.5, 0.0
    for t in np.sort(rng.uniform(0, 20, 40)):
        kept = np.exp(-0.6 * (t - last))
        x, last = kept * x + np.sqrt(1 - kept**2) * rng.normal(), t
        rows.append(("a", t, x + 0.3 * rng.normal()))
    problem = pfdist.Problem(
        relaxing(), horizon=20, time_step=1, measurement_budget=4, engine="kalman"
    )
    return problem, pd.DataFrame(rows, columns=["id", "t", "y0"])


def test_a_model_that_is_not_finite_explains_nothing() -> None:
    """A trial below 0 is worse than all others; the result is a maximum of finite ones."""
    problem, table = relaxed()
    fitted = pfdist.fit(problem.with_changes(particles=200), table, ["rate"], pool="serial")
    best = fitted.parameters["rate"]
    assert 0.05 < best < 5.0
    for rate in (0.9 * best, 1.1 * best):
        start = relaxing().with_parameters({"rate": rate})
        other = pfdist.fit(
            problem.with_changes(model=start), table, ["rate"], evaluations=1, pool="serial"
        )
        assert other.started_at < fitted.log_likelihood


def test_a_sign_that_data_cannot_tell_is_said() -> None:
    """Only the square of a deviation matters: its sign is that of the start."""
    problem, table = relaxed()
    for start in (0.1, -0.1):
        model = relaxing().with_parameters({"sd": start, "rate": 0.6})
        fitted = pfdist.fit(problem.with_changes(model=model), table, ["sd"], pool="serial")
        assert (fitted.mirrored, fitted.turned) == (("sd",), ())
        assert fitted.parameters["sd"] * start > 0.05
        assert "sd may have either sign" in repr(fitted)
    ranged = pfdist.fit(problem, table, {"sd": (0.0, 9.0)}, pool="serial")
    assert ranged.mirrored == ranged.turned == ()


def test_a_parameter_that_changes_its_sign_is_named() -> None:
    fitted = exact(-0.2, (-np.inf, np.inf))
    other = exact(0.05, (-np.inf, np.inf))
    assert (fitted.turned, other.turned) == ((), ("k",))
    assert "k has another sign than at the start" in repr(other)
