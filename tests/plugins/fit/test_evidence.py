"""The evidence of replicates: exact by the Kalman filter, and estimated without bias by particles.

Sources: Del Moral, "Feynman-Kac formulae", 2004, section 7.4 (the estimate of the density itself is
unbiased). Malik, Pitt, 2011 (sorted particles).
"""

from dataclasses import replace

import numpy as np
import pytest

from pfdist import Filter, StateSpaceModel, load_model
from pfdist.filters.evaluator import recorded_evaluator
from pfdist.plugins.fit.evidence import exact_log_evidence, log_evidence

HORIZON, REPLICATES = 12, 6


def walk(**parameters: float) -> StateSpaceModel:
    """A linear-Gaussian model with two components of y, each of which may be missing."""

    def log_likelihood(y, x, t, p):
        first = -0.5 * ((y[0] - x[0]) / p.noise) ** 2 - np.log(p.noise * np.sqrt(2 * np.pi))
        second = -0.5 * (y[1] - x[1]) ** 2 - np.log(np.sqrt(2 * np.pi))
        return np.where(np.isnan(y[0]), 0.0, first) + np.where(np.isnan(y[1]), 0.0, second)

    model = StateSpaceModel(
        name="walk",
        initial=lambda w, p: (w[0], w[1]),
        transition=lambda x, t, w, p: (p.a * x[0] + x[1] + w[0], 0.5 * x[1] + 0.5 * w[1]),
        measurement=lambda x, t, v, p: (x[0] + p.noise * v[0], x[1] + v[1]),
        log_likelihood=log_likelihood,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal", "normal"),
        process_noise=("normal", "normal"),
        measurement_noise=("normal", "normal"),
        parameters={"a": 0.9, "noise": 1.0, **parameters},
        linear_gaussian=True,
        normalised=True,
        missing_components=True,
    )
    return recorded_evaluator(model, model, horizon=HORIZON).model


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    """Measurements of six systems with gaps: times, components, and all later times."""
    model = walk()
    y = recorded_evaluator(model, model, horizon=HORIZON).draws(range(REPLICATES), 5).y.copy()
    y[:, 3] = np.nan
    y[1, 5, 0] = np.nan
    y[2, 6:] = np.nan
    return y


def test_the_exact_evidence_is_that_of_the_filter_of_one_system(measured: np.ndarray) -> None:
    evidence = exact_log_evidence(walk(), measured)
    for k, y in enumerate(measured):
        of_one = Filter(walk(), engine="kalman", horizon=HORIZON)
        for t, each in enumerate(y):
            if not np.isnan(each).all():
                of_one.update(t, each)
        assert evidence[k] == pytest.approx(of_one.log_evidence, abs=1e-9)


def test_the_density_is_estimated_without_bias(measured: np.ndarray) -> None:
    exact = exact_log_evidence(walk(), measured)
    ratios = np.array(
        [np.exp(log_evidence(walk(), measured, 300, stream) - exact) for stream in range(30)]
    )
    error = ratios.std(axis=0, ddof=1) / np.sqrt(len(ratios))
    assert np.abs(ratios.mean(axis=0) - 1).max() < 4 * error.max()
    assert error.max() < 0.15  # else the test sees nothing


def test_replicates_have_noise_of_their_own_however_they_are_shared_out(
    measured: np.ndarray,
) -> None:
    whole = log_evidence(walk(), measured, 100, 7)
    parts = [log_evidence(walk(), measured[k : k + 2], 100, 7, k) for k in (0, 2, 4)]
    assert np.concatenate(parts).tolist() == whole.tolist()


def test_sorted_particles_make_the_evidence_of_a_scalar_state_smooth(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Along a parameter it jumps by far less than estimates of particles that are not sorted."""
    model = load_model("random_walk")
    y = recorded_evaluator(model, model, horizon=HORIZON).draws(range(REPLICATES), 5).y

    def jumps() -> float:
        """The deviation of the increments between values that are near each other."""
        values = 1.0 + 1e-4 * np.arange(20)
        recorded = [model.with_parameters({"step_sd": float(each)}) for each in values]
        evaluators = [recorded_evaluator(each, each, horizon=HORIZON) for each in recorded]
        errors = [
            log_evidence(each.model, y, 300, 7).sum() - exact_log_evidence(each.model, y).sum()
            for each in evaluators
        ]
        return float(np.diff(errors).std())

    sorted_jumps = jumps()
    monkeypatch.setattr(
        np, "argsort", lambda values, **_: np.tile(np.arange(300), (len(values), 1))
    )
    assert sorted_jumps < jumps() / 10


def test_impossible_measurements_have_no_evidence(measured: np.ndarray) -> None:
    far = measured.copy()
    far[0, 2, 0] = 1e200
    evidence = log_evidence(walk(noise=1e-3), far, 100, 7)
    assert evidence[0] == -np.inf
    assert np.isfinite(evidence[3:]).any()


def test_a_first_component_that_never_differs_orders_nothing(measured: np.ndarray) -> None:
    """A model with a constant beside its state has the same evidence: it measures the same."""
    model = walk()

    def after(formula, *, gives_state=False):
        def shifted(x, *others):
            found = formula(x[1:], *others)
            return (0.5 * x[0], *found) if gives_state else found

        return shifted

    widened = replace(
        model,
        initial=lambda w, p: (3.0 + 0.0 * w[0], *model.initial(w, p)),
        transition=after(model.transition, gives_state=True),
        measurement=after(model.measurement),
        log_likelihood=lambda y, x, t, p: model.log_likelihood(y, x[1:], t, p),
        quantity_of_interest=after(model.quantity_of_interest),
    )
    found, wanted = (log_evidence(each, measured, 100, 7) for each in (widened, model))
    assert found.tolist() == wanted.tolist()
