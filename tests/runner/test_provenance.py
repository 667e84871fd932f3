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
    """A run goes on with more draws, on each processor in turn."""
    path, said = tmp_path / "run", list[str]()
    for more, processor in enumerate((HERE, THERE, HERE)):
        monkeypatch.setattr(provenance_module, "processor", lambda here=processor: here)
        draws = small_job.comparison.draws + 10 * more
        job = small_job.with_changes([f"comparison.draws={draws}"])
        pfdist.run(job, path, say=said.append, figures=False)
    assert not [line for line in said if "processor" in line]
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
    monkeypatch.setattr("pfdist.runner.provenance.version", lambda name: f"9.{name}")
    provenance_module._versions.cache_clear()
    for draws in (10, 20):
        more = small_job.comparison.draws + draws
        pfdist.run(small_job.with_changes([f"comparison.draws={more}"]), path, figures=False)
    provenance_module._versions.cache_clear()
    after = provenance(path)
    (there,) = after.pop("continued_on")
    assert after == before
    assert there["libraries"]["numpy"] == "9.numpy"
    assert (there["machine"], there["python"]) == (before["machine"], before["python"])
