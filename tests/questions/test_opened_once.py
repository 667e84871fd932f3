"""A command opens its run once, and passes on what it has read."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
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
