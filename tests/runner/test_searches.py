"""Every search, from its section in a job to what it returns, where costs are known exactly."""

from pathlib import Path

import pytest

from pfdist.job.job import Job, load_job
from pfdist.job.sections import Execution
from pfdist.runner.build import build, make_pool
from pfdist.runner.door import Session, complete
from pfdist.runner.driver import drive
from pfdist.store import Store

JOB = """
seed = 1
[model]
name = "linear_gaussian"
[problem]
horizon = 12
measurement_budget = 3
[filter]
engine = "kalman"
[comparison]
draws = 2
"""
METHODS = {
    "annealing": "steps = 30",
    "corridor": "",
    "cross_entropy": "",
    "exchange": "",
    "exhaustive": "",
    "genetic": "",
    "greedy_backward": "",
    "greedy_forward": "",
    "random": "evaluations = 20",
    "relaxation": "",
    "survivors": "",
}
DO_NOT_GUESS = ("exchange", "exhaustive", "relaxation", "survivors")


@pytest.fixture(scope="module")
def costs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    folder: Path = tmp_path_factory.mktemp("searches")
    sections = [f'[[search]]\nmethod = "{name}"\n{keys}\n' for name, keys in METHODS.items()]
    (folder / "job.toml").write_text(JOB + "".join(sections))
    built, store = build(load_job(folder / "job.toml")), Store(folder / "run")
    complete(drive(Session(built, store)), make_pool(Execution(pool="serial")))
    sets = store.compared_sets()
    return dict(zip(sets, built.evaluator.expected_mse(list(sets.values())), strict=True))


def test_a_search_for_errors_of_instants_evaluates_all_on_whole_blocks_of_draws(
    small_job: Job,
) -> None:
    for method, draws in (("relaxation", 48), ("exchange", 30)):
        search = {"method": method, "evaluation": {"draws": 30}}
        built = build(load_job(small_job.path, settings={"search": [search]}))
        assert built.searches[0].settings.draws == draws
        if method == "relaxation":
            assert built.searches[0].optimiser.draws == draws


def test_no_search_finds_better_than_all_sets_have(costs: dict[str, float]) -> None:
    assert set(costs) == {"regular", *METHODS}
    assert min(costs.values()) == costs["exhaustive"]


@pytest.mark.parametrize("name", METHODS)
def test_a_search_finds_better_than_regular_times(costs: dict[str, float], name: str) -> None:
    assert costs[name] < costs["regular"]


@pytest.mark.parametrize("name", DO_NOT_GUESS)
def test_the_best_set_of_a_small_problem_is_found(costs: dict[str, float], name: str) -> None:
    assert costs[name] == costs["exhaustive"]


def test_a_filter_that_is_wrong_guides_a_search_by_its_own_variance_and_decides_nothing(
    small_job: Job,
) -> None:
    """Exchanges and races use the squared error, and so does the search if probes distrust it."""
    section = "[{method='survivors'}]"
    wrong = ["model.filter.parameters.process_sd=2.0", f"search={section}"]
    (search,) = build(small_job.with_changes(wrong)).searches
    assert search.settings.estimation.estimator == "own_variance"
    assert search.polishing is not None
    assert search.polishing.estimation.estimator == "squared_error"
    assert search.racing.estimation.estimator == "squared_error"
    assert search.again is not None
    assert search.again.settings.estimation.estimator == "squared_error"
    (search,) = build(small_job.with_changes([f"search={section}"])).searches
    assert search.settings.estimation.estimator == "filter_variance"
    assert search.polishing is not None
    assert search.polishing.estimation.estimator == "filter_variance"
