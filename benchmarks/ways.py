"""One job computed in each way: whether its bytes are the same, and when the workers are ready.

The clusters are those of the tests: Ray nodes on loopback, and Debian's Slurm with two nodes on
this machine. A way whose software is missing is left out.
"""

import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, sleep

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.pages.style import BLUE, COLUMN_INCHES

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from crash.nodes import kill, nodes
from crash.slurm import SCRIPTS, Slurm, slurm
from oracles.bytes_of import hashes

TITLE = "Ways to compute a job"
TABLES: tuple[str, ...] = ("ways",)

JOB = Path(__file__).parents[1] / "jobs" / "quick.toml"
LONG = "comparison.draws=400000"  # so that a node can leave
_PFDIST = (sys.executable, "-m", "pfdist")
_READY = " is ready"
_PATIENCE = 300.0  # seconds for a batch job to start


def measure(quick: bool, say: Say) -> Tables:
    """Run a job in each way.

    Parameters
    ----------
    quick : bool
        Only on threads.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        ways: a row for each way, with way, seconds from the command until the workers are ready,
        same_bytes, and whether they are the same after a node was killed, where one was.
    """
    rows, ways = [], {"threads": _threads} | ({} if quick else _WAYS)
    with tempfile.TemporaryDirectory(prefix="ways-") as name:
        folder = Path(name)
        _until_ready("run", JOB, folder / "alone", "--pool", "serial")
        expected = _tables(folder / "alone")
        for way, run_in in ways.items():
            own = folder / way.replace(" ", "-")
            own.mkdir()
            seconds, run, killed = run_in(own)
            rows.append(
                {
                    "way": way,
                    "seconds": seconds,
                    "same_bytes": _tables(run) == expected,
                    "same_bytes_after_a_kill": killed,
                }
            )
            say(f"{way}: {rows[-1]}")
    return {"ways": pd.DataFrame(rows)}


def _threads(folder: Path) -> tuple[float, Path, bool | None]:
    run = folder / "run"
    return _until_ready("run", JOB, run, "--pool", "threads"), run, None


def _ray(folder: Path) -> tuple[float, Path, bool | None]:
    run = folder / "run"
    return _until_ready("run", JOB, run, "--pool", "ray"), run, None


def _loopback(folder: Path) -> tuple[float, Path, bool | None]:
    """Three nodes, one of which is killed during a longer run."""
    run, long = folder / "run", folder / "long"
    with nodes(folder, 3) as cluster:
        here = ("--pool", "ray", "--address", cluster.address)
        seconds = _until_ready("run", JOB, run, *here, environment=cluster.environment)

        def kill_a_node() -> None:
            kill(cluster.all[1])

        _until_ready(
            "run",
            JOB,
            long,
            "--set",
            LONG,
            *here,
            environment=cluster.environment,
            then=kill_a_node,
        )
    _until_ready("run", JOB, folder / "whole", "--set", LONG, "--pool", "threads")
    return seconds, run, _tables(long) == _tables(folder / "whole")


def _submitted(folder: Path) -> tuple[float, Path, bool | None]:
    """A driver that ``ray job submit`` starts on a cluster of three nodes."""
    run = folder / "run"
    with nodes(folder, 3, takes_jobs=True) as cluster:
        words = [*_PFDIST, "run", str(JOB), "--verbose", "--results", str(run), "--pool", "ray"]
        submit = [sys.executable, "-m", "ray.scripts.scripts", "job", "submit", "--", *words]
        environment = {**cluster.environment, "RAY_ADDRESS": cluster.jobs}
        seconds = _until_said([*submit, "--address", "auto"], environment)
    return seconds, run, None


def _slurm_nodes(folder: Path) -> tuple[float, Path, bool | None]:
    words = ("run", "quick.toml", "--verbose", "--results", "results/quick")
    with _slurm(folder) as cluster:
        seconds = _until_done(cluster, folder, "nodes.sbatch", *words, options=("--nodes=2",))
    return seconds, folder / "results" / "quick", None


