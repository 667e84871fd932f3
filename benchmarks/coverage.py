"""How often the intervals of a comparison hold, with and without a control, and how wide they are.

Two sets of six systems are compared 200 times on fresh draws. The truth of an expected error and of
a gain is that of all these draws with controls, which is 14 times as exact as one comparison. Two
systems have heavy tails: states that jump rarely, and states that move by noise of Student's t with
three degrees of freedom, of which no interval of a mean can hold exactly.
"""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import StateSpaceModel, load_model
from pfdist.common.percent import heavy_tail_warning
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, cut
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREY, RED
from pfdist.results import ComparisonStatistics

TITLE = "Coverage of intervals"
TABLES: tuple[str, ...] = ("coverage",)

HORIZON, PARTICLES = 30, 200
SETS = {"regular": (0, 6, 12, 18, 24, 30), "early": (0, 1, 3, 5, 8, 12)}
REPEATS, DRAWS = 200, 500  # draws of each comparison
SHIPPED = ("ungm", "random_walk", "bearings_only", "stochastic_volatility")


def _walk(name: str, noise: tuple[str, ...], step: Any) -> StateSpaceModel:
    """A walk x' = .95 x + step, with y = x + v and z = x."""
    return StateSpaceModel(
        name=name,
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (0.95 * x[0] + step(w),),
        measurement=lambda x, t, v, p: (x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=noise,
        measurement_noise=("normal",),
    )


def _jump(w: Any) -> Any:
    return 0.3 * w[0] + np.where(w[1] < 0.01, 8.0 * w[2], 0.0)


def _student(w: Any) -> Any:
    return 0.5 * w[0] * np.sqrt(3.0 / (w[1] ** 2 + w[2] ** 2 + w[3] ** 2))


HEAVY = (
    _walk("rare jumps", ("normal", "uniform", "normal"), _jump),
    _walk("Student's t", ("normal",) * 4, _student),
)


def measure(quick: bool, say: Say) -> Tables:
    """Compare two sets of each system many times.

    Parameters
    ----------
    quick : bool
        Two systems, 20 repetitions.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        coverage: a row for each system and quantity (mse of the regular times, gain of means), with
        mean_control and its error (of the regular times), plain and controlled (share of the
        repetitions whose 95 % interval holds the truth), saved (squared median width of the
        intervals, over that with a control), and warned (share of the repetitions with a control
        that warn of heavy tails).
    """
    rows, repeats = [], 20 if quick else REPEATS
    for model in [*map(load_model, SHIPPED), *HEAVY][-2 if quick else 0 :]:
        evaluator = Evaluator(model, HORIZON)
        work = evaluator.work(
            [*SETS.values()],
            1,
            2,
            (0, repeats * DRAWS),
            Estimation(PARTICLES),
            controlled=True,
        )
        results = [
            evaluator.filtered(work.piece(block)) for block in cut(range(work.draws[1]), 5000)
        ]
        mse, control = (
            np.concatenate([getattr(each, name) for each in results]) for name in ("mse", "control")
        )
        rows += _rows(model.name, mse, control, repeats)
        say(f"{model.name}: {rows[-2]['plain']:.3f}, {rows[-2]['controlled']:.3f}")
    return {"coverage": pd.DataFrame(rows)}


def _rows(system: str, mse: Any, control: Any, repeats: int) -> list[dict[str, Any]]:
    both = {"plain": mse, "controlled": np.hstack([mse, control])}
    truth = _statistics(both["controlled"])
    mean = truth.mse["regular"].mean, truth.gains["early"].of_means
    found = {
        kind: [_intervals(_statistics(part)) for part in np.split(block, repeats)]
        for kind, block in both.items()
    }
    of_regular = control[:, 0]
    parts = map(_statistics, np.split(both["controlled"], repeats))
    shares = [{name: part.largest_share(name) for name in SETS} for part in parts]
    warned = [bool(heavy_tail_warning(each.values())) for each in shares]
    about = {
        "system": system,
        "warned": np.mean(warned),
        "mean_control": of_regular.mean(),
        "mean_control_error": of_regular.std(ddof=1) / np.sqrt(len(of_regular)),
    }
    rows = []
    for place, quantity in enumerate(("mse", "gain")):
        intervals = {kind: np.array(each)[:, place] for kind, each in found.items()}
        holds = {
            kind: np.mean((low <= mean[place]) & (mean[place] <= high))
            for kind, (low, high) in ((kind, each.T) for kind, each in intervals.items())
        }
        width = {kind: np.median(np.diff(each)) ** 2 for kind, each in intervals.items()}
        saved = width["plain"] / width["controlled"]
        rows.append({**about, "quantity": quantity, **holds, "saved": saved})
    return rows


def _statistics(block: Any) -> ComparisonStatistics:
    statistics = ComparisonStatistics([*SETS])
    statistics.add(block)
    return statistics


def _intervals(statistics: ComparisonStatistics) -> list[tuple[float, float]]:
    """The printed intervals: of the expected error of the regular times, and of the gain."""
    gain = statistics.gains["early"]
    return [statistics.estimate("regular").interval(), gain.of_means_interval]


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    lines = [
        [
            f"{row['system']}, {'expected error' if row['quantity'] == 'mse' else 'gain of means'}",
            f"{100 * row['plain']:.1f}",
            f"{100 * row['controlled']:.1f}",
            f"{row['saved']:.1f}",
            f"{100 * row['warned']:.0f}",
            f"{row['mean_control'] / row['mean_control_error']:+.1f}",
        ]
        for row in tables["coverage"].to_dict("records")
    ]
    header = (
        "system, quantity",
        "without, %",
        "with, %",
        "variance saved",
        "warned, %",
        "mean of c over its se",
    )
    return (
        f"How many of {REPEATS} comparisons of {DRAWS} draws have a 95 % interval that holds the "
        f"truth, without and with a control (± 1.5 %); T = {HORIZON}, 6 measurements, {PARTICLES} "
        "particles. Variance saved: squared median width of the intervals without a control, over "
        "that with it. Warned: a line says that few draws carry much of an error. The last two "
        "systems have heavy tails. A control does not lower the rare, large errors of filters that "
        "lose the state. So the interval of an expected error counts one more draw that is as "
        "large as the largest and has no control; that of a gain does not.\n\n"
        + markdown(header, lines)
    )


def plot(tables: Tables) -> Figure:
    """Draw the coverage of each system."""
    figure = Figure(figsize=(COLUMN_INCHES, 1.1 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(2, sharex=True)
    for axes, (quantity, rows) in zip(panels, tables["coverage"].groupby("quantity"), strict=True):
        for kind, colour, label in (
            ("plain", RED, "without"),
            ("controlled", BLUE, "with control"),
        ):
            axes.plot(100 * rows[kind], rows["system"], "o", color=colour, label=label)
        axes.axvline(95, color=GREY, lw=0.6, ls=":")
        axes.set_title({"mse": "expected error", "gain": "gain of means"}[str(quantity)])
    panels[1].set_xlabel("intervals that hold the truth, %")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure
