"""With threads, a plan needs nothing that only Linux has: /proc, control groups, affinity."""

import io
import os
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.pools.cores import usable_cores
from pfdist.runner import provenance


@pytest.fixture
def not_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    """No file below /proc and /sys opens."""
    real = io.open

    def opened(path: Any, *arguments: Any, **settings: Any) -> Any:
        if str(path).startswith(("/proc", "/sys")):
            raise FileNotFoundError(2, "there is no such file", str(path))
        return real(path, *arguments, **settings)

    monkeypatch.setattr("io.open", opened)
    monkeypatch.setattr("builtins.open", opened)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(provenance, "processor", provenance.processor.__wrapped__)  # no cache


@pytest.mark.usefixtures("not_linux")
def test_a_plan_on_threads_needs_no_linux(small_job: Job, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Path("/proc/cpuinfo").read_text(encoding="utf-8")
    assert usable_cores() == os.cpu_count()
    run = pfdist.plan(small_job, tmp_path / "run", pool="threads", bound_draws=0, figures=False)
    assert run.state == "finished"
