"""Runs whose figures tests draw."""

from pathlib import Path

import pytest

import pfdist
from pfdist.analysis import Run

ROOT = Path(__file__).parents[1]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]  # compiles no filter of a search


@pytest.fixture(scope="session")
def plain() -> Run:
    """A run of two searches, one of which estimates otherwise than the comparison."""
    return pfdist.open_run(ROOT / "assets" / "schema-3")


@pytest.fixture(scope="session")
def proved(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with forbidden instants, online times, a lower bound, and the worth of measurements."""
    folder = tmp_path_factory.mktemp("proved") / "run"
    changes = [*EXACT, "search.random.evaluations=3", "search.genetic.generations=1"]
    changes += ["online.draws=20", "problem.forbidden=[7, '9-10']"]
    run = pfdist.run(ROOT / "small.toml", folder, changes=changes, figures=False)
    pfdist.bound(run, pool="serial", figures=False)
    pfdist.why(run, figures=False)
    return run


@pytest.fixture(scope="session")
def several(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run for several numbers of measurements."""
    job = pfdist.load_job(ROOT / "small.toml", [*EXACT, "problem.horizon=6"])
    folder = tmp_path_factory.mktemp("several") / "budget"
    return pfdist.budget(job, (2, 3), folder, draws=20, figures=False)
