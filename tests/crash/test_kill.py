"""Ended by a signal in either phase and run again: the same bytes."""

import contextlib
import itertools
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from crash.runs import end, finish, running
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import BLOCK, FilterWork
from pfdist.pools.kinds import POOLS

JOB = """
seed = 5
[problem]
horizon = 30
measurement_budget = 8
[filter]
particles = 100
[evaluation]
draws = 4000
[[search]]
method = "genetic"
population = 10
generations = 6
[[search]]
method = "random"
evaluations = 20
[comparison]
draws = 60_000
"""
ONLINE = """
[online]
draws = {draws}
judging_draws = 20
search.method = "corridor"
search.rounds = 1
search.evaluation.draws = 20
search.evaluation.particles = 20
"""
MOST_LOST_SECONDS = 5.0


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("job") / "kill.toml"
    path.write_text(JOB)
    return path


@pytest.fixture(scope="module")
def never_killed(job: Path) -> dict[str, str]:
    whole = finish(job, job.with_name("never killed"), "--pool", "serial")
    assert any(file.startswith("tables/comparison/comparison-00001-") for file in whole)
    return whole


SEARCHING, COMPARING = ("draws", "compared"), ("comparison", "comparison")


@pytest.mark.parametrize(
    ("pool", "phases"),
    [("serial", [SEARCHING, COMPARING]), ("threads", [SEARCHING, COMPARING]), ("ray", [COMPARING])],
)
def test_a_run_killed_in_a_phase_ends_with_the_same_bytes(
    pool: str,
    phases: list[tuple[str, str]],
    job: Path,
    never_killed: dict[str, str],
    tmp_path: Path,
) -> None:
    run = tmp_path / "run"
    for parts, table in phases:
        with running(job, run, "--pool", pool) as driver:
            driver.wait_for(lambda: driver.parts(parts))  # noqa: B023
            driver.kill()
        assert not (run / "tables" / table).exists()  # it was in the midst of the phase
    with running(job, run, "--pool", "threads") as driver:
        assert driver.wait() == 0, driver.said[-3:]
        said = [line for line in driver.said if "ended without a message" in line]
    assert len(said) == (len(phases) if pool != "ray" else 0)
    assert hashes(run) == never_killed
    assert not list(run.rglob(".*.tmp"))
    assert not (run / ".begun").exists()


@pytest.mark.crash
def test_a_run_on_ray_killed_at_any_instant_ends_with_the_same_bytes(
    job: Path, tmp_path: Path, make_forks: Callable[[Path], "Forks"]
) -> None:
    rng, kills, forks = random.Random(1), 0, make_forks(job)
    with running(job, tmp_path / "whole", "--pool", "ray") as driver:
        driver.wait_for(lambda: driver.parts("timings"))
        start = time.monotonic()
        assert driver.wait() == 0
        lasts = time.monotonic() - start
    assert forks.run(tmp_path / "serial", "serial.log") == 0
    needed, whole = _logged(tmp_path / "serial.log")[0], _tables(tmp_path / "serial")
    # The ranking of evenly spaced sets keeps sums of draws, without the number of sets.
    ranked = (needed - _committed(tmp_path / "serial")) / _summed(tmp_path / "serial")
    while kills < 20:
        run = tmp_path / f"{kills}"
        with running(job, run, "--pool", "ray") as driver:
            driver.wait_for(lambda: driver.parts("timings"))
            time.sleep(rng.uniform(0, lasts))
            killed = driver.kill()
        if not killed:
            shutil.rmtree(run)
            continue  # it was faster
        committed = _committed(run) + ranked * _summed(run)
        assert forks.run(run, f"{kills}.log") == 0
        assert _tables(run) == whole
        assert _logged(tmp_path / f"{kills}.log")[0] == needed - committed
        kills += 1


PLAN = """
seed = 5
[problem]
horizon = 8
measurement_budget = 3
estimate = "smoothed"
[model]
name = "random_walk"
[filter]
particles = 200
[evaluation]
draws = 500
[[search]]
method = "genetic"
population = 6
generations = 2
[comparison]
draws = 2000
reference = "evenly spaced"
"""
# The phases of which each command has committed something when it is ended. Before the second the
# evaluation from coarse to fine is at work, before the third the race.
KILLS = {
    "plan": ["evenly_spaced.ranking", "evenly_spaced.coarse", "relaxation", "bound.proof."],
    "rule": ["rule.draws.tuning", "rule.draws.sweep"],
}


