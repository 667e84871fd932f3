"""The batch scripts on a real Slurm, whose nodes are all on this machine."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import psutil
import pytest

import pfdist
from crash.runs import command_of, until
from crash.slurm import SCRIPTS, Slurm, slurm
from oracles.bytes_of import hashes
from pfdist import Job

pytestmark = pytest.mark.slurm

STRANGE = 'it\'s a "job" $(touch gone) `touch gone`'
LONG = ["filter.particles=10000", "comparison.draws=6000"]  # about ten seconds of a core
FEW = "comparison.draws=60"
NODES, CORES = 2, 2
AGAIN = "#!/bin/sh\nexit 75\n"
STARTS_THAT_COMMIT = """#!/bin/sh
mkdir -p results/small-plan/parts/draws
[ "${SLURM_RESTART_COUNT:-0}" -gt 1 ] || touch "results/small-plan/parts/draws/$(date +%N).parquet"
exit 75
"""
ENDLESS = """#!/bin/bash
trap 'exit 75' TERM
touch started
while true; do sleep 0.1; done
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator[Slurm]:
    with slurm(NODES) as started:
        yield started


@pytest.fixture
def folder(small_job: Job) -> Path:
    """A folder with a strange name, in which the scripts and the small job lie."""
    folder = small_job.path.with_name(STRANGE)
    shutil.copytree(SCRIPTS, folder / "jobs")
    shutil.copy(small_job.path, folder / "small.toml")
    return folder


def submit(cluster: Slurm, folder: Path, script: str, *words: str, options: str = "") -> str:
    few = ["--cpus-per-task=2", "--output=out.txt", *options.split()]
    return cluster.submit(folder, *few, folder / "jobs" / script, *words)


def fake(folder: Path, program: str) -> str:
    """The option of sbatch that puts a program in the place of pfdist."""
    (folder / "bin").mkdir()
    (folder / "bin" / "pfdist").write_text(program)
    (folder / "bin" / "pfdist").chmod(0o755)
    # The value is a link, because a comma or a quote would end it.
    link = folder.parent / "fake"
    link.symlink_to(folder)
    return f"--export=ALL,PFDIST_VENV={link}"


def commits(run: Path) -> int:
    return len([part for part in run.glob("parts/*/[!.]*.parquet") if "timings" not in part.parts])


def test_a_job_whose_time_is_up_and_that_is_preempted_ends_with_the_same_bytes(
    cluster: Slurm, folder: Path, small_job: Job, tmp_path: Path
) -> None:
    run = folder / "results" / "a b"
    words = ["run", "small.toml", "--results", "results/a b", "--set", *LONG]
    job = submit(cluster, folder, "one-node.sbatch", *words)
    until(lambda: commits(run))
    cluster.said("scancel", "--batch", "--signal=USR1", job)  # as `#SBATCH --signal` does
    cluster.requeued(job, 1)
    before = commits(run)
    until(lambda: commits(run) > before)
    whole = ["--partition=urgent", f"--nodes={NODES}", "--exclusive", "--output=/dev/null"]
    urgent = cluster.submit(folder, *whole, "--wrap", "true")
    assert cluster.ended(urgent).startswith("JobState=COMPLETED")
    assert cluster.ended(job) == "JobState=COMPLETED ExitCode=0:0"
    assert cluster.started(job) == 2
    said = (folder / "out.txt").read_text()
    assert said.count("pfdist: Stopped. Finished work is saved") == 2
    assert "DUE TO PREEMPTION" in said
    alone = pfdist.run(small_job, tmp_path / "alone", changes=LONG, figures=False)
    assert tables(run) == tables(alone.path)
    assert not list(folder.rglob("gone"))
    assert not list(folder.glob(".pfdist-*"))


def tables(run: Path) -> dict[str, str]:
    return {name: digest for name, digest in hashes(run).items() if "figures" not in name}


