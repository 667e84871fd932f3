"""Which processors computed a run stands in run.json; what may differ between them is said."""

import json
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.runner import provenance as provenance_module

HERE = {"compiled_for": "haswell", "model": "A processor"}
THERE = {"compiled_for": "znver3", "model": "Another processor"}


def lines_when_it_goes_on(
    job: Job, path: Path, monkeypatch: pytest.MonkeyPatch, *elsewhere: dict[str, str]
) -> list[str]:
    """Give what a run says as it goes on with more draws, on each processor in turn."""
    monkeypatch.setattr(provenance_module, "processor", lambda: HERE)
    pfdist.run(job, path, figures=False)
    said: list[str] = []
    for more, other in enumerate(elsewhere, 1):
        monkeypatch.setattr(provenance_module, "processor", lambda other=other: other)
        draws = job.comparison.draws + 10 * more
        pfdist.run(
            job.with_changes([f"comparison.draws={draws}"]), path, say=said.append, figures=False
        )
    return [line for line in said if "processor" in line]


def provenance(path: Path) -> dict[str, Any]:
    about = json.loads((path / "run.json").read_text())
    found: dict[str, Any] = about["provenance"]
    return found


def test_the_processor_stands_in_the_provenance(small_run: pfdist.Run) -> None:
    found = provenance(small_run.path)
    assert found["processor"] == provenance_module.processor()
    assert set(provenance_module.processor()) == {"compiled_for", "model"}
    assert all(provenance_module.processor().values())


def test_nothing_is_said_where_nothing_may_differ(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run"
    assert lines_when_it_goes_on(small_job, path, monkeypatch, THERE, THERE, HERE) == []
    assert provenance(path)["processor"] == HERE
    (there,) = provenance(path)["continued_on"]
    assert there["processor"] == THERE


def test_every_version_that_computed_for_a_run_stands_in_run_json(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the run was moved, and another NumPy resumed it, twice."""
    path = tmp_path / "run"
    first = pfdist.run(small_job, path, figures=False)
    before = provenance(first.path)
    others = {name: f"9.{name}" for name in provenance_module._libraries()}
    monkeypatch.setattr(provenance_module, "_libraries", lambda: others)
    for draws in (10, 20):
        more = small_job.comparison.draws + draws
        pfdist.run(small_job.with_changes([f"comparison.draws={more}"]), path, figures=False)
    after = provenance(path)
    (there,) = after.pop("continued_on")
    assert after == before
    assert there["libraries"]["numpy"] == "9.numpy"
    assert (there["machine"], there["python"]) == (before["machine"], before["python"])
