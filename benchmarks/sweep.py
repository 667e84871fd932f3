"""A sweep of many short runs against its runs one by one: time, and how busy the workers are."""

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest import mock

import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED
from pfdist.pools.base import Outcome, Task
from pfdist.pools.threads import ThreadPool

TITLE = "Sweeps"
TABLES: tuple[str, ...] = ("sweep", "sweep_tasks")

WORKERS = 2
SWEEP = Path(__file__).parents[1] / "jobs" / "budgets.toml"
OVER = {"problem.measurement_budget": [10, 15, 21, 30], "seed": [1, 2, 3]}  # as in the file
SMALL = ["comparison.draws=200", "filter.particles=50", "problem.horizon=32"]

_outcomes: list[tuple[float, float]] = []  # when each came, and the seconds of its task


_run = ThreadPool.run


def _recorded(pool: ThreadPool, tasks: Iterable[Task]) -> Iterator[Outcome]:
    """Record the outcomes of `ThreadPool.run` with the time at which they come."""
    for outcome in _run(pool, tasks):
        _outcomes.append((perf_counter(), outcome.seconds))
        yield outcome


def measure(quick: bool, say: Say) -> Tables:
    """Time a sweep, and its runs one by one.

    Parameters
    ----------
    quick : bool
        Two small points.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        sweep: a row for the sweep and a row for the runs one by one, with points, seconds (of all
        but reports), worker_seconds (of all tasks), begun (seconds until the first task began) and
        first (seconds until the first point was finished); sweep_tasks: a row for each task of the
        sweep, with the seconds at which it ended since the start, and the seconds that it took.
    """
    over = {key: values[: 2 if quick else None] for key, values in OVER.items()}
    rows = []
    for kind, compute in (("sweep", _sweep), ("one by one", _one_by_one)):
        _outcomes.clear()
        start = perf_counter()
        with (
            tempfile.TemporaryDirectory(prefix="sweep-") as folder,
            mock.patch.object(ThreadPool, "run", _recorded),
        ):
            first, points = compute(Path(folder), over, SMALL if quick else [])
        seconds = perf_counter() - start
        rows.append(
            {
                "kind": kind,
                "points": points,
                "seconds": seconds,
                "worker_seconds": sum(took for _, took in _outcomes),
                "begun": min(end - took for end, took in _outcomes) - start,
                "first": first - start,
            }
        )
        say(f"{kind}: {seconds:.1f} s")
        if kind == "sweep":
            tasks = [{"end": end - start, "seconds": took} for end, took in _outcomes]
    return {"sweep": pd.DataFrame(rows), "sweep_tasks": pd.DataFrame(tasks)}


def _sweep(folder: Path, over: dict[str, Any], changes: list[str]) -> tuple[float, int]:
    """Run all points as a sweep; give when the first was finished, and how many there are."""
    finished: list[float] = []

    def say(line: str) -> None:
        if ": finished (" in line:
            finished.append(perf_counter())

    done = pfdist.sweep(
        SWEEP.with_name("plan.toml"), over, results=folder, pool="threads", workers=WORKERS,
        changes=changes, report=False, say=say,
    )  # fmt: skip
    return finished[0], len(done.runs)


def _one_by_one(folder: Path, over: dict[str, Any], changes: list[str]) -> tuple[float, int]:
    """Run all points one after another, each with workers of its own."""
    finished: list[float] = []
    for budget in over["problem.measurement_budget"]:
        for seed in over["seed"]:
            own = [*changes, f"problem.measurement_budget={budget}", f"seed={seed}"]
            pfdist.run(
                SWEEP.with_name("plan.toml"), folder / f"{budget}-{seed}", pool="threads",
                workers=WORKERS, changes=own, figures=False,
            )  # fmt: skip
            finished.append(perf_counter())
    return finished[0], len(finished)


def busy(tables: Tables) -> float:
    """Give the share of the time, from the end of the first point on, that workers had tasks."""
    sweep, tasks = tables["sweep"].iloc[0], tables["sweep_tasks"]
    last = tasks["end"].max()
    begins = (tasks["end"] - tasks["seconds"]).clip(lower=sweep["first"])
    within = (tasks["end"] - begins).clip(lower=0.0).sum()
    return float(within / (WORKERS * (last - sweep["first"])))


def summary(tables: Tables) -> str:
    """Give the table in Markdown, and how busy the workers were."""
    rows = [
        [
            row["kind"],
            f"{row['points']}",
            f"{row['seconds']:.1f}",
            f"{row['worker_seconds'] / WORKERS:.1f}",
            f"{row['begun']:.1f}",
            f"{row['first']:.1f}",
        ]
        for _, row in tables["sweep"].iterrows()
    ]
    header = [
        *("way", "points", "seconds", "seconds of tasks a worker"),
        *("first task after, s", "first point after, s"),
    ]
    sweep, alone = tables["sweep"].iloc[0], tables["sweep"].iloc[1]["worker_seconds"] / WORKERS
    ratio = (sweep["seconds"] - sweep["begun"]) / alone
    return "\n\n".join(
        [
            f"`jobs/budgets.toml` without reports, on {WORKERS} workers.",
            markdown(header, rows),
            "From the end of the first point to the last task of the sweep, the workers had tasks "
            f"in {100 * busy(tables):.0f} % of the time. From its first task to its end, the sweep "
            f"took {ratio:.2f} times the task time per worker of the separate runs.",
        ]
    )


def plot(tables: Tables) -> Figure:
    """Draw how many workers had tasks over time, in the sweep."""
    figure = Figure(figsize=(COLUMN_INCHES, 0.5 * COLUMN_INCHES), layout="constrained")
    axes, tasks = figure.add_subplot(), tables["sweep_tasks"]
    width = max(tasks["end"].max() / 60, 1e-3)
    shares = []
    for k in range(60):
        low, high = k * width, (k + 1) * width
        begins = (tasks["end"] - tasks["seconds"]).clip(low, high)
        shares.append((tasks["end"].clip(low, high) - begins).sum() / width)
    axes.stairs(shares, [k * width for k in range(61)], fill=True, color=BLUE)
    axes.axvline(tables["sweep"].iloc[0]["first"], color=RED, lw=0.8, label="first point finished")
    axes.set_xlabel("seconds")
    axes.set_ylabel("workers with a task")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return figure
