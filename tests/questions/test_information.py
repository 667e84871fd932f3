"""Plans for the most information: brute force, the upper bound, and a fit of theophylline.

Sources: Fedorov, "Theory of optimal experiments", 1972 (D-optimal designs). Boeckmann, Sheiner,
Beal, "NONMEM users guide", part V, 1994 (theophylline).
"""

import math
import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.results_of import results_of
from pfdist import Problem, Run, StateSpaceModel, linear_gaussian
from pfdist.errors import JobError
from pfdist.filters.criteria.information import Information
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.pages.terminal import lines_of
from pfdist.problem.problem import as_job
from pfdist.questions.evaluate import evaluated
from pfdist.questions.run_page import answer_of
from pfdist.runner.build import build

HORIZON, COUNT = 9, 4
SETS = [*combinations(range(HORIZON + 1), COUNT)]
NATS = "problem.criterion=information"


def turning(noise: float) -> StateSpaceModel:
    """An oscillator whose position is seen."""
    cosine, sine = 0.9 * math.cos(0.7), 0.9 * math.sin(0.7)
    return linear_gaussian(
        "turning",
        initial_noise=[[1.0, 0.0], [0.0, 1.0]],
        transition=[[cosine, sine], [-sine, cosine]],
        process_noise=[[0.3, 0.0], [0.0, 0.3]],
        measurement=[[1.0, 0.0]],
        measurement_noise=[[noise]],
        quantity_of_interest=[[1.0, 0.0]],
    )


def told(model: StateSpaceModel, sets: Any) -> Any:
    evaluator = Evaluator(model, HORIZON, engine="kalman")
    return -exact_mse(evaluator, sets, criterion=Information())  # type: ignore[operator]


def planned(folder: Path, noise: float, *changes: str, **others: Any) -> Run:
    problem = Problem(turning(noise), horizon=HORIZON, measurement_budget=COUNT, particles=200)
    changes = (NATS, "comparison.draws=1000", *changes)
    return pfdist.plan(problem, folder, changes=changes, figures=False, **others)


@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_an_exact_plan_has_most_information_and_no_set_has_more_than_its_bound(
    tmp_path: Path, noise: float
) -> None:
    run = planned(tmp_path / "run", noise, "filter.engine=kalman")
    each = told(turning(noise), SETS)
    assert run.best.measurement_times == [*SETS[each.argmax()]]
    assert run.best.information == pytest.approx(each.max(), rel=1e-9)
    row = run.table("bound").set_index("name").loc["relaxation"]
    everything = told(turning(noise), [tuple(range(HORIZON + 1))])[0]
    assert each.max() <= -row["bound"] <= everything + 1e-9
    more = -row["bound"] - each.max()
    text = " ".join(lines_of(answer_of(run)))
    assert f"Proved: no other 4 times give more than a further {int(more)}" in text


