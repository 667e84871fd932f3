"""Searches for other criteria against all sets, and the numbers that answers give of them."""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

import pfdist
from oracles.walks import WALK
from pfdist import StateSpaceModel
from pfdist.errors import JobError, PfdistError
from pfdist.filters.criteria.quantile import Quantile
from pfdist.filters.criterion import Sample, criterion_named
from pfdist.filters.kalman import expected_errors
from pfdist.pages.terminal import lines_of
from pfdist.questions.evaluate import evaluated
from pfdist.questions.run_page import answer_of
from pfdist.runner.build import build

HORIZON, QUANTILE = 9, "quantile 0.9"
RESTLESS = WALK.with_parameters({"early": 1.5, "late": 0.4})
SETS = [*combinations(range(HORIZON + 1), 2)]
OPTIONS: dict[str, Any] = {"figures": False, "report": False}

RIGHT = np.array([0.2, 0.9])  # probability of a yes in state 0 and state 1


def _flips(t: int) -> float:
    """Probability that the chain changes its state after t."""
    return 0.25 if t in (3, 4) else 0.02


CHAIN = StateSpaceModel(
    name="chain with a yes/no sensor",
    initial=lambda w, p: (np.where(w[0] < 0.5, 1.0, 0.0),),
    transition=lambda x, t, w, p: (np.where(w[0] < _flips(t), 1.0 - x[0], x[0]),),
    measurement=lambda x, t, v, p: (np.where(v[0] < 0.2 + 0.7 * x[0], 1.0, 0.0),),
    log_likelihood=lambda y, x, t, p: np.log(
        np.where(y[0] > 0.5, 0.2 + 0.7 * x[0], 0.8 - 0.7 * x[0])
    ),
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("uniform",),
    process_noise=("uniform",),
    measurement_noise=("uniform",),
)


def _errors_of_chain(times: Sequence[int]) -> Any:
    """The exact filter's expected error at each instant, over all sequences of answers.

    A row has the joint probabilities of a sequence and of the two states; the error is the variance
    of the state.
    """
    rows, errors = np.array([[0.5, 0.5]]), []
    for t in range(HORIZON + 1):
        if t in times:
            rows = np.concatenate([rows * RIGHT, rows * (1 - RIGHT)])
        errors.append(np.sum(rows.prod(axis=1) / rows.sum(axis=1)))
        rows = rows @ np.array([[1 - _flips(t), _flips(t)], [_flips(t), 1 - _flips(t)]])
    return np.array(errors)


Chain = Callable[[str], tuple[Any, Path]]


def _problem(model: StateSpaceModel, criterion: str, engine: str) -> pfdist.Problem:
    problem = pfdist.Problem(model, horizon=HORIZON, measurement_budget=2, engine=engine)
    return problem.with_changes(criterion=criterion, particles=300, proposal="plain")


def _planned(model: StateSpaceModel, criterion: str, engine: str, path: Path) -> Any:
    """The found set, as a row of the table of sets."""
    changes = ["comparison.draws=2000", "execution.pool=serial"]
    problem = _problem(model, criterion, engine)
    run = pfdist.plan(problem, path, changes=changes, bound_draws=0, **OPTIONS)
    return run.table("sets").query("kind == 'found'").iloc[0]


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    """The found set of the chain and its run, by the criterion."""
    folder = tmp_path_factory.mktemp("chain")

    @cache
    def plan(criterion: str) -> tuple[Any, Path]:
        return _planned(CHAIN, criterion, "compiled", folder / criterion), folder / criterion

    return plan


def test_the_exact_engine_finds_the_set_of_the_least_largest_error(tmp_path: Path) -> None:
    """All sets, by the variances of the Kalman filter; the best mean has another set."""
    errors = expected_errors(RESTLESS, HORIZON, SETS)
    worst = errors.max(axis=1)
    row = _planned(RESTLESS, "worst_instant", "kalman", tmp_path)
    assert row["worst_instant"] == row["worst_instant_low"] == pytest.approx(worst.min())
    assert row["criterion_value"] == row["search_mse"] == pytest.approx(worst.min())
    assert row["search_excess"] == pytest.approx(0.0, abs=1e-12)
    assert row["expected_mse"] == pytest.approx(
        errors[SETS.index(tuple(row["measurement_times"]))].mean()
    )
    assert row["expected_mse"] > errors.mean(axis=1).min() * 1.01


