"""A sweep that is ended by a signal and started again: every point has the bytes of its own run."""

import random
import shutil
import signal
import time
from pathlib import Path

import pytest

import pfdist
from crash.runs import running
from oracles.bytes_of import hashes
from pfdist import Job

pytestmark = pytest.mark.plugins("sweep")

OVER = {"seed": [1, 2, 3], "comparison.draws": [250, 400]}  # six points; two share their searches
OPTIONS = ["--over", "seed=1:3", "--over", "comparison.draws=250,400", "--no-report"]


@pytest.fixture
def whole(small_job: Job, tmp_path: Path) -> dict[str, dict[str, str]]:
    """Hashes of each point's run, started alone."""
    found = {}
    for seed in OVER["seed"]:
        for draws in OVER["comparison.draws"]:
            run = tmp_path / "alone" / f"{seed}-{draws}"
            changes = [f"seed={seed}", f"comparison.draws={draws}"]
            pfdist.run(small_job.path, run, changes=changes, figures=False)
            found[f"seed={seed}_comparison.draws={draws}"] = hashes(run)
    return found


def begun(sweep: Path) -> bool:
    return any(sweep.glob("*/parts/timings/*.parquet"))


def finished(job: Job, sweep: Path) -> dict[str, dict[str, str]]:
    runs = pfdist.sweep(job.path, OVER, pool="serial", results=sweep, figures=False).runs
    return {name: hashes(run.path) for name, run in runs.items()}


@pytest.mark.parametrize(
    ("pool", "kills"),
    [
        ("serial", 1),
        pytest.param("serial", 20, marks=pytest.mark.crash),
        pytest.param("threads", 10, marks=pytest.mark.crash),
        pytest.param("ray", 4, marks=pytest.mark.crash),
    ],
)
def test_a_sweep_killed_at_any_instant_ends_with_the_same_bytes(
    pool: str, kills: int, small_job: Job, tmp_path: Path, whole: dict[str, dict[str, str]]
) -> None:
    options = [*OPTIONS, "--pool", pool]
    with running(small_job.path, tmp_path / "whole", *options, word="sweep") as driver:
        driver.wait_for(lambda: begun(driver.run))
        start = time.monotonic()
        assert driver.wait() == 0, driver.said[-3:]
        lasts = time.monotonic() - start
    assert {name: hashes(tmp_path / "whole" / name) for name in whole} == whole
    rng, killed = random.Random(kills), 0
    while killed < kills:
        sweep = tmp_path / f"{killed}"
        with running(small_job.path, sweep, *options, word="sweep") as driver:
            driver.wait_for(lambda: begun(driver.run))
            time.sleep(rng.uniform(0, lasts))
            in_time = driver.kill()
        if in_time:
            assert finished(small_job, sweep) == whole
            assert not list(sweep.rglob(".*.tmp"))
            killed += 1
        shutil.rmtree(sweep)


@pytest.mark.crash
def test_a_sweep_asked_to_end_keeps_what_is_done_and_goes_on(
    small_job: Job, tmp_path: Path, whole: dict[str, dict[str, str]]
) -> None:
    sweep, options = tmp_path / "sweep", [*OPTIONS, "--pool", "serial"]
    with running(small_job.path, sweep, *options, word="sweep") as driver:
        driver.wait_for(lambda: begun(driver.run))
        driver.process.send_signal(signal.SIGINT)
        code = driver.wait()
    assert code in (0, 130)  # it may have been faster
    if code:
        assert driver.said[-1].startswith("pfdist: Stopped.")
    assert finished(small_job, sweep) == whole


def test_processes_that_start_one_sweep_together_share_its_points(
    small_job: Job, tmp_path: Path, whole: dict[str, dict[str, str]]
) -> None:
    sweep, options = tmp_path / "sweep", [*OPTIONS, "--pool", "serial"]
    with (
        running(small_job.path, sweep, *options, word="sweep") as first,
        running(small_job.path, sweep, *options, word="sweep") as second,
    ):
        assert [first.wait(), second.wait()] == [0, 0], (first.said[-3:], second.said[-3:])
    assert not [line for line in first.said + second.said if "without a message" in line]
    # The last to end has left out nothing.
    assert {name: hashes(sweep / name) for name in whole} == whole
