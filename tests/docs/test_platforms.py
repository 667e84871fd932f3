"""The page about installing: what it promises about other systems than Linux."""

import os
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.runner import provenance

LINUX = ("/proc/", "/sys/")


@pytest.fixture
def _not_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing lies in /proc and /sys, and the affinity of a process is unknown, as on macOS."""
    read = Path.read_text

    def read_text(path: Path, *arguments: Any, **options: Any) -> str:
        if str(path).startswith(LINUX):
            raise FileNotFoundError(path)
        return read(path, *arguments, **options)

    monkeypatch.setattr(Path, "read_text", read_text)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(provenance, "processor", provenance.processor.__wrapped__)


@pytest.mark.usefixtures("_not_linux")
def test_a_plan_on_threads_needs_nothing_of_linux(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.plan(small_job, tmp_path / "run", pool="threads", bound_draws=0, figures=False)
    assert run.state == "finished"
    assert len(run.sets["relaxation"]) == len(run.sets["regular"])


def test_every_file_and_extra_that_the_page_names_exists() -> None:
    root = Path(__file__).parents[2]
    page = (root / "docs" / "install.md").read_text(encoding="utf-8")
    files = {
        "requirements/locked.txt",
        "docker/Dockerfile",
        "jobs/quick.toml",
        "docs/notebook.ipynb",
    }
    assert all((root / file).is_file() for file in files)
    assert all(Path(file).name in page for file in files)
    extras = (root / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("test", "notebook", "cluster", "docs"):
        assert f"'.[{name}]'" in page
        assert f"\n{name} = [" in extras
