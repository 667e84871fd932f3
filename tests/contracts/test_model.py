"""The contract of every shipped model, and of every job file."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.clocked import with_clock
from oracles.in_turn import in_turn
from pfdist import Job, load_job, load_model
from pfdist.common.measurement_times import regular
from pfdist.filters import plain
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import installed_models
from pfdist.pools.kinds import POOLS

SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
FILES = sorted((Path(__file__).parents[2] / "jobs").glob("*.toml"))
SWEEPS = [path for path in FILES if path.read_text().count("\njob = ")]
JOBS = [path for path in FILES if path not in SWEEPS]
SCHEMES = sorted({(job.model.name, job.filter.resampling) for job in map(load_job, JOBS)})
QUICK = {"ungm"}  # the others are compiled by `pytest -m zoo`
QUICK_JOBS = {"quick"}
BELIEVED = {"tumour": {"frequency_sd": 0.005}}  # by the filter, where that is not the truth


def _by_model(cases: Iterable[Any], model_of: Callable[[Any], str]) -> list[Any]:
    """Mark what the default suite has no time for."""
    quick = {True: (), False: (pytest.mark.zoo,)}
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)), marks=quick[model_of(case) in QUICK]
        )
        for case in cases
    ]


@pytest.mark.parametrize(("name", "resampling"), _by_model(SCHEMES, lambda case: case[0]))
def test_compiled_and_plain_filter_agree(name: str, resampling: str) -> None:
    truth = with_clock(load_model(name, FILES[0].parent), 30)
    draws = simulate(truth, 30, range(4), 17)
    model = truth.with_parameters(BELIEVED.get(name, {}))
    arguments = (model, draws, regular(30, 11), 130, 23, resampling)
    fast, slow = (f(*arguments, trajectories=True) for f in (filter_draws, plain.filter_draws))
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-9)
    np.testing.assert_allclose(fast.estimate, slow.estimate, rtol=1e-9, atol=1e-9)


@in_turn("name", SHIPPED)
def test_there_is_a_job_of_it(name: str) -> None:
    assert name in {load_job(path).model.name for path in JOBS}


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.zoo] * (path.stem not in QUICK_JOBS), id=path.stem)
        for path in JOBS
    ],
)
def test_a_job_is_evaluated_and_runs(path: Path, tmp_path: Path) -> None:
    job = _small(path)
    times = job.problem.points.written_of(job.problem.feasible.regular())
    assert 0 < pfdist.evaluate(job, times).expected_mse < np.inf
    figures = path.stem not in QUICK_JOBS  # others draw those of the quick jobs
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=figures)
    assert run.state == "finished"
    assert np.isfinite(run.table("comparison")).all(axis=None)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quick", "constrained", "two_compartments"])
@pytest.mark.usefixtures("ray_cluster", "no_figures")
def test_every_pool_gives_a_job_the_same_bytes(name: str, tmp_path: Path) -> None:
    (path,) = (path for path in JOBS if path.stem == name)
    job = _small(path).with_changes(["search=[{method='random', evaluations=4}]"])
    runs = [pfdist.run(job, tmp_path / pool, pool=pool) for pool in POOLS]
    first, *others = (hashes(run.path) for run in runs)
    assert len(first) > 3
    assert all(other == first for other in others)


def _small(path: Path) -> Job:
    small = {"population": 4, "generations": 2, "evaluations": 4}
    changes = ["comparison.draws=50", "evaluation.draws=20", "filter.particles=50"]
    if load_job(path).section("online") is not None:
        changes.append("online.draws=2")
    job = load_job(path, changes)
    return job.with_changes(
        f"search.{search.name}.{key}={small[key]}"
        for search in job.search
        for key in small.keys() & search.settings.keys()
    )