@pytest.mark.crash
@pytest.mark.parametrize("pool", POOLS)
def test_an_opponent_a_smoothed_proof_and_a_rule_end_with_the_same_bytes_if_processes_are_killed(
    pool: str, tmp_path: Path
) -> None:
    """In turn the driver with its parent, the driver alone, and workers, where there are any."""
    job, run, whole = (tmp_path / name for name in ("plan.toml", "run", "whole"))
    job.write_text(PLAN)
    rng = random.Random(1)
    for word, reached in KILLS.items():
        options = ["--bound-draws", "480"] * (word == "plan")
        with running(job, whole, "--pool", "serial", *options, word=word) as driver:
            assert driver.wait() == 0, driver.said[-3:]
        for number, phase in enumerate(reached):
            with running(job, run, "--pool", pool, *options, word=word) as driver:
                driver.wait_for(lambda: any(run.glob(f"*/*/{phase}*")))  # noqa: B023
                end([*driver.workers(), *driver.family("spawn_main")])
                time.sleep(rng.uniform(0.0, 0.3))
                if number % 2:
                    end(driver.computing)
                    assert driver.wait() in {0, 75}  # 0: it was faster
                else:
                    driver.kill()
        with running(job, run, "--pool", pool, *options, word=word) as driver:
            assert driver.wait() == 0, driver.said[-3:]
        assert hashes(run) == hashes(whole), word


# --- at any instant of a small serial run ---------------------------------------------------------


