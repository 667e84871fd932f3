"""Draws have one purpose: what searches chose is decided, and proved, on others."""

from collections import defaultdict
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.common.streams import CHOOSING, PROVING, stream_of
from pfdist.filters.criterion import MEAN
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork
from pfdist.plugins.why.question import why
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.runner.build import build
from pfdist.runner.door import WorkBatch
from pfdist.runner.phase import Phase

SMALL = [
    f"search.{DEFAULT_METHOD}.evaluation.draws=20",
    f"search.{DEFAULT_METHOD}.evaluation.particles=10",
]


@pytest.fixture
def streams(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[int]]:
    """The keys of the draws, and of the filters' noise, that each phase has asked for."""
    seen = defaultdict[str, set[int]](set)
    init = WorkBatch.__init__

    def recorded(self: WorkBatch, *arguments: Any, **more: Any) -> None:
        init(self, *arguments, **more)
        seen[self.phase.partition(".proof")[0]] |= {  # a bound has several phases
            key for work in self.works for key in (work.draws_stream, *work.filter_streams)
        }

    monkeypatch.setattr(WorkBatch, "__init__", recorded)
    return seen


def _asked_by(streams: dict[str, set[int]], compute: Callable[[], object]) -> dict[str, set[int]]:
    streams.clear()
    compute()
    return {phase: set(keys) for phase, keys in streams.items()}


def _phases(*ends: str) -> set[str]:
    return {f"{DEFAULT_METHOD}{end}" for end in ends}


def test_what_is_reported_comes_from_draws_that_chose_nothing(
    small_job: Job, tmp_path: Path, streams: dict[str, set[int]]
) -> None:
    run = pfdist.run(small_job, tmp_path / "run", figures=False)
    assert streams.keys() == {"genetic", "random", "comparison"}
    for keys, other_keys in combinations(streams.values(), 2):
        assert keys
        assert not keys & other_keys
    assert pfdist.evaluate(small_job, run.sets["genetic"], draws=20).purpose in PROVING


@pytest.mark.parametrize("purpose", PROVING)
def test_no_search_chooses_by_draws_that_prove(purpose: str, small_job: Job) -> None:
    built = build(small_job)
    search = built.searches[0]
    with pytest.raises(ValueError, match=f"no search may choose by .* '{purpose}'"):
        Phase("mine", search.optimiser, purpose, search.settings, built, MEAN)


def test_purposes_have_different_keys_and_others_are_refused() -> None:
    purposes = (*CHOOSING, *PROVING)
    assert len({stream_of(purpose, 1, "draws") for purpose in purposes}) == len(purposes)
    with pytest.raises(ValueError, match=r"purpose must be one of .* got 'mine'"):
        stream_of("mine", 1, "draws")


@pytest.mark.plugins("budget")
@pytest.mark.slow
def test_no_two_phases_share_a_draw(
    small_job: Job, tmp_path: Path, streams: dict[str, set[int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.searches._POLISH_DRAWS", 64)  # several sets are left to race
    paper = _asked_by(streams, lambda: pfdist.run(small_job, tmp_path / "run", figures=False))
    changes = [*SMALL, "seed=1"]
    plan = _asked_by(
        streams, lambda: pfdist.plan(small_job, tmp_path / "plan", changes=changes, figures=False)
    )
    assert plan.pop("evenly.spaced") & plan["comparison"]  # judged on the same draws
    others = {
        "comparison",
        "bound",
        "evenly_spaced.ranking",
        "rule.draws.choice",
        "rule.draws.tuning",
    }
    assert plan.keys() == _phases("", ".polish", ".shortlist") | others
    budget = _asked_by(
        streams,
        lambda: pfdist.budget(
            small_job, (2, 3), tmp_path / "budget", 30, changes=SMALL, figures=False
        ),
    )
    assert budget.keys() == {DEFAULT_METHOD, "comparison", "bound"}
    # The bound filters the compared sets on the draws of the comparison, with noise of its own:
    draws = stream_of("budget", small_job.seed, "draws")
    assert budget["comparison"] & budget["bound"] == {draws}
    budget["bound"].remove(draws)
    for phases in (paper, plan, budget):
        for keys, other_keys in combinations(phases.values(), 2):
            assert keys
            assert not keys & other_keys
    # A number that was found by its budget is proved by a plan, on draws that did not choose it.
    # Only filters that measure the loss by particles have the same noise, on different draws.
    losses = {
        stream_of("comparison", 1, "filter", table)
        for table in ("filter_distance", "filter_variance")
    }
    assert budget["comparison"] & plan["comparison"] <= losses

    works: list[FilterWork] = []
    filtered = Evaluator.filtered
    monkeypatch.setattr(
        Evaluator, "filtered", lambda self, work: works.append(work) or filtered(self, work)
    )
    monkeypatch.setattr("pfdist.plots.draw_figures", lambda *run: [])
    why(tmp_path / "plan" / "job.toml", draws=100)
    assert len({work.draws_stream for work in works}) == 1
    explaining = {key for work in works for key in (work.draws_stream, *work.filter_streams)}
    assert explaining
    for keys in (*paper.values(), *plan.values(), *budget.values()):
        assert not explaining & keys