@pytest.mark.plugins("runs", "sweep")
def test_parts_of_a_sweep_in_an_array_have_the_same_bytes(
    cluster: Slurm, folder: Path, tmp_path: Path
) -> None:
    (folder / "study.toml").write_text(
        'job = "small.toml"\n[over]\nseed = [1, 2]\ncomparison.draws = [60, 80]\n'
    )
    array = submit(cluster, folder, "array.sbatch", "sweep", "study.toml", options="--array=1-3")
    cluster.ended(array)
    assert cluster.state(array).splitlines() == ["COMPLETED None"] * 3
    sweep = folder / "results" / "study"
    assert not (sweep / "points.csv").exists()
    alone = pfdist.sweep(folder / "study.toml", results=tmp_path / "alone", figures=False)
    for name, run in alone.runs.items():
        assert tables(sweep / name) == tables(run.path)
    assert len(pfdist.table(sweep)) == len(alone.table())


def test_a_plan_on_several_nodes_has_the_same_bytes(
    cluster: Slurm, folder: Path, tmp_path: Path
) -> None:
    words = ["plan", "small.toml", "--verbose", "--results", "results/x", "--set", FEW]
    job = submit(cluster, folder, "nodes.sbatch", *words, options=f"--nodes={NODES}")
    ended, said = cluster.ended(job), (folder / "out.txt").read_text()
    assert ended == "JobState=COMPLETED ExitCode=0:0", said[-3000:]
    assert "Ray is ready" in said
    alone = pfdist.plan(
        folder / "small.toml", results=tmp_path / "alone", changes=[FEW], pool="serial"
    )
    assert tables(folder / "results" / "x") == tables(alone.path)
    until(lambda: not cluster_of(job))


def test_a_job_on_several_nodes_uses_all_and_goes_on_and_leaves_nothing(
    cluster: Slurm, folder: Path
) -> None:
    run, before = folder / "results" / "x", set(Path("/tmp").glob("ray-*"))
    words = ["run", "small.toml", "--results", "results/x", "--set", LONG[0]]
    words.append("comparison.draws=1000000")
    job = submit(cluster, folder, "nodes.sbatch", *words, options=f"--nodes={NODES}")
    until(lambda: workers(run) == NODES * CORES)  # the second node joins late
    cluster.said("scancel", "--batch", "--signal=USR1", job)
    cluster.requeued(job, 1)
    before_the_second_start = commits(run)
    until(lambda: commits(run) > before_the_second_start)
    assert cluster_of(job)
    cluster.said("scancel", job)
    assert cluster.ended(job).startswith("JobState=CANCELLED")
    until(lambda: not cluster_of(job))
    assert set(Path("/tmp").glob("ray-*")) <= before


def workers(run: Path) -> int:
    """How many workers have committed timings."""
    timings = [pd.read_parquet(part) for part in run.glob("parts/timings/[!.]*.parquet")]
    return pd.concat(timings)["worker"].nunique() if timings else 0


def cluster_of(job: str) -> list[str]:
    """Commands of the processes of a job's Ray cluster."""
    address = f":{20_000 + int(job) % 10_000}"
    commands = [command_of(process) for process in psutil.process_iter()]
    return [command for command in commands if f"{address}\0" in command]


@pytest.mark.parametrize(("program", "restarts"), [(AGAIN, 4), (STARTS_THAT_COMMIT, 5)])
def test_a_job_stops_after_three_requeues_in_a_row_that_commit_nothing(
    program: str, restarts: int, cluster: Slurm, folder: Path
) -> None:
    job = submit(
        cluster, folder, "one-node.sbatch", "plan", "small.toml", options=fake(folder, program)
    )
    assert cluster.ended(job) == "JobState=FAILED ExitCode=1:0"
    assert cluster.started(job) == restarts
    said = (folder / "out.txt").read_text()
    assert "stopped: 3 requeues in a row have committed nothing to results/small." in said
    assert not list(folder.glob(".pfdist-*"))


def test_a_cancelled_job_does_not_come_back(cluster: Slurm, folder: Path) -> None:
    job = submit(
        cluster, folder, "one-node.sbatch", "run", "small.toml", options=fake(folder, ENDLESS)
    )
    until((folder / "started").exists)
    cluster.said("scancel", job)
    assert cluster.ended(job).startswith("JobState=CANCELLED")
    assert cluster.started(job) == 0
