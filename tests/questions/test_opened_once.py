"""A command opens its run once, and passes on what it has read."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.guided import sharp_walk
from pfdist import Job, Problem
from pfdist.filters.work import GUIDED, PLAIN
from pfdist.runner import build as builds
from pfdist.store import listing


@pytest.mark.usefixtures("undrawn")
def test_a_run_reads_files_json_and_validates_a_job_at_most_three_times(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, read, made = Counter[str](), listing._read, Job.__init__

    def reading(path: Path) -> Any:
        counted["files.json"] += path.exists()
        return read(path)

    def making(self: Job, *given: Any, **fields: Any) -> None:
        counted["Job"] += 1
        made(self, *given, **fields)

    monkeypatch.setattr(listing, "_read", reading)
    monkeypatch.setattr(Job, "__init__", making)
    text, _, _ = small_job.path.read_text().partition("[[search]]")
    rest = '[[search]]\nmethod = "random"\nevaluations = 2\n[comparison]\ndraws = 20\n'
    small_job.path.write_text(f"{text}{rest}[model]\nname = 'random_walk'\n")
    run = pfdist.run(small_job.path, tmp_path / "run", pool="serial")
    assert 1 <= counted["Job"] <= 3
    assert counted["files.json"] <= 3
    assert run.state == "finished"
    changed = listing.read_listing(run.path)
    listing._known.clear()
    assert listing.read_listing(run.path) == changed  # what is in memory is what is in the file


@pytest.mark.parametrize(("model", "proposal"), [("ungm", PLAIN), (sharp_walk(3), GUIDED)])
def test_a_command_that_chooses_the_proposal_records_its_models_once(
    model: Any, proposal: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The proposal "auto", and a number of particles, are chosen with the recorded models."""
    counted, record, draw = Counter[str](), builds.recorded_evaluator, builds.few_draws

    def recording(*given: Any, **fields: Any) -> Any:
        counted["recorded"] += 1
        return record(*given, **fields)

    def drawing(*given: Any) -> Any:
        counted["checked"] += 1
        return draw(*given)

    monkeypatch.setattr(builds, "_choices", {})
    monkeypatch.setattr(builds, "recorded_evaluator", recording)
    monkeypatch.setattr(builds, "few_draws", drawing)
    problem = Problem(model, horizon=8, measurement_budget=2, particles=60)
    job = problem.job(search=[{"method": "random", "evaluations": 2}], comparison={"draws": 9000})
    run = pfdist.run(job, tmp_path / "run", bound_draws=0, pool="serial", figures=False)
    assert run.job["filter"]["proposal"] == proposal
    assert counted == {"recorded": 1} | ({} if model == "ungm" else {"checked": 1})