def test_particles_find_a_set_whose_largest_error_is_least_by_enumeration(chain: Chain) -> None:
    """All sets of a two-state chain, whose errors are sums over all answers of its sensor."""
    worst = [_errors_of_chain(times).max() for times in SETS]
    row, _ = chain("worst_instant")
    found = worst[SETS.index(tuple(row["measurement_times"]))]
    assert found <= min(worst) + 3 * row["search_standard_error"] < np.mean(worst)
    assert row["worst_instant_low"] < found < row["worst_instant_high"]
    assert row["search_cause"].startswith("chance") or abs(row["search_excess"]) < 0.1


@pytest.mark.parametrize(("model", "engine"), [(RESTLESS, "kalman"), (CHAIN, "compiled")])
def test_a_search_finds_a_set_of_the_least_quantile_on_many_draws_of_all_sets(
    model: StateSpaceModel, engine: str, tmp_path: Path, chain: Chain
) -> None:
    is_chain = model is CHAIN
    row = chain(QUANTILE)[0] if is_chain else _planned(model, QUANTILE, engine, tmp_path)
    built = build(_problem(model, QUANTILE, engine).job())
    work = built.evaluator.work(SETS, 7, 7, (0, 4000), built.comparing)
    of_sets = built.evaluator.filtered(work).mse.T
    quantiles = np.quantile(of_sets, 0.9, axis=1, method="inverted_cdf")
    place = SETS.index(tuple(row["measurement_times"]))
    form = criterion_named(QUANTILE)
    assert isinstance(form, Quantile)
    error = form.of_sample(Sample(of_sets[place])).standard_error
    assert quantiles[place] <= quantiles.min() + 3 * error < np.median(quantiles)
    assert abs(row["quantile"] - quantiles[place]) < 4 * (error + row["search_standard_error"])
    assert row["search_mse"] == pytest.approx(row["quantile"], rel=0.2)


@pytest.mark.parametrize("method", [pytest.param("exchange", marks=pytest.mark.slow), "exhaustive"])
def test_a_quantile_is_not_that_of_the_variance_of_particles(method: str, tmp_path: Path) -> None:
    """These searches judge means by it."""
    run = pfdist.plan(
        _problem(RESTLESS, QUANTILE, "compiled"), tmp_path / "run", search=method,
        changes=["comparison.draws=500"], bound_draws=0, **OPTIONS,
    )  # fmt: skip
    row = run.table("sets").iloc[-1]
    assert row["search_mse"] == pytest.approx(row["quantile"], rel=0.25)
    assert row["search_mse"] > 1.25 * row["expected_mse"]


# --- evaluate, and what is not accepted -----------------------------------------------------------

ALSO = f"worst_instant,{QUANTILE}"
TIMES = {"a": "0,4", "b": "8,9"}


def test_evaluate_judges_by_the_draws_of_the_mse() -> None:
    problem = _problem(RESTLESS, "expected_mse", "compiled")
    found = pfdist.evaluate(problem, TIMES, draws=500, also=ALSO, profile=True)
    for each in found.values():
        assert each.profile is not None
        worst, quantile = each.also["worst_instant"], each.also["quantile"]
        assert worst.value == each.profile["error"].max()
        assert quantile.value == np.quantile(each.mse, 0.9, method="inverted_cdf")
        assert quantile.low < quantile.value < quantile.high
        assert each.expected_mse == each.mse.mean()
    again = pfdist.evaluate(problem, TIMES, draws=500)
    assert again["a"].expected_mse == found["a"].expected_mse
    assert again["a"].also == {}


def test_the_exact_engine_has_the_exact_worst_instant_and_draws_for_a_quantile() -> None:
    found = pfdist.evaluate(_problem(RESTLESS, "worst_instant", "kalman"), [0, 4], also=QUANTILE)
    worst = expected_errors(RESTLESS, HORIZON, [(0, 4)]).max()
    assert found.also["worst_instant"] == pytest.approx((worst,) * 3)
    assert found.also["quantile"].low < found.also["quantile"].high
    assert found.draws == 0
    assert found.standard_error == 0.0