def _slurm_array(folder: Path) -> tuple[float, Path, bool | None]:
    """A sweep over two seeds in two tasks; the bytes are those of the job's own seed."""
    (folder / "seeds.toml").write_text('job = "quick.toml"\n[over]\nseed = [2020, 1]\n')
    words = ("sweep", "seeds.toml", "--verbose", "--results", "results/seeds")
    with _slurm(folder) as cluster:
        seconds = _until_done(cluster, folder, "array.sbatch", *words, options=("--array=1-2",))
    jobs = (folder / "results" / "seeds").glob("*/job.toml")
    own = next(job for job in jobs if "seed = 2020\n" in job.read_text())
    return seconds, own.parent, None


@contextmanager
def _slurm(folder: Path) -> Iterator[Slurm]:
    shutil.copytree(SCRIPTS, folder / "jobs")
    shutil.copy(JOB, folder)
    with slurm(2) as cluster:
        yield cluster


def _until_done(
    cluster: Slurm, folder: Path, script: str, *words: str, options: tuple[str, ...]
) -> float:
    """Seconds from submission until the workers of a batch job are ready; it has ended then."""
    start, out = perf_counter(), folder / "out.txt"
    job = cluster.submit(
        folder,
        "--cpus-per-task=2",
        "--output=out.txt",
        *options,
        folder / "jobs" / script,
        *words,
    )
    while not (out.exists() and _READY in out.read_text()):
        _check(perf_counter() - start < _PATIENCE, f"{script} has not started")
        sleep(0.02)
    seconds = perf_counter() - start
    cluster.ended(job)
    return seconds


def _until_ready(
    command: str,
    job: Path,
    run: Path,
    *options: str,
    environment: Mapping[str, str] | None = None,
    then: Callable[[], None] | None = None,
) -> float:
    words = [
        *_PFDIST,
        command,
        str(job),
        "--results",
        str(run),
        "--verbose",
        "--no-report",
        *options,
    ]
    return _until_said(words, environment or {}, then)


def _until_said(
    words: list[str], environment: Mapping[str, str], then: Callable[[], None] | None = None
) -> float:
    """Seconds until a command says that its workers are ready; it has ended then.

    `then` is called five seconds later, while the command runs.
    """
    start, seconds, said = perf_counter(), math.nan, list[str]()
    with subprocess.Popen(  # noqa: S603  our own text
        words,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        for line in process.stdout or ():
            said.append(line)
            if _READY in line and math.isnan(seconds):
                seconds = perf_counter() - start
                if then is not None:
                    sleep(5)
                    then()
    _check(process.returncode == 0, "".join(said[-20:]))
    return seconds


def _check(is_true: bool, otherwise: str) -> None:
    if not is_true:
        raise RuntimeError(otherwise)


def _tables(run: Path) -> dict[str, str]:
    return {name: digest for name, digest in hashes(run).items() if name.startswith("tables")}


_WAYS: dict[str, Callable[[Path], tuple[float, Path, bool | None]]] = {
    "Ray on this machine": _ray,
    "three nodes on loopback": _loopback,
    **({"ray job submit, three nodes": _submitted} if find_spec("aiohttp_cors") else {}),
    **(
        {"Slurm, two nodes": _slurm_nodes, "Slurm, an array of two tasks": _slurm_array}
        if shutil.which("slurmctld")
        else {}
    ),
}


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    rows = []
    words = {True: "the same", False: "other"}
    for way, seconds, same, killed in tables["ways"].itertuples(index=False):
        rows.append([str(way), words[same], words.get(killed, ""), f"{seconds:.1f}"])
    header = ("way", "bytes", "bytes after a node was killed", "s until workers are ready")
    return f"The same job in several ways: are its tables the same?\n\n{markdown(header, rows)}"


def plot(tables: Tables) -> Figure:
    """Give the figure: the seconds until the workers are ready."""
    canvas = Figure(figsize=(COLUMN_INCHES, 2.2), layout="constrained")
    ax, ways = canvas.subplots(), tables["ways"]
    ax.barh(ways["way"], ways["seconds"], color=BLUE)
    ax.invert_yaxis()
    ax.set_xlabel("seconds until the workers are ready")
    return canvas
