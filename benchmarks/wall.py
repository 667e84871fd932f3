"""The time of whole commands, beside the same commands of an earlier commit, in turns.

The earlier commit is the one before models were traced. Kernels are on
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown, with_range
from pfdist.kernels.cached import FOLDER_VARIABLE
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREY

TITLE = "Whole commands"
TABLES: tuple[str, ...] = ("wall", "seconds_of_plan")

BEFORE = "e7a706d9fb1d91a651f220f0c96fd54da3635a5b"
REPEATS = 3
COMMANDS = {
    "--help": ("--help",),
    "quick": ("run", "jobs/quick.toml"),
    "plan": ("plan", "jobs/plan.toml"),
    "plan on Ray": ("plan", "jobs/plan.toml", "--pool", "ray"),
}
PLAN = ("plan", "jobs/plan.toml", "--pool", "serial")
REST = "choice of the filter, evenly spaced numbers, compiling, driver, tables"
_RUN = Path("results", "plan")
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
        seconds, and processor_seconds; seconds_of_plan: for each part of a plan in one process its
        part and seconds.
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
        parts = seconds_of_plan(Path(folder, "now"), 1 if quick else REPEATS)
    return {"wall": pd.DataFrame(rows), "seconds_of_plan": parts}


def seconds_of_plan(cache: Path, repeats: int) -> pd.DataFrame:
    """Where the seconds of a plan in one process go: the median of each part.

    Parameters
    ----------
    cache : Path
        Folder of the compiled kernels.
    repeats : int
        After one that compiles the kernels.

    Returns
    -------
    DataFrame
        part and seconds.
    """
    rows = []
    for _ in range(1 + repeats):
        start, _ = _timed(
            (), _ROOT, cache, program=(sys.executable, "-c", "import pfdist.questions.plan")
        )
        bare, _ = _timed((*PLAN, "--no-report"), _ROOT, cache)
        tasks: dict[str, float] = {}

        def read(run: Path, tasks: dict[str, float] = tasks) -> None:
            tasks.update(_tasks(run))

        whole, _ = _timed(PLAN, _ROOT, cache, look=read)
        shown = whole - bare
        rest = bare - start - sum(tasks.values())
        rows.append({"imports": start} | tasks | {REST: rest, "figures and report": shown})
    median = pd.DataFrame(rows[1:]).median()
    return median.rename_axis("part").reset_index(name="seconds")


def _tasks(run: Path) -> dict[str, float]:
    """Seconds of the tasks of a run, by what they computed."""
    timings = pd.read_parquet(run / "tables" / "timings")
    is_bound = timings["phase"].str.startswith("bound")
    windows = is_bound & timings["task"].str.startswith("error_sums")
    masks = {
        "search": ~is_bound & (timings["phase"] != "comparison"),
        "comparison": timings["phase"] == "comparison",
        "bound, windows": windows,
        "bound, sets alone": is_bound & ~windows,
    }
    return {part: float(timings.loc[mask, "seconds"].sum()) for part, mask in masks.items()}


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


def _timed(
    words: tuple[str, ...],
    tree: Path,
    cache: Path,
    program: tuple[str, ...] = _PROGRAM,
    look: Callable[[Path], None] | None = None,
) -> tuple[float, float]:
    """Wall time and processor time of a command of a version, in an empty folder.

    `look` gets the folder of its run at the end.
    """
    environment = {**os.environ, "PYTHONPATH": str(tree), FOLDER_VARIABLE: str(cache)}
    with _folder_with_jobs(tree) as folder:
        before, start = _processor_seconds(), perf_counter()
        subprocess.run(  # noqa: S603  our own text
            [*program, *words], cwd=folder, env=environment, check=True, capture_output=True
        )
        seconds = perf_counter() - start, _processor_seconds() - before
        if look is not None:
            look(folder / _RUN)
        return seconds


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
    parts = tables["seconds_of_plan"]
    of_plan = markdown(
        ("plan in one process", "s"),
        [
            [str(part), f"{seconds:.1f}"]
            for part, seconds in parts.set_index("part")["seconds"].items()
        ],
    )
    return f"Median, least and largest.\n\n{markdown(header, rows)}\n\n{of_plan}"


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
