"""A command opens its run once, reads listed files only, and passes on what it has read."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.guided import sharp_walk
from pfdist import Job, Problem
from pfdist.filters.proposal import PLAIN
from pfdist.kernels.rules import Thresholds
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.plugins.rule.rule_file import keep_rule, rule_json
from pfdist.problem.feasible import Feasible
from pfdist.runner import build as builds
from pfdist.runner import choice
from pfdist.store import listing
from pfdist.store.tables import _known as tables


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


@pytest.mark.parametrize(
    ("model", "proposal"), [("ungm", PLAIN.name), (sharp_walk(6), GUIDED.name)]
)
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

    monkeypatch.setattr(choice, "_choices", {})
    monkeypatch.setattr(builds, "recorded_evaluator", recording)
    monkeypatch.setattr(builds, "few_draws", drawing)
    problem = Problem(model, horizon=8, measurement_budget=2, particles=120)
    job = problem.job(search=[{"method": "random", "evaluations": 2}], comparison={"draws": 9000})
    run = pfdist.run(job, tmp_path / "run", bound_draws=0, pool="serial", figures=False)
    assert run.job["filter"]["proposal"] == proposal
    assert counted == {"recorded": 1} | ({} if model == "ungm" else {"checked": 1})


_watching = list[set[str]]()


def _watch(event: str, given: tuple[Any, ...]) -> None:
    """Python calls this function for ever, for whatever it opens."""
    if _watching and event == "open" and isinstance(given[0], str | bytes | os.PathLike):
        _watching[0].add(os.path.realpath(os.fsdecode(given[0])))


@pytest.fixture
def opened() -> Iterator[set[str]]:
    """The paths of all files that Python opens."""
    if not hasattr(sys, "_pfdist_watched"):
        sys._pfdist_watched = True  # type: ignore[attr-defined]
        sys.addaudithook(_watch)
    _watching.append(set())
    yield _watching[0]
    _watching.clear()


@pytest.mark.plugins("filter", "online", "runs", "why")
@pytest.mark.usefixtures("undrawn")
def test_commands_open_no_file_of_a_run_that_files_json_does_not_list(
    small_run: pfdist.Run, tmp_path: Path, said: Callable[..., str], opened: set[str]
) -> None:
    """Whatever is not listed with its hash may have come from anybody, or be half written."""
    run, table = small_run.path, tmp_path / "one.csv"
    table.write_text("t,y0\n1,0.5\n")
    keep_rule(
        run, {"rule": rule_json(Thresholds((1.0,)), Feasible(horizon=12, measurement_budget=4))}
    )
    said("report", run)
    tables.clear()
    listing._known.clear()
    opened.clear()
    words = [("status", run), ("list", tmp_path), ("table", run), ("verify", run), ("plot", run),
             ("next", run, table, "--rule"), ("filter", run, table, "--no-report"),
             ("evaluate", run / "job.toml", "--times", "1,2,3,4", "--draws", "20"),
             ("why", run, "--draws", "20")]  # fmt: skip
    for each in words:
        said(*each)
    files = {Path(name) for name in opened if not Path(name).is_dir()}
    inside = {file.relative_to(run.resolve()) for file in files if run.resolve() in file.parents}
    content = json.loads((run / "files.json").read_text())
    listed = {"files.json", ".lock", *content["about"], *content["files"], *content["pages"]}
    written = {name for name in inside if name.suffix == ".tmp" or name.parts[0] == "parts"}
    assert {"rule.json", "sets.json", "model.json"} <= set(map(str, inside))
    assert set(map(str, inside - written)) - listed == set()
