"""The processor time and the memory of large problems: whole commands, on one core.

The memory is the largest of the process. Kernels are on disk: a small problem runs first.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.pages.style import COLUMN_INCHES

TITLE = "Large problems"
TABLES: tuple[str, ...] = ("size",)

JOBS = Path(__file__).parents[1] / "jobs"
_MIB = 1024  # the kernel counts in KiB
# A process keeps the largest memory of the one that it was forked from, so a small one starts it.
_LARGEST = """
import json, resource, subprocess, sys
quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
subprocess.run(sys.argv[1:], check=True, **quiet)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""
_MODEL = """
import numpy as np
from pfdist import Sensor, StateSpaceModel

COMPONENTS, SENSORS = {components}, {sensors}


def sensor_of(number):
    i, sd = number % COMPONENTS, 0.5 + 0.1 * number
    return Sensor(
        lambda x, t, v, p: (x[i] + sd * v[0],),
        lambda y, x, t, p: -0.5 * ((y[0] - x[i]) / sd) ** 2,
        ("normal",),
    )


model = StateSpaceModel(
    name="ring",
    initial=lambda w, p: tuple(w),
    transition=lambda x, t, w, p: tuple(
        0.9 * x[i] + 0.3 * np.sin(x[i - 1]) + 0.5 * w[i] for i in range(COMPONENTS)
    ),
    quantity_of_interest=lambda x, t, p: tuple(x),
    initial_noise=("normal",) * COMPONENTS,
    process_noise=("normal",) * COMPONENTS,
    sensors={{f"s{{number}}": sensor_of(number) for number in range(SENSORS)}},
)
"""
"""Components in a ring, each of which is driven by the one before."""
_RING = """
seed = 1
model.name = "ring.py:model"
problem = {{ horizon = 60, measurement_budget = 12, sensors = {sensors} }}
filter.particles = 200
"""


@dataclass(frozen=True)
class Case:
    """A command, and the number that is varied."""

    varied: str
    value: int
    command: str
    job: str
    changes: tuple[str, ...]
    ring: tuple[int, int] | None = None  # components and sensors, if the job is one of a ring


def cases(quick: bool) -> list[Case]:
    """Give all cases, the small ones of each kind first."""
    horizons = [20] if quick else [60, 200, 600, 2000]
    long = [20] if quick else [1000, 3000]
    fewer = "comparison.draws=2000"
    return [
        *(Case("draws of two sets", count, "compare", "plan.toml",
               ("problem.horizon=15", "problem.measurement_budget=6", "filter.particles=50",
                f"comparison.draws={count}"))
          for count in ([100, 200] if quick else [100_000, 1_000_000, 10_000_000])),
        *(Case("instants, a tenth measured", horizon, "plan", "plan.toml",
               (f"problem.horizon={horizon}", f"problem.measurement_budget={horizon // 10}", fewer))
          for horizon in horizons),
        *(Case("instants, 10 measured", horizon, "plan", "plan.toml",
               (f"problem.horizon={horizon}", "problem.measurement_budget=10", fewer))
          for horizon in long),
        *(Case("particles", count, "plan", "plan.toml", (f"filter.particles={count}", fewer))
          for count in ([100] if quick else [100, 1000, 10_000])),
        *(Case("components", count, "plan", "ring.toml", (fewer,), (count, 1))
          for count in ([2] if quick else [2, 8, 32])),
        *(Case("sensors", count, "plan", "ring.toml", (fewer,), (4, count))
          for count in ([2] if quick else [1, 4, 16])),
        *(Case("scenarios", count, "plan", "two_compartments.toml",
               (f"scenarios.count={count}", fewer))
          for count in ([] if quick else [4, 16, 64])),
        *(Case("visits of 200 instants, each of 4 measurements", count, "plan", "ring.toml",
               ("problem.horizon=199", f"problem.measurement_budget={4 * count}",
                f"problem.visits={{ within = 5, most = {count} }}", fewer), (4, 1))
          for count in ([] if quick else [2, 5, 20])),
    ]  # fmt: skip