def _said(job: str, **options: Any) -> tuple[str, Any]:
    answer = evaluated(job, draws=300, **options)
    return " ".join("\n".join(lines_of(answer._page())).split()), answer.as_json()


@pytest.fixture
def job(tmp_path: Path) -> str:
    path = tmp_path / "walk.toml"
    path.write_text(
        'seed = 1\n[model]\nname = "random_walk"\n[problem]\nhorizon = 9\nmeasurement_budget = 2\n'
        '[filter]\nparticles = 100\nproposal = "plain"\n[[search]]\nmethod = "random"\n'
        '[comparison]\ndraws = 50\n[execution]\npool = "serial"\n'
    )
    return str(path)


def test_the_criterion_of_the_job_leads_and_columns_say_which_quantile(job: str) -> None:
    said, answer = _said(job, times={"": "0,4"}, changes=[f"problem.criterion={QUANTILE}"])
    assert said.startswith("90 % quantile of the MSE: ")
    assert "Expected MSE" in said
    assert answer["quantile_low"] < answer["quantile"] < answer["quantile_high"]
    said, answer = _said(
        job, times=TIMES, changes=["problem.criterion=worst_instant"], also=QUANTILE
    )
    assert said.startswith("a has the lowest expected error at the worst instant, ")
    assert all(text in said for text in ("% lower", "than b", "90 % quantile"))
    assert answer["sets"]["a"]["worst_instant"] < answer["sets"]["b"]["worst_instant"]
    said, _ = _said(job, times={"": "0,4"}, also="worst_instant")
    assert said.startswith("Expected MSE ")
    said, answer = _said(job, times=TIMES, changes=["problem.criterion=information"], also=ALSO)
    assert said.startswith("No clear difference: the information of a is ")
    assert "nats (95 % CI" in said
    of_a = answer["sets"]["a"]
    assert of_a["expected_mse"] > 0 < of_a["information_low"] < of_a["information_high"]


@pytest.mark.parametrize(
    ("also", "message"),
    [
        ("worst", "got 'worst'; did you mean 'worst_instant'"),
        ("quantile 1.5", "got 'quantile 1.5'"),
        ("quantile 0.5,quantile 0.9", "one run has one quantile"),
    ],
)
def test_other_names_end_in_a_line(job: str, also: str, message: str) -> None:
    with pytest.raises(JobError, match=message):
        pfdist.evaluate(job, "0,4", also=also)


def test_the_bound_of_the_worst_instant_is_the_best_weighted_mean(tmp_path: Path) -> None:
    """The value of a game: one chooses the shares of the instants, the other one the set.

    `linprog` solves it over all sets. The largest error of no set lies below it. Separate draws, or
    too few steps, may choose shares that are not the best ones, which is safe.
    """
    errors = expected_errors(RESTLESS, HORIZON, SETS)
    least = errors.max(axis=1).min()
    above = np.hstack([-errors, np.ones((len(SETS), 1))])  # value <= shares . errors of each set
    game = linprog(
        [*np.zeros(HORIZON + 1), -1.0], above, np.zeros(len(SETS)),
        A_eq=[[1.0] * (HORIZON + 1) + [0.0]], b_eq=[1.0],
    )  # fmt: skip
    value = -game.fun
    assert errors.mean(axis=1).min() < 0.9 * value  # so equal weights are not the best
    for engine, particles in (("kalman", 100), ("compiled", 400)):
        problem = pfdist.Problem(
            RESTLESS, horizon=HORIZON, measurement_budget=2, particles=particles, engine=engine,
            criterion="worst_instant",
        )  # fmt: skip
        job = problem.job(search=[{"method": "exhaustive"}], comparison={"draws": 480})
        run = pfdist.run(job, tmp_path / engine, figures=False, pool="serial")
        (gap,) = (each for each in pfdist.bound(run, draws=480).gaps if each.name == "exhaustive")
        noise = 4 * gap.bound.standard_error
        assert gap.reason == ""
        assert 0.95 * value - noise < gap.bound.value < value * (1 + 1e-9) + noise
        assert gap.gap_at_most >= 1 - value / least - 1e-9
        assert "expected error at the worst instant" in " ".join(str(answer_of(run)).split())


