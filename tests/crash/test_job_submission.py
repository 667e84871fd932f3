"""A driver that ``ray job submit`` starts on the cluster itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import pfdist
from crash.nodes import Nodes, nodes
from crash.runs import until
from oracles.bytes_of import hashes


def ray_job(cluster: Nodes, word: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "ray.scripts.scripts", "job", word, *arguments],
        env=os.environ | cluster.environment | {"RAY_ADDRESS": cluster.jobs},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_a_submitted_run_is_stopped_and_submitted_again_and_loses_nothing(tmp_path: Path) -> None:
    small = (Path(__file__).parents[1] / "small.toml").read_text()
    job, run = tmp_path / "job.toml", tmp_path / "run"
    job.write_text(small.replace("250", "600000"))
    whole = pfdist.run(job, tmp_path / "whole", pool="threads", workers=2, figures=False)
    words = [sys.executable, "-m", "pfdist", "run", str(job), "--results", str(run)]
    words += ["--pool", "ray", "--address", "auto", "--verbose"]
    with nodes(tmp_path, 3, takes_jobs=True) as cluster:
        first = ray_job(cluster, "submit", "--no-wait", "--submission-id=first", "--", *words)
        assert first.returncode == 0, first.stderr[-2000:]
        until(lambda: list(run.glob("parts/comparison/[!.]*.parquet")))
        stopped = ray_job(cluster, "stop", "first")
        assert stopped.returncode == 0, stopped.stderr[-2000:]
        said = ray_job(cluster, "logs", "first").stdout
        assert "3 workers" in said
        assert (
            "run the same command to resume" in said
        )  # it saved what was done, and ended by itself
        assert not (run / "tables" / "comparison").exists()
        again = ray_job(cluster, "submit", "--", *words)
        assert again.returncode == 0, again.stdout[-2000:]
    assert hashes(run) == hashes(whole.path)