@pytest.fixture(scope="module")
def by_particles(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return planned(tmp_path_factory.mktemp("nats") / "run", 0.5)


def test_particles_find_a_set_within_a_percent_and_a_bound_above_all_sets(
    by_particles: Run,
) -> None:
    each = told(turning(0.5), SETS)
    found = each[SETS.index(tuple(by_particles.best.measurement_times))]
    assert found > 0.99 * each.max()
    row = by_particles.table("bound").set_index("name").loc["relaxation"]
    assert -row["bound"] + 3 * row["bound_error"] > each.max()
    best = results_of(by_particles)["relaxation"]
    assert best.information_low < found < best.information_high
    regular = results_of(by_particles)["evenly_spaced"]
    truth = found - told(turning(0.5), [tuple(regular.measurement_times)])[0]
    assert best.criterion_gain_low < truth < best.criterion_gain_high
    assert best.criterion_value == -best.information


def test_the_search_has_the_truth_among_its_particles(by_particles: Run) -> None:
    [search] = build(as_job(by_particles.path)).searches
    for each in search.all_settings:
        assert ALL_SCHEMES[each.estimation.resampling].holds_truth


def test_the_answer_is_in_nats_and_bits(by_particles: Run) -> None:
    text = " ".join(lines_of(answer_of(by_particles)))
    best = results_of(by_particles)["relaxation"]
    assert f"They give {best.information:.2f}" in text
    assert f"({best.information / math.log(2):.2f} bits)" in text
    assert "than the best evenly spaced times" in text
    assert "The expected MSE is" in text


def test_sides_that_are_far_from_each_other_are_limits_and_the_truth_lies_between(
    tmp_path: Path,
) -> None:
    """Few particles: the point is the lower side, so it is no estimate (a sharp sensor)."""
    problem = Problem(
        turning(0.01), horizon=HORIZON, measurement_budget=COUNT, particles=20, proposal="plain"
    )
    sets = {"early": [0, 1, 2, 3], "spread": [0, 3, 6, 9]}
    run = pfdist.compare(
        problem, times=sets, results=tmp_path / "run", draws=200, changes=[NATS], figures=False
    )
    said = " ".join(" ".join(lines_of(answer_of(run))).split())
    found = re.search(r"They give at least (\S+) nats \(at most (\S+)\) of information", said)
    assert found is not None
    [exact] = told(turning(0.01), [tuple(sets[run.best.name])])
    low, high = map(float, found.groups())
    assert low < exact < high
    assert high > 1.5 * low
    assert "More filter.particles bring both limits closer." in said
    table = next(
        line for line in lines_of(answer_of(run)) if "at least" in line and "They" not in line
    )
    assert "(at most" in table
    page = evaluated(str(run.path), times={"": "0,1,2,3"}, draws=200)._page()
    assert "Information: at least " in str(page)


def test_the_same_draws_judge_named_sets_by_information_too(tmp_path: Path) -> None:
    problem = Problem(turning(0.5), horizon=HORIZON, measurement_budget=COUNT, particles=200)
    sets = {"early": [0, 1, 2, 3], "spread": [0, 3, 6, 9]}
    run = pfdist.compare(
        problem, times=sets, results=tmp_path / "run", draws=1000, also="information", figures=False
    )
    rows = results_of(run)
    assert "the best is lower by, %" in str(answer_of(run))
    for name, times in sets.items():
        exact = told(turning(0.5), [tuple(times)])[0]
        assert rows[name].information_low < exact < rows[name].information_high


def test_sets_that_are_ranked_by_information_have_no_column_of_other_ranks(tmp_path: Path) -> None:
    problem = Problem(turning(0.5), horizon=HORIZON, measurement_budget=COUNT, particles=200)
    sets = {"early": [0, 1, 2, 3], "spread": [0, 3, 6, 9]}
    run = pfdist.compare(
        problem, times=sets, results=tmp_path / "run", draws=100, changes=[NATS], figures=False
    )
    text = "\n".join(lines_of(answer_of(run)))
    assert "Best first, on 100 draws, by the information" in text
    said = " ".join(text.split())
    assert said.startswith("Best on these draws by the information: the set spread. They give")
    sets = dict(reversed(sets.items()))
    run = pfdist.compare(
        problem, times=sets, results=tmp_path / "again", draws=100, changes=[NATS], figures=False
    )
    said = " ".join(" ".join(lines_of(answer_of(run))).split())
    assert "the set spread. Second: the set early. They give" in said
    assert re.search(r"than the set spread: \S+ nats \([^)]*\) less", said)
    assert "the best is lower" not in str(answer_of(run))


@pytest.mark.plugins("budget")
@pytest.mark.parametrize(
    ("change", "needed"),
    [
        ("problem.estimate=smoothed", "problem.estimate = 'filtered'"),
        ("problem.instant_weights=[1,1,1,1,1,1,1,1,1,2]", "no problem.instant_weights"),
        ("model.filter.parameters.none=1", "a filter with the true model"),
        ("budget.least=1", "budget needs the expected MSE as criterion, got the information"),
    ],
)
def test_what_has_no_information_is_refused(tmp_path: Path, change: str, needed: str) -> None:
    changes = [change, "budget.most=2"] if "budget" in change else [change]
    with pytest.raises(JobError, match=needed):
        planned(tmp_path / "run", 0.5, *changes)


@pytest.mark.slow
def test_measurements_that_tell_nothing_are_not_proved(tmp_path: Path) -> None:
    blind = replace(
        turning(0.5),
        measurement=lambda x, t, v, p: (v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * y[0] ** 2 + 0.0 * x[0],
        linear_gaussian=False,
    )
    problem = Problem(blind, horizon=HORIZON, measurement_budget=COUNT, particles=50)
    run = pfdist.plan(
        problem, tmp_path / "run", changes=[NATS, "comparison.draws=100"], figures=False
    )
    assert run.best.information == 0.0
    assert {*run.table("bound")["reason"]} == {"its measurements tell nothing"}


# --- parameters alone -----------------------------------------------------------------------------

TIMES = (0.25, 0.5, 1.0, 2.0, 4.0, 7.0, 12.0, 24.0)  # hours after the dose
DOSE, SIGMA = 4.0, 0.5  # mg/kg, mg/L
PRIOR = {
    "ka": (1.5, 0.3),
    "ke": (0.085, 0.2),
    "volume": (0.46, 0.15),
}  # median, sd of the logarithm


def concentration(ka: Any, ke: Any, volume: Any, t: Any) -> Any:
    return DOSE * ka / (volume * (ka - ke)) * (np.exp(-ke * t) - np.exp(-ka * t))


def theophylline() -> StateSpaceModel:
    """One compartment with first-order absorption; the state is the parameters, which stay."""
    names = tuple(PRIOR)

    def values(x: Any) -> Any:
        return [PRIOR[name][0] * np.exp(PRIOR[name][1] * x[k]) for k, name in enumerate(names)]

    return StateSpaceModel(
        name="theophylline",
        initial=lambda w, p: (w[0], w[1], w[2]),
        transition=lambda x, t, w, p: (x[0], x[1], x[2]),
        measurement=lambda x, t, v, p: (concentration(*values(x), p.clock[t]) + SIGMA * v[0],),
        log_likelihood=lambda y, x, t, p: (
            -0.5 * ((y[0] - concentration(*values(x), p.clock[t])) / SIGMA) ** 2
        ),
        quantity_of_interest=lambda x, t, p: (x[0], x[1], x[2]),
        initial_noise=("normal",) * 3,
        process_noise=(),
        measurement_noise=("normal",),
        parameters={"clock": TIMES},
    )


@pytest.mark.slow
def test_samples_of_theophylline_are_those_of_a_bayesian_d_optimal_design(tmp_path: Path) -> None:
    """The plan is one of the best sets by the prior's mean of log det(1 + Fisher matrix)."""
    sets, rng = [*combinations(range(len(TIMES)), 3)], np.random.default_rng(1)
    x, step = rng.standard_normal((3, 4000)), 1e-5
    slopes = np.empty((3, len(TIMES), x.shape[1]))

    def at(shifted: Any) -> Any:
        own = [m * np.exp(s * each) for (m, s), each in zip(PRIOR.values(), shifted, strict=True)]
        return np.stack([concentration(*own, t) for t in TIMES])

    for k in range(3):
        moved = np.eye(3)[k][:, None] * step
        slopes[k] = (at(x + moved) - at(x - moved)) / (2 * step * SIGMA)
    by_fisher = []
    for times in sets:
        own = slopes[:, list(times)].transpose(2, 0, 1)
        matrices = np.eye(3) + own @ own.transpose(0, 2, 1)
        by_fisher.append(np.linalg.slogdet(matrices)[1].mean() / 2)
    problem = Problem(theophylline(), horizon=len(TIMES) - 1, measurement_budget=3, particles=2000)
    changes = [NATS, "comparison.draws=1000"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    found = by_fisher[sets.index(tuple(run.best.measurement_times))]
    assert found > max(by_fisher) - 0.05
    assert run.best.information == pytest.approx(found, abs=0.15)