def test_the_bound_of_the_worst_instant_has_shares_of_few_groups_on_a_long_horizon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Instants of a group have equal shares, those without weight none: still a lower bound."""
    monkeypatch.setattr("pfdist.runner.by_instant._MOST_GROUPS", 3)
    counted = slice(2, None)
    problem = pfdist.Problem(
        RESTLESS, horizon=HORIZON, measurement_budget=2, engine="kalman", criterion="worst_instant",
        instant_weights=[0, 0] + [1] * (HORIZON - 1),
    )  # fmt: skip
    job = problem.job(search=[{"method": "exhaustive"}], comparison={"draws": 24})
    run = pfdist.run(job, tmp_path / "run", figures=False, pool="serial")
    found = pfdist.bound(run)
    (gap,) = (each for each in found.gaps if each.name == "exhaustive")
    errors = expected_errors(RESTLESS, HORIZON, SETS)[:, counted]
    assert errors.mean(axis=1).min() * (1 + 1e-9) < gap.bound.value <= errors.max(axis=1).min()
    shares = np.array(found.shares)
    assert shares.sum() == pytest.approx(1.0)
    assert not shares[:2].any()
    assert len({*shares[counted].round(12)}) <= 3
    weighted = (errors @ shares[counted]).min()
    assert gap.bound.value == pytest.approx(weighted, rel=1e-9)


def _information_of_chain(times: Sequence[int]) -> float:
    """The information of the answers about the path, in nats: their entropy less that of noise."""
    if not times:
        return 0.0
    rows, noise = np.array([[0.5, 0.5]]), list[float]()
    for t in range(HORIZON + 1):
        if t in times:
            rows = np.concatenate([rows * RIGHT, rows * (1 - RIGHT)])
        state = rows.sum(axis=0)
        if t in times:
            noise.append(-np.sum(state * (RIGHT * np.log(RIGHT) + (1 - RIGHT) * np.log(1 - RIGHT))))
        rows = rows @ np.array([[1 - _flips(t), _flips(t)], [_flips(t), 1 - _flips(t)]])
    answers = rows.sum(axis=1)
    return float(-np.sum(answers * np.log(answers)) - sum(noise))


EXACT: dict[str, Callable[[Sequence[int]], float]] = {
    "worst_instant": lambda times: float(_errors_of_chain(times).max()),
    "information": lambda times: -_information_of_chain(times),
}


@pytest.mark.plugins("why")
@pytest.mark.parametrize("criterion", [*EXACT, QUANTILE])
def test_why_tells_the_worth_by_the_criterion_of_the_job(criterion: str, chain: Chain) -> None:
    """Exactly for a chain, whose numbers are sums over all answers; a quantile by its draws."""
    answer = pfdist.why(chain(criterion)[1], 2000, figures=False)
    worth, moved = (each[each["position"] == 1] for each in (answer.worth, answer.sampling_windows))
    times = tuple(worth["t"].astype(int))
    if criterion in EXACT:
        exact = EXACT[criterion]
        for row in worth.to_dict("records"):
            rest = exact([t for t in times if t != row["t"]]) - exact(times)
            assert abs(row["removed"] - rest) < 4 * row["removed_error"] + 0.01 * abs(exact(times))
    else:
        assert (worth["removed"] > -3 * worth["removed_error"]).all()
    own = moved[moved["t"] == moved["moved_to"]]
    assert (own[["loss", "lower_limit", "upper_limit"]] == 0.0).all(axis=None)
    for row in moved.to_dict("records") if criterion in EXACT else ():
        changed = sorted({*times} - {row["t"]} | {row["moved_to"]})
        loss = (exact(changed) - exact(times)) / abs(exact(times))
        assert abs(row["loss"] - loss) < 4 * row["loss_error"] + 0.01
    said = " ".join(" ".join(lines_of(answer._page())).split())
    label = criterion_named(criterion).label
    worsens = "falls" if criterion == "information" else "rises"
    assert f"(without it, the {label} {worsens} by " in said


@pytest.mark.plugins("why")
def test_why_is_exact_with_an_exact_engine(tmp_path: Path) -> None:
    row = _planned(RESTLESS, "worst_instant", "kalman", tmp_path / "run")
    answer = pfdist.why(tmp_path / "run", figures=False)
    times = tuple(row["measurement_times"])
    worth = answer.worth[answer.worth["name"] == row["name"]]
    worst = expected_errors(RESTLESS, HORIZON, [times, times[1:], times[:1]]).max(axis=1)
    np.testing.assert_allclose(worth["removed"], worst[1:] - worst[0], rtol=1e-9)
    assert (worth["removed_error"] == 0.0).all()


@pytest.mark.plugins("budget", "online")
def test_questions_that_need_means_end_in_a_line(job: str, tmp_path: Path) -> None:
    changes = ["problem.criterion=worst_instant"]
    run = pfdist.plan(
        job, tmp_path / "run", changes=changes, search="random", bound_draws=0, **OPTIONS
    )
    head = "expected error at the worst instant"
    assert head in " ".join("\n".join(lines_of(answer_of(run))).split())
    refused: dict[str, Callable[[], Any]] = {
        "needs the expected MSE as": lambda: pfdist.Planner(pfdist.load_job(job, changes)),
        "budget needs the expected MSE": lambda: pfdist.budget(job, (1, 2), changes=changes),
        "online needs the expected MSE": lambda: pfdist.load_job(
            job, [*changes, "online.draws=20"]
        ),
        "polish = true, got relaxation": lambda: pfdist.load_job(
            job, [*changes, 'search=[{method="relaxation",polish=false}]']
        ),
    }
    for message, ask in refused.items():
        with pytest.raises(PfdistError, match=message):
            ask()


@pytest.mark.plugins("runs", "sweep")
def test_every_view_of_a_run_shows_its_criterion_and_its_unit(tmp_path: Path) -> None:
    """The repr of sets and evaluations, JSON, the table of sets, `list`, `table` and sweeps."""
    problem, times = _problem(WALK, "information", "kalman"), "2,5"
    changes = ["comparison.draws=100", "execution.pool=serial"]
    swept = pfdist.sweep(
        problem, {"seed": [1, 2]}, results=tmp_path / "s", changes=changes, **OPTIONS
    )
    run = swept.runs["seed=1"]
    nats = f"information {run.best.information:.4f}"
    assert nats in repr(run.best)
    assert "nats" in repr(run.best)
    judged = pfdist.evaluate(problem, times)
    assert f"information {judged.also['information'].text('nats')}, expected MSE " in repr(judged)
    both = run.as_json(), evaluated(str(run.path), times={"": times}).as_json()
    assert {(each["criterion"], each["criterion_unit"]) for each in both} == {
        ("information", "nats")
    }
    table = run.table("sets")
    assert [*table.columns].index("information") < [*table.columns].index("expected_mse")
    assert table.attrs["units"] == {"information": "nats"}
    rows = swept.table()
    assert set(rows["criterion"]) == {"information"}
    np.testing.assert_allclose(rows["judged"], run.best.information)
    np.testing.assert_allclose(rows["judged_gain"], run.best.criterion_gain)
    page = "\n".join(lines_of(swept._page()))
    assert "The information is " in page
    assert "information, nats" in str(swept._page())
    assert pfdist.table(swept.path, out=tmp_path / "t.csv").equals(rows)
    pfdist.table(swept.path, out=tmp_path / "t.csv")  # it is an earlier table
    listed = pfdist.list_runs(tmp_path / "s")
    assert all("nats more than" in found for found in listed["found"])
    assert set(listed["criterion"]) == {"information"}
    plain = problem.with_changes(criterion="expected_mse")
    other = pfdist.plan(plain, tmp_path / "mse", changes=changes, bound_draws=0, **OPTIONS)
    assert "criterion" not in pfdist.table(other)
    assert "nats" not in repr(other.best) + repr(pfdist.evaluate(plain, times))
