"""Draws have one purpose: what searches chose is decided, and proved, on others."""

from collections import defaultdict
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.api.why import why
from pfdist.evaluation.estimate import BUDGET
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Work
from pfdist.runner.door import Batch
from pfdist.search.methods import DEFAULT_METHOD

SMALL = [
    f"search.{DEFAULT_METHOD}.evaluation.draws=20",
    f"search.{DEFAULT_METHOD}.evaluation.particles=10",
]


@pytest.fixture
def streams(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[int]]:
    """The keys of the draws, and of the filters' noise, that each phase has asked for."""
    seen = defaultdict[str, set[int]](set)
    init = Batch.__init__

    def recorded(self: Batch, *arguments: Any, **more: Any) -> None:
        init(self, *arguments, **more)
        seen[self.phase.partition(".proof")[0]] |= {  # a bound has several phases
            key for work in self.works for key in (work.draws_stream, *work.filter_streams)
        }

    monkeypatch.setattr(Batch, "__init__", recorded)
    return seen


def _asked_by(streams: dict[str, set[int]], compute: Callable[[], object]) -> dict[str, set[int]]:
    streams.clear()
    compute()
    return {phase: set(keys) for phase, keys in streams.items()}


def _phases(*ends: str) -> set[str]:
    return {f"{DEFAULT_METHOD}{end}" for end in ends}


@pytest.mark.slow
def test_no_two_phases_share_a_draw(
    small_job: Job, tmp_path: Path, streams: dict[str, set[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    paper = _asked_by(streams, lambda: pfdist.run(small_job, tmp_path / "run", figures=False))
    assert paper.keys() == {"genetic", "random", "comparison"}
    plan = _asked_by(
        streams,
        lambda: pfdist.plan(
            small_job, tmp_path / "plan", changes=[*SMALL, "seed=1"], figures=False
        ),
    )
    first = {"", ".polish", ".probe"}  # 10 particles fool themselves
    again = {".again", ".again.polish", ".again.shortlist"}
    assert plan.keys() == _phases(*first, *again) | {"comparison", "bound"}
    budget = _asked_by(
        streams,
        lambda: pfdist.budget(
            small_job, (2, 3), tmp_path / "budget", 30, changes=SMALL, figures=False
        ),
    )
    assert budget.keys() == _phases("", ".probe", ".again") | {"comparison", "bound"}
    # The bound filters the compared sets on the draws of the comparison, with noise of its own:
    draws = BUDGET.stream(small_job.seed, "draws")
    assert budget["comparison"] & budget["bound"] == {draws}
    budget["bound"].remove(draws)
    for phases in (paper, plan, budget):
        for keys, other_keys in combinations(phases.values(), 2):
            assert keys
            assert not keys & other_keys
    # A number that was found by its budget is proved by a plan, on draws that did not choose it.
    assert not budget["comparison"] & plan["comparison"]

    works: list[Work] = []
    filtered = Evaluator.filtered
    monkeypatch.setattr(
        Evaluator, "filtered", lambda self, work: works.append(work) or filtered(self, work)
    )
    monkeypatch.setattr("pfdist.api.why.draw_figures", lambda *run: [])
    why(tmp_path / "plan" / "job.toml", draws=100)
    assert len({work.draws_stream for work in works}) == 2  # the windows do not choose their jitter
    explaining = {key for work in works for key in (work.draws_stream, *work.filter_streams)}
    assert explaining
    for keys in (*paper.values(), *plan.values(), *budget.values()):
        assert not explaining & keys
