"""Every search, from its section in a job to what it returns, where costs are known exactly."""

from dataclasses import replace
from pathlib import Path

import pytest

from pfdist.filters.exact import exact_mse
from pfdist.filters.work import Estimation
from pfdist.problem.job import Job, load_job
from pfdist.problem.sections import DEFAULT_METHOD, Execution
from pfdist.runner.build import build, make_pool
from pfdist.runner.door import RunSession, complete
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
reference = "regular"
draws = 2
"""
METHODS = {
    "corridor": "",
    "exchange": "",
    "exhaustive": "",
    "genetic": "",
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
    complete(drive(RunSession(built, store)), make_pool(Execution(pool="serial")))
    sets = store.compared_sets()
    return dict(zip(sets, exact_mse(built.evaluator, list(sets.values())), strict=True))


@pytest.mark.parametrize(("method", "draws"), [("relaxation", 48), ("exchange", 30)])
def test_a_search_for_errors_of_instants_evaluates_all_on_whole_blocks_of_draws(
    method: str, draws: int, small_job: Job
) -> None:
    changes = [f"search=[{{method='{method}', evaluation={{draws=30}}}}]"]
    (search,) = build(small_job.with_changes(changes)).searches
    assert search.settings.draws == getattr(search.optimiser, "draws", draws) == draws


def test_no_search_finds_better_than_all_sets_have(costs: dict[str, float]) -> None:
    assert set(costs) == {"regular", *METHODS}
    assert min(costs.values()) == costs["exhaustive"]


@pytest.mark.parametrize("name", METHODS)
def test_a_search_finds_better_than_regular_times_and_some_find_the_best_set(
    costs: dict[str, float], name: str
) -> None:
    assert costs[name] < costs["regular"]
    if name in DO_NOT_GUESS:
        assert costs[name] == costs["exhaustive"]


@pytest.mark.parametrize("method", ["survivors", DEFAULT_METHOD])
def test_the_variance_guides_a_search_if_it_is_the_error_and_never_polishes(
    method: str, small_job: Job
) -> None:
    """A cloud that collapses onto a wrong state has a tiny variance, and must decide nothing."""
    job = small_job.with_changes([f"search=[{{method='{method}'}}]"])
    wrong = job.with_changes(["model.filter.parameters.process_sd=2"])
    for each, guide in ((job, "filter_variance"), (wrong, "squared_error")):
        (search,) = build(each).searches
        assert search.settings.estimation.estimator == guide
        assert search.is_polished
        squared = replace(search.settings.estimation, estimator="squared_error")
        assert search.polishing.estimation == squared
        assert search.racing.estimation == Estimation(40, "multinomial", "squared_error")