class Forks:
    """Runs of one job that start at once; see `forks.py`."""

    def __init__(self, job: Path) -> None:
        script = Path(__file__).with_name("forks.py")
        self._folder = job.parent
        self._server = subprocess.Popen(
            [sys.executable, script, job],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._ask, self._answers = self._server.stdin, self._server.stdout

    def close(self) -> None:
        self._ask.close()
        self._server.wait()
        self._answers.close()

    def run(self, run: Path, log: str, kill_after: float | None = None) -> int:
        """Compute a run, or begin to; give the exit code."""
        print(run, run.with_name(log), file=self._ask, flush=True)
        process = int(self._answers.readline())
        if kill_after is not None:
            time.sleep(kill_after)
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        return int(self._answers.readline())


@pytest.fixture
def make_forks() -> Iterator[Callable[[Path], Forks]]:
    with contextlib.ExitStack() as stack:

        def make(job: Path) -> Forks:
            forks = Forks(job)
            stack.callback(forks.close)
            return forks

        yield make


def _logged(log: Path) -> tuple[int, float]:
    """Draws that were filtered, and in how many seconds."""
    lines = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    return sum(int(draws) for draws, _ in lines), sum(float(seconds) for _, seconds in lines)


def _committed(run: Path) -> int:
    """Draws filtered of which the result is committed."""
    counts = []
    for table, key in (
        ("draws", ["evaluation", "draw"]), ("comparison", ["draw"]), ("trajectories", ["draw"]),
        ("online", ["draw"]), ("filter_distance", ["draw"]),
        ("filter_variance", ["draw"]), ("other_estimate", ["draw"]),
    ):  # fmt: skip
        files = list(run.glob(f"*/{table}/[!.]*.parquet"))
        rows = [pd.read_parquet(file) for file in files]
        starts = ("mse_", "estimate_", "distance_", "variance_", "unmeasured", "smoothed_")
        sets = sum(name.startswith(starts) for name in rows[0]) if rows else 0
        counts.append(len(pd.concat(rows).drop_duplicates(key)) * max(sets, 1) if rows else 0)
    return sum(counts)


def _summed(run: Path) -> int:
    """Draws whose sums the ranking of evenly spaced sets has committed: of blocks, or single."""
    files = list(run.glob("*/error_sums/[!.]*.parquet"))
    numbers = {n for file in files for n in pd.read_parquet(file, columns=["block"])["block"]}
    blocks = (range(n * BLOCK, (n + 1) * BLOCK) if n >= 0 else (-1 - n,) for n in numbers)
    return len({*itertools.chain.from_iterable(blocks)})


def _tables(run: Path) -> dict[str, str]:
    """Hashes of all but the figures, which `forks.py` draws in one format of two."""
    return {name: hash_ for name, hash_ in hashes(run).items() if not name.startswith("figures")}


@pytest.mark.parametrize(
    ("kills", "online"),
    [
        pytest.param(5, "", id="5"),
        pytest.param(200, "", id="200", marks=pytest.mark.crash),
        pytest.param(40, ONLINE.format(draws=40), id="40-online", marks=pytest.mark.crash),
    ],
)
def test_a_run_killed_at_any_instant_ends_with_the_same_bytes_and_computes_nothing_again(
    kills: int, online: str, small_job: Job, tmp_path: Path, make_forks: Callable[[Path], Forks]
) -> None:
    job = small_job.path
    one_search, _, rest = job.read_text().partition('[[search]]\nmethod = "random"')
    job.write_text(one_search + rest[rest.index("[comparison]") :] + online)
    rng, forks, killed = random.Random(0), make_forks(job), 0
    assert forks.run(tmp_path / "first", "first.log") == 0
    start = time.monotonic()
    assert forks.run(tmp_path / "whole", "whole.log") == 0
    lasts, whole = time.monotonic() - start, hashes(tmp_path / "whole")
    needed, _ = _logged(tmp_path / "whole.log")
    assert needed == _committed(tmp_path / "whole")
    while killed < kills:
        run, instant = tmp_path / f"{killed}", rng.uniform(0, lasts)
        if forks.run(run, "killed.log", kill_after=instant) == 0:
            shutil.rmtree(run)
            continue  # it was faster
        committed = _committed(run)
        assert forks.run(run, f"{killed}.log") == 0
        assert hashes(run) == whole, f"killed after {instant:.3f} s"
        assert not list(run.rglob(".*.tmp"))
        assert _logged(tmp_path / f"{killed}.log")[0] == needed - committed
        shutil.rmtree(run)
        killed += 1


@pytest.mark.crash
def test_a_kill_loses_at_most_five_seconds_of_work(
    tmp_path: Path, make_forks: Callable[[Path], Forks]
) -> None:
    job = tmp_path / "long.toml"
    job.write_text(JOB.replace("60_000", "1_000_000"))
    forks, rng, losses = make_forks(job), random.Random(2), []
    for kill in range(10):
        run, log = tmp_path / f"{kill}", f"{kill}.log"
        after = MOST_LOST_SECONDS + rng.uniform(3, 8)
        assert forks.run(run, log, kill_after=after) == -signal.SIGKILL
        draws, seconds = _logged(tmp_path / log)
        assert seconds > MOST_LOST_SECONDS  # so much could be lost
        losses.append(seconds * (1 - _committed(run) / draws))
    assert max(losses) < MOST_LOST_SECONDS, losses


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(
    ("number", "code", "state", "sets", "task"),
    [
        (signal.SIGINT, 130, "searching", 1, 7),
        (signal.SIGTERM, 75, "comparing", 3, 2),
        pytest.param(signal.SIGUSR1, 75, "comparing", 3, 2, marks=pytest.mark.crash),
    ],
)
def test_a_run_asked_to_end_keeps_what_is_done_and_goes_on(
    number: signal.Signals,
    code: int,
    state: str,
    sets: int,
    task: int,
    small_job: Job,
    tmp_path: Path,
    stop: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    command = ["run", str(small_job.path), "--results"]
    assert main([*command, str(whole)]) == 0
    calls, do = itertools.count(1), Evaluator.filtered

    def signalled(self: Evaluator, work: FilterWork) -> Any:
        if len(work.measurement_times) == sets and next(calls) == task:
            stop(number)
        return do(self, work)

    with monkeypatch.context() as patch:
        patch.setattr(Evaluator, "filtered", signalled)
        assert main([*command, str(run)]) == code
    stop()
    assert "run the same command to resume" in capsys.readouterr().err
    kept = pfdist.open_run(run)
    assert kept.state == state
    assert len(kept.table("draws")) > 0
    assert main([*command, str(run)]) == 0
    assert hashes(run) == hashes(whole)
