"""The time of whole commands, beside the same commands of an earlier commit, in turns.

The earlier commit is the one before the bound held for every number of particles. Kernels are on
disk: each command runs once before the clock does. The processor time is that of the command and
of all processes that it has waited for.
"""

import io
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown, with_range
from pfdist.kernels.disk_cache import FOLDER_VARIABLE
from pfdist.plots.style import BLUE, COLUMN_INCHES, GREY

TITLE = "Whole commands"
TABLES: tuple[str, ...] = ("wall",)

BEFORE = "c4ffa8fc65644ca72868eb05b09a241cf0046010"
REPEATS = 5
COMMANDS = {
    "--help": ("--help",),
    "quick": ("run", "jobs/quick.toml"),
    "plan": ("plan", "jobs/plan.toml"),
    "plan on Ray": ("plan", "jobs/plan.toml", "--pool", "ray"),
    "budget 5:41": ("budget", "jobs/plan.toml", "--measurements", "5:41"),
    "paper on Ray": ("run", "jobs/paper.toml", "--pool", "ray"),
}
_ROOT = Path(__file__).parents[1]
_PROGRAM = (sys.executable, "-m", "pfdist")


def measure(quick: bool, say: Say) -> Tables:
    """Time commands of this version and of the earlier commit, in turns.

    Parameters
    ----------
    quick : bool
        Only the help of this version, once.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        wall: a row for each run of a command, with command, version (before or now), repeat,
        seconds, and processor_seconds.
    """
    commands = dict(list(COMMANDS.items())[: 1 if quick else None])
    rows = []
    with tempfile.TemporaryDirectory(prefix="wall-") as folder:
        trees = {"now": _ROOT} if quick else {"before": _earlier(Path(folder)), "now": _ROOT}
        for name, words in commands.items():
            for repeat in range(-1, 1 if quick else REPEATS):
                for version, tree in trees.items():
                    seconds, processor = _timed(words, tree, Path(folder, version))
                    if repeat >= 0:  # the first compiles the kernels
                        row = {"command": name, "version": version, "repeat": repeat}
                        rows.append(row | {"seconds": seconds, "processor_seconds": processor})
                        say(f"{name}, {version}: {seconds:.1f} s")
    return {"wall": pd.DataFrame(rows)}


def _earlier(folder: Path) -> Path:
    """The files of the earlier commit, in a folder."""
    archive = subprocess.run(  # noqa: S603  our own text
        ["git", "-C", str(_ROOT), "archive", BEFORE],  # noqa: S607
        check=True, capture_output=True,
    )  # fmt: skip
    tree = folder / "tree"
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(tree, filter="data")
    return tree


def _timed(words: tuple[str, ...], tree: Path, cache: Path) -> tuple[float, float]:
    """Wall time and processor time of a command of a version, in an empty folder."""
    environment = {**os.environ, "PYTHONPATH": str(tree), FOLDER_VARIABLE: str(cache)}
    with _folder_with_jobs(tree) as folder:
        before, start = _processor_seconds(), perf_counter()
        subprocess.run(  # noqa: S603  our own text
            [*_PROGRAM, *words], cwd=folder, env=environment, check=True, capture_output=True
        )
        return perf_counter() - start, _processor_seconds() - before


@contextmanager
def _folder_with_jobs(tree: Path) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="wall-run-") as folder:
        Path(folder, "jobs").symlink_to(tree / "jobs")
        yield Path(folder)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def summary(tables: Tables) -> str:
    """Give the table in Markdown, with the ratio of the medians."""
    rows = []
    for command, runs in tables["wall"].groupby("command", sort=False):
        texts, medians = [str(command)], []
        for version in ("before", "now"):
            of_version = runs[runs["version"] == version]
            if len(of_version):
                medians.append(of_version["seconds"].median())
                texts.append(with_range(of_version["seconds"], ".1f"))
            else:
                texts.append("")
        now = runs[runs["version"] == "now"]["processor_seconds"].median()
        ratio = f"{medians[1] / medians[0]:.2f}" if len(medians) == 2 else ""
        rows.append([*texts, ratio, f"{now:.1f}"])
    header = ("command", "before, s", "now, s", "ratio", "processor time now, s")
    return f"Median, least and largest.\n\n{markdown(header, rows)}"


def plot(tables: Tables) -> Figure:
    """Give the figure: the median time of each command, before and now."""
    canvas = Figure(figsize=(COLUMN_INCHES, 2.4), layout="constrained")
    ax = canvas.subplots()
    times = tables["wall"].pivot_table("seconds", "command", "version", "median", sort=False)
    for shift, (version, colour) in enumerate((("before", GREY), ("now", BLUE))):
        if version in times:
            places = [place + 0.4 * (shift - 0.5) for place in range(len(times))]
            ax.barh(places, times[version], height=0.38, color=colour, label=version)
    ax.set_yticks(range(len(times)), list(times.index))
    ax.invert_yaxis()
    ax.set_xlabel("seconds")
    ax.legend()
    return canvas
