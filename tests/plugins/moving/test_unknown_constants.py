"""Unknown constants in the filter of one system, and in evaluations: bands, surprises, evidence."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import pfdist
from oracles.unknown import (
    GLUCOSE_MINUTES,
    HOURS,
    MINUTES,
    constants,
    drug,
    epidemic,
    level_and_slope,
    minimal_model,
    moving,
    remifentanil,
)
from pfdist import Filter, Problem, StateSpaceModel
from pfdist.errors import ModelError, PfdistWarning
from pfdist.filters.constants import constants_of
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.proposal import PLAIN
from pfdist.filters.simulation import simulate
from pfdist.kernels.estimators import EVIDENCE
from pfdist.plugins.moving import plain
from pfdist.plugins.moving.proposal import MOVING
from pfdist.plugins.online import work as online_work

READINGS = 8
DRUG = drug(0.03).on_clock(HOURS)


def bands(model: StateSpaceModel, times: range, systems: int) -> tuple[Any, Any, Any]:
    """Whether each 90 % band at the end holds the truth, its width, and all p-values."""
    draws = simulate(model, times[-1], range(systems), 11)
    holds, widths, surprises = [], [], []
    for number, (y, z) in enumerate(zip(draws.y, draws.z[:, -1, 0], strict=True)):
        filtering = Filter(model, seed=number, horizon=times[-1])
        for t in times:
            estimate = filtering.update(t, y[t])
            surprises.append(estimate.surprise)
        low, high = estimate.quantiles([0.05, 0.95])[:, 0]
        holds.append(low <= z <= high)
        widths.append(high - low)
    assert filtering.unmeasured.settings.proposal == MOVING.name
    return np.array(holds), np.array(widths), np.array(surprises)


@pytest.mark.parametrize(
    ("model", "times"),
    [
        pytest.param(constants(1, 0.05), range(1, READINGS + 1), id="constant"),
        pytest.param(drug(0.15).on_clock(HOURS), range(14), id="drug", marks=pytest.mark.slow),
        pytest.param(DRUG, range(14), id="sharp drug", marks=pytest.mark.slow),
        pytest.param(
            minimal_model().on_clock(GLUCOSE_MINUTES),
            range(1, 11),
            id="minimal",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            epidemic().on_clock(tuple(range(0, 61, 6))),
            range(1, 11),
            id="epidemic",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_bands_of_constants_hold_as_often_as_they_say(model: StateSpaceModel, times: range) -> None:
    # Systems are simulated by the model itself. With 400, a share of 90 % has a standard error of
    # 1.5 %; two systems of dependent p-values are the number of measurements of one.
    holds, widths, surprises = bands(model, times, 400)
    assert 0.855 <= holds.mean() <= 0.945
    assert widths.min() > 1e-6
    first = surprises.reshape(400, -1)[:, [0, -1]]
    # That of several components is a bound (Bonferroni), so small ones are not too many.
    side = "greater" if model.components[1] > 1 else "two-sided"
    assert all(stats.kstest(p, "uniform", alternative=side).pvalue > 0.01 for p in first.T)


@pytest.mark.parametrize(
    ("model", "found"),
    [
        (level_and_slope(0.1, 0.05), (1,)),
        (constants(3, 0.1), (0, 1, 2)),
        ("ungm", ()),
        ("tumour", (1,)),
    ],
)
def test_components_that_do_not_move_are_found_by_trying(
    model: Any, found: tuple[int, ...]
) -> None:
    model = pfdist.load_model(model) if isinstance(model, str) else model
    assert constants_of(model, range(21)) == found


def test_the_drug_has_the_exact_error_afterwards() -> None:
    # .00160 +- .00012 by a filter with moves of another program; equal weights of instants.
    evaluator = Evaluator(DRUG, 13, lag=13)
    times = tuple(HOURS.index(t) for t in (0.25, 0.5, 1.5, 3.0, 4.0, 20.0))
    mse = evaluator(evaluator.work((times,), 3, 5, (0, 2000), moving(100))).mse[:, 0]
    error = np.hypot(mse.std() / 2000**0.5, 0.00012)
    assert abs(mse.mean() - 0.00160) <= 3 * error


def test_the_evidence_is_nearly_unbiased() -> None:
    # Oracle: a normal density, of which adaptive exponents miss some per cent.
    model, copies = constants(1, 0.1), 2000
    draws = simulate(model, 4, range(copies), 7)
    same = replace(draws, y=np.broadcast_to(draws.y[:1], draws.y.shape).copy())
    y = draws.y[0, 1:, 0]
    exact = stats.multivariate_normal(cov=np.eye(4) * 0.1**2 + 1.0).logpdf(y)
    settings = moving(100, estimator=EVIDENCE.name)
    found = filter_checked_draws(model, same, (1, 2, 3, 4), 3, settings).mse * 5 - exact
    assert np.exp(found).mean() == pytest.approx(1.0, abs=0.05)
    follows = Filter(model, horizon=8)
    for t, value in enumerate(y, 1):
        follows.update(t, value)
    assert follows.log_evidence == pytest.approx(exact, abs=0.5)


def test_the_evidence_is_unbiased_with_exponents_and_covariances_of_a_pilot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Del Moral (2004): a product of mean weights is unbiased if nothing adapts to its particles.
    # With 20 that adapt, the evidence is 6.7 % too high.
    model, copies, particles = constants(2, 0.3), 40_000, 20
    rows = np.array([model.parameters[f"factor_{c}"] for c in range(2)])[:, 1:5].T
    seeds = simulate(model, 4, range(copies), 7)
    seeds = replace(seeds, y=np.broadcast_to(seeds.y[:1], seeds.y.shape).copy())
    pilot = replace(simulate(model, 4, range(1), 7), y=seeds.y[:1])
    exact = stats.multivariate_normal(cov=np.eye(4) * 0.3**2 + rows @ rows.T).logpdf(
        pilot.y[0, 1:, 0]
    )
    exponent, of_noise = plain._exponent, plain._moments_of_noise
    exponents, moments = list[tuple[Any, Any]](), list[tuple[Any, Any]]()

    def kept_exponent(likelihood: Any, rest: Any) -> Any:
        exponents.append((exponent(likelihood, rest), rest))
        return exponents[-1][0]

    def kept_moments(lines: Any, weight: Any) -> Any:
        moments.append(of_noise(lines, weight))
        return moments[-1]

    def frozen_exponent(likelihood: Any, rest: Any) -> Any:
        ((first,), (most,)) = exponents.pop(0)
        return rest if first == most else np.full_like(rest, first)

    def frozen_moments(lines: Any, weight: Any) -> Any:
        return tuple(np.repeat(each, len(weight), axis=0) for each in moments.pop(0))

    monkeypatch.setattr(plain, "_exponent", kept_exponent)
    monkeypatch.setattr(plain, "_moments_of_noise", kept_moments)
    plain.filter_block(model, pilot, (1, 2, 3, 4), 3, moving(1000), keeps_lines=False)
    assert len(exponents) > 4
    monkeypatch.setattr(plain, "_exponent", frozen_exponent)
    monkeypatch.setattr(plain, "_moments_of_noise", frozen_moments)
    found = plain.filter_block(model, seeds, (1, 2, 3, 4), 3, moving(particles), keeps_lines=False)
    evidence = np.exp(found.log_likelihoods[0].sum(axis=1) - exact)
    assert not exponents
    assert abs(evidence.mean() - 1.0) <= 3 * evidence.std() / copies**0.5


@pytest.mark.plugins("fit")
def test_a_fit_finds_the_spread_of_a_constant() -> None:
    # Oracle: the normal likelihood, maximised by SciPy. Plain particles lose the constant of each
    # system, so the spread that they find is a third too large.
    model = constants(1, 0.05)
    wide = replace(
        model,
        initial=lambda w, p: (p.spread * w[0],),
        parameters={**model.parameters, "spread": 1.5},
    )
    of_job = Problem(wide, horizon=20, measurement_budget=6)
    y = simulate(model, 20, range(20), 5).y[:, 1:6, 0]
    table = pd.DataFrame(
        {"system": system, "t": t, "y": value}
        for system, row in enumerate(y) for t, value in enumerate(row, 1)
    )  # fmt: skip

    def loss(spread: float) -> float:
        covariance = np.eye(5) * 0.05**2 + spread**2
        return -float(stats.multivariate_normal(cov=covariance).logpdf(y).sum())

    exact = minimize_scalar(loss, bounds=(0.1, 5.0), method="bounded").x
    fitted = pfdist.fit(of_job, table, {"spread": (0.1, 5.0)}, replicate="system")
    assert fitted.parameters["spread"] == pytest.approx(exact, rel=0.03)


# --- what is taken, and what is said --------------------------------------------------------------


def problem(**keys: Any) -> Problem:
    return Problem(constants(1, 0.01), **{"horizon": 20, "measurement_budget": 6} | keys)


def test_a_plain_filter_that_has_lost_a_constant_says_so() -> None:
    model = constants(1, 0.001)
    plain, moved = (Filter(model, 200, proposal=each, horizon=20) for each in ("plain", "moving"))
    with pytest.warns(
        PfdistWarning, match="at t = 1, or fewer than 20 values of a constant are left"
    ):
        assert plain.update(1, 0.3).collapsed == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        estimate = moved.update(1, 0.3)
    assert estimate.collapsed is None
    assert estimate.standard_deviation[0] == pytest.approx(0.001, rel=0.2)


def test_auto_moves_particles_where_a_plain_filter_loses_constants() -> None:
    sharp = problem(instant_weights=[0] * 20 + [1])
    blunt = sharp.with_changes(model=constants(1, 5.0))
    assert pfdist.evaluate(sharp, range(1, 7), draws=200).expected_mse < 2e-5  # exactly 1.7e-5
    taken = [Filter(each).unmeasured.settings.proposal for each in (sharp, blunt)]
    assert taken == [MOVING.name] * 2
    assert Filter("random_walk").unmeasured.settings.proposal == PLAIN.name


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"engine": "kalman"}, "needs filter.engine = 'compiled' or 'numpy', got 'kalman'"),
        ({"resample": "below 0.5"}, "needs filter.resample = 'always'"),
    ],
)
def test_settings_that_do_not_go_together_are_named(keys: Any, words: str) -> None:
    given = Problem(level_and_slope(0.1, 0.05), horizon=8, measurement_budget=3, **keys)
    with pytest.raises(ModelError, match=words):
        pfdist.evaluate(given.with_changes(proposal="moving"), (1, 2, 3))


def test_the_share_of_draws_that_lose_a_constant_is_a_column_and_said(tmp_path: Path) -> None:
    plain = problem(proposal="plain", particles=100)
    evaluation = pfdist.evaluate(plain, range(1, 7), draws=50)
    assert "of the draws, the filter ends with fewer than 20 values" in evaluation.few_lines
    job = plain.job(comparison={"draws": 50, "sets": {"early": [1, 2, 3]}}, search=[])
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert (run.table("sets")["lost_constants"] > 0.5).all()
    assert 'take filter.proposal = "moving"' in str(run)


@pytest.mark.plugins("rule")
def test_a_rule_whose_filter_has_lost_a_constant_says_that_a_deviation_is_one_of_copies(
    tmp_path: Path,
) -> None:
    plain = problem(proposal="plain", particles=50)
    search = [{"method": "random", "evaluations": 4}]
    job = plain.job(comparison={"draws": 60}, search=search, evaluation={"draws": 40})
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    ruled = pfdist.rule(run, pool="serial", figures=False)
    assert "There a deviation of 0 is that of copies, and the rule ends." in str(ruled)


def test_the_answer_says_which_proposal_was_taken_and_why(tmp_path: Path) -> None:
    job = problem().job(comparison={"draws": 50, "sets": {"early": [1, 2, 3]}}, search=[])
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert (
        "filter.proposal: moving, because a plain filter loses the constants" in run._repr_html_()
    )


def test_a_long_horizon_with_many_measurements_is_planned(tmp_path: Path) -> None:
    # Oracle: the Kalman filter, with the times of the plan.
    of_job = Problem(level_and_slope(0.02, 0.05), horizon=200, measurement_budget=20)
    search = [{"method": "random", "evaluations": 10}]
    job = of_job.job(comparison={"draws": 200}, search=search, evaluation={"draws": 20})
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert run.job["filter"]["proposal"] == MOVING.name
    planned = run.table("sets").set_index("name").loc["random"]
    times = run.sets["random"]
    exact = pfdist.evaluate(of_job.with_changes(engine="kalman"), times).expected_mse
    assert planned["expected_mse"] <= 1.05 * exact + 3 * planned["standard_error"]


def test_a_plan_on_the_way_that_would_take_too_long_keeps_plain_particles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    of_job = Problem(level_and_slope(0.1, 0.05), horizon=12, measurement_budget=3)
    proposals = list[str]()
    for most in (online_work._MOST_OPERATIONS, 1.0):
        monkeypatch.setattr(online_work, "_MOST_OPERATIONS", most)
        planner = pfdist.Planner(of_job, (2, 6, 10))
        proposals.append(planner.rest.replanner.planning.estimation.proposal)
        assert planner._filter.unmeasured.settings.proposal == MOVING.name
    assert proposals == [MOVING.name, PLAIN.name]


def test_the_modes_of_remifentanil_solve_its_compartments() -> None:
    """Oracle: the differential equations of three compartments, by an integrator."""
    model, w = remifentanil().on_clock(MINUTES), (0.3, -1.0, 0.5, 0.2, -0.4, 1.0)
    widths = (0.256, 0.284, 0.602, 0.139, 0.349, 0.394)
    v1, v2, v3, cl, q2, q3 = np.array((5.0, 11.6, 12.6, 2.6, 2.4, 0.086)) * np.exp(
        np.multiply(widths, w)
    )

    def slopes(t: float, c: Any, rate: float) -> Any:
        to_2, to_3 = q2 * (c[0] - c[1]), q3 * (c[0] - c[2])
        return (rate - cl * c[0] - to_2 - to_3) / v1, to_2 / v2, to_3 / v3

    begun, found = np.zeros(3), list[float]()
    for span, rate in (((0.0, 20.0), 100.0), ((20.0, 180.0), 0.0)):
        at = [t for t in MINUTES if span[0] < t <= span[1]]
        solved = solve_ivp(slopes, span, begun, "RK45", at, args=(rate,), rtol=1e-9, atol=1e-12)
        begun, found = solved.y[:, -1], [*found, *solved.y[0]]
    log_concentration = [model.quantity_of_interest(w, t, model.p)[0] for t in range(len(MINUTES))]
    assert log_concentration == pytest.approx(np.log(found), abs=1e-6)
