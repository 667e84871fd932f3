"""The paper's genetic algorithm with several seeds; all found sets are compared on common draws.

Each search is that of ``jobs/paper.toml`` with another seed. Then the found sets, the best set
known and the regular times filter the same fresh draws. Each set has its own filter noise, as in
the comparison of a run.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from benchmarks.search_runs import best_known, filtered, search
from pfdist import load_job
from pfdist.common.streams import stream_of
from pfdist.pages.style import COLUMN_INCHES, GREY, RED
from pfdist.problem.sections import Execution
from pfdist.results import relative_gain
from pfdist.runner.build import build, make_pool

TITLE = "The paper's genetic algorithm"
TABLES: tuple[str, ...] = ("genetic",)

HERE = Path(__file__).parent
SEEDS = (2020, *range(1, 15))  # 2020 is the seed of the job
DRAWS = 60_000
SMALL = ["problem.horizon=14", "problem.measurement_budget=4", "evaluation.draws=50"]
BEST, REGULAR = "best known", "regular"


def measure(quick: bool, say: Say) -> Tables:
    """Run the search with each seed, and compare the found sets on common draws.

    Parameters
    ----------
    quick : bool
        A small problem, two seeds.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        genetic: a row for each seed, and rows for the best set known and the regular times, with
        name, times, steps, believed, cost, standard_error, excess (in per cent of the cost of the
        best set known), excess_error, gain and positive (means over the draws).
    """
    changes = [*(SMALL if quick else []), "comparison.draws=2", 'search=[{method="genetic"}]']
    job, seeds = (
        load_job(HERE.parent / "jobs" / "paper.toml", changes),
        SEEDS[: 2 if quick else None],
    )
    with make_pool(Execution(pool="serial" if quick else "ray")) as pool:
        rows = []
        for seed in seeds:
            found = search(job.with_changes([f"seed={seed}"]), pool)
            rows.append({"name": str(seed), **found})
            say(f"seed {seed}: {found['seconds']:.0f} s")
        regular = job.problem.feasible.regular()
        rows += [{"name": BEST, "times": regular if quick else best_known("paper")[0]}]
        rows += [{"name": REGULAR, "times": regular}]
        sets = [row["times"] for row in rows]
        streams = [stream_of("comparison", 0, "filter", row["name"]) for row in rows]
        draws = (0, 100 if quick else DRAWS)
        mse = filtered(build(job), pool, sets, stream_of("comparison", 0, "draws"), draws, streams)
    judged = [_judged(column, mse[:, -2], mse[:, -1]) for column in mse.T]
    table = pd.DataFrame([row | costs for row, costs in zip(rows, judged, strict=True)])
    return {"genetic": table.assign(times=[" ".join(map(str, times)) for times in sets])}


def _judged(
    mse: NDArray[np.float64], best: NDArray[np.float64], regular: NDArray[np.float64]
) -> dict[str, float]:
    """Give the columns of a set, from its per-draw MSE, the best set's and the regular times'."""
    root, scale = np.sqrt(mse.size), 100 / best.mean()
    gain = relative_gain(mse, regular)
    return {
        "cost": mse.mean(),
        "standard_error": mse.std(ddof=1) / root,
        "excess": scale * np.mean(mse - best),
        "excess_error": scale * np.std(mse - best, ddof=1) / root,
        "gain": gain.mean(),
        "positive": np.mean(gain > 0),
    }


@dataclass(frozen=True)
class Spread:
    """The spread of a figure over the seeds: mean with 95 % interval, standard deviation, range."""

    values: NDArray[np.float64]

    def text(self, form: str) -> str:
        """Give the spread in words."""
        mean, sd = self.values.mean(), self.values.std(ddof=1)
        half = stats.t.isf(0.025, self.values.size - 1) * sd / np.sqrt(self.values.size)
        least, most = self.values.min(), self.values.max()
        return (
            f"{mean:{form}} (95 %: {mean - half:{form}} to {mean + half:{form}}; sd between "
            f"searches {sd:{form}}; {least:{form}} to {most:{form}})"
        )


def summary(tables: Tables) -> str:
    """Give a summary of the found sets in Markdown."""
    table = tables["genetic"].set_index("name")
    found = table.drop([BEST, REGULAR])
    excess, mse, gain, positive, bias = (
        Spread(column.to_numpy(np.float64))
        for column in (
            found["excess"], found["cost"], 100 * found["gain"], 100 * found["positive"],
            100 * (found["believed"] / found["cost"] - 1),
        )
    )  # fmt: skip
    lines = [
        [
            str(name), f"{row['cost']:.2f} ± {row['standard_error']:.2f}",
            f"{row['excess']:+.2f} ± {row['excess_error']:.2f}", f"{100 * row['gain']:.1f}",
            f"{100 * row['positive']:.1f}",
        ]
        for name, row in table.iterrows()
    ]  # fmt: skip
    header = ["seed", "expected MSE", "excess, %", "mean relative gain, %", "positive, %"]
    return (
        f"{len(found)} searches of `jobs/paper.toml`, a seed each; all sets judged on the same "
        f"{DRAWS:,} fresh draws, each with its own filter noise. Excess over the best set known: "
        f"{excess.text('.2f')} %. Expected MSE: {mse.text('.2f')}. Mean relative gain: "
        f"{gain.text('.1f')} %. Draws with a positive gain: {positive.text('.1f')} %. A "
        f"search's own estimate differs from the expected MSE on fresh draws by "
        f"{bias.text('.1f')} %.\n\n{markdown(header, lines)}"
    )


def plot(tables: Tables) -> Figure:
    """Draw the excess of each search over the best set known."""
    table = tables["genetic"].set_index("name").drop([BEST, REGULAR]).sort_values("excess")
    figure = Figure(figsize=(COLUMN_INCHES, 2.2), layout="constrained")
    axes = figure.subplots()
    place = np.arange(len(table))
    axes.errorbar(
        table["excess"], place, xerr=1.96 * table["excess_error"], fmt="o", ms=3, color=RED
    )
    axes.axvline(table["excess"].mean(), color=GREY, lw=0.8, ls=":", label="mean of the searches")
    axes.set_yticks(place, [str(name) for name in table.index])
    axes.set_xlim(left=min(0.0, 1.1 * table["excess"].min()))
    axes.set_ylabel("seed")
    axes.set_xlabel("excess over the best set known, % (95 %)")
    axes.legend(loc="lower right")
    return figure


if __name__ == "__main__":
    from benchmarks.__main__ import main

    sys.exit(main(["genetic", *sys.argv[1:]]))
