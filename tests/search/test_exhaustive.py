"""Exhaustive search is brute force in batches."""

from pathlib import Path

import numpy as np
import pytest

from oracles.searched import last
from pfdist import load_job
from pfdist.errors import JobError
from pfdist.runner.build import build
from pfdist.search import Exhaustive
from pfdist.search.base import FINALISTS
from pfdist.times.feasible import Feasible


def test_it_finds_what_brute_force_finds() -> None:
    feasible = Feasible(15, 4)
    costs = dict(zip(feasible.every(), np.random.default_rng(1).random(1820), strict=True))
    search = Exhaustive(feasible, limit=1820)
    found = search.finalists(last(search, costs.__getitem__))
    assert [evaluation.measurement_times for evaluation in found] == sorted(costs, key=costs.get)[
        :FINALISTS
    ]  # type: ignore[arg-type]
    assert search.generations == 4


def test_too_many_sets_are_refused(tmp_path: Path) -> None:
    text = "seed = 1\n[problem]\nhorizon = 60\nmeasurement_budget = 21\n"
    (tmp_path / "job.toml").write_text(text + '[[search]]\nmethod = "exhaustive"\nname = "mine"\n')
    with pytest.raises(
        JobError, match=r"search.mine: .* limit = 100,000 sets .*, got 12,176,31.* \(.*job.toml\)"
    ):
        build(load_job(tmp_path / "job.toml"))