def measure(quick: bool, say: Say) -> Tables:
    """Measure all cases on one core, each in a process of its own.

    Parameters
    ----------
    quick : bool
        Small problems.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        size: a row for each case, with varied, value, seconds of processor time and mebibytes.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="size-") as folder:
        small = cases(True)
        for number, case in enumerate([*small, *cases(quick)]):
            seconds, mebibytes = _measured(case, Path(folder, str(number)))
            if number >= len(small):
                row = {"varied": case.varied, "value": case.value}
                rows.append(row | {"seconds": seconds, "mebibytes": mebibytes})
                say(f"{case.varied} {case.value:,}: {seconds:.1f} s, {mebibytes:,.0f} MiB")
    return {"size": pd.DataFrame(rows)}


def _measured(case: Case, folder: Path) -> tuple[float, float]:
    """Seconds of processor time of a command, and the largest memory of its process."""
    folder.mkdir()
    job = JOBS / case.job
    if case.ring is not None:
        job, (components, sensors) = folder / case.job, case.ring
        job.write_text(_RING.format(sensors=[f"s{number}" for number in range(sensors)]))
        model = _MODEL.format(components=components, sensors=sensors)
        job.with_name("ring.py").write_text(model)
    own = {
        "compare": ("--times", "mine=0:15:3", "--times", "early=0:5:1"),
        "plan": ("--bound-draws", "0"),
    }
    changes = (word for each in case.changes for word in ("--set", each))
    words = (case.command, str(job), *own[case.command], *changes, "--results", str(folder / "run"))
    program = (sys.executable, "-c", _LARGEST, sys.executable, "-m", "pfdist")
    done = subprocess.run(  # noqa: S603  our own text
        [*program, *words, "--no-report", "--pool", "serial"], check=True, stdout=subprocess.PIPE
    )
    seconds, largest = json.loads(done.stdout)
    return seconds, largest / _MIB


def exponents(rows: pd.DataFrame) -> pd.Series:
    """The exponents with which seconds and memory grow, from the first to the last row."""
    first, last = rows.iloc[0], rows.iloc[-1]
    columns = ["seconds", "mebibytes"]
    ratio = np.log((last[columns] / first[columns]).astype(float))
    return pd.Series(ratio / np.log(last["value"] / first["value"]))


def lines(tables: Tables) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of the table: what grows, and how fast."""
    head = ["what grows", "sizes", "processor time, s", "largest memory, MiB", "exponents of both"]
    rows = [
        [
            str(varied), _listed(own["value"]), _listed(own["seconds"]),
            _listed(own["mebibytes"]), ", ".join(f"{each:.2f}" for each in exponents(own)),
        ]
        for varied, own in tables["size"].groupby("varied", sort=False)
    ]  # fmt: skip
    return head, rows


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    return "\n\n".join(
        [
            "One core; plans without a proof, with 2,000 draws in the comparison. Instants and "
            "particles: the growth model. Draws of two sets: T = 15, 50 particles. Components, "
            "sensors and visits: a ring of components, each driven by the one before; scenarios: "
            "`two_compartments`. The exponents are between the first and the last size.",
            markdown(*lines(tables)),
        ]
    )


def _listed(values: pd.Series) -> str:
    return "; ".join(f"{value:,.0f}" for value in values)


def plot(tables: Tables) -> Figure:
    """Draw processor time and memory against each number, as multiples of its first size."""
    figure = Figure(figsize=(2 * COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True)
    for varied, rows in tables["size"].groupby("varied", sort=False):
        times = rows["value"] / rows["value"].iloc[0]
        panels[0].plot(times, rows["seconds"], marker="o", label=str(varied))
        panels[1].plot(times, rows["mebibytes"], marker="o")
    for axes, label in zip(panels, ("processor time [s]", "largest memory [MiB]"), strict=True):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("size, as a multiple of the first")
        axes.set_ylabel(label)
    figure.legend(loc="outside right upper")
    return figure
