"""Plans for one guess, for the mean of scenarios and for the worst of them, on the same draws."""

import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.common.rounding import with_error
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED
from pfdist.problem.scenarios_section import Scenarios

TITLE = "Robust plans"
TABLES: tuple[str, ...] = ("robust",)

_JOBS = Path(__file__).parents[1] / "jobs"
SCENARIOS = 8
DRAWS = 24_000  # of the comparison
# Parameters that a plan may have guessed wrongly; `two_compartments` has its own scenarios.
_GUESSES: dict[str, dict[str, dict[str, list[float]]]] = {
    "two_compartments": {},
    "pharmacokinetics": {
        "clearance": {"lognormal": [4.5, 0.5]},
        "exchange": {"lognormal": [6.0, 0.5]},
        "measurement_sd": {"lognormal": [0.15, 0.5]},
    },
    "tumour": {
        "amplitude_sd": {"lognormal": [1.0, 0.5]},
        "offset_sd": {"lognormal": [1.0, 0.5]},
        "measurement_sd": {"lognormal": [1.0, 0.5]},
    },
}
_PLANS = {
    "nominal": "the nominal parameters",
    "mean": "the mean of the scenarios",
    "worst": "the largest error",
    "loss": "the largest loss",
}


def measure(quick: bool, say: Say) -> Tables:
    """Make four plans for each of three systems, and compare them.

    Parameters
    ----------
    quick : bool
        Few draws, and one system.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        robust: a row for each plan, with system, planned_for, times, mean_mse (over the scenarios)
        and mean_error, worst_mse (of the worst scenario) and worst_error, worst_loss (largest loss
        of a scenario, by how much the error there lies above that of the best set compared) and
        mean_loss (of the mean MSE, in the same way).
    """
    systems = [*_GUESSES][: 1 if quick else None]
    return {"robust": pd.concat([_compared(name, quick, say) for name in systems])}


def _compared(name: str, quick: bool, say: Say) -> pd.DataFrame:
    """The rows of one system."""
    job: dict[str, Any] = tomllib.loads((_JOBS / f"{name}.toml").read_text(encoding="utf-8"))
    own = job.pop("scenarios", None) or {"parameters": _GUESSES[name], "count": SCENARIOS}
    section = {**own, "criterion": "mean", "filter": "nominal"}
    every = Scenarios.model_validate(section).each
    with tempfile.TemporaryDirectory(prefix="robust-") as folder:
        planned = _Planned(job, Path(folder))
        sets = {
            f"own_{number}": planned(f"own_{number}", {"parameters": [dict(scenario.parameters)]})
            for number, scenario in enumerate(every)
        }
        sets["nominal"] = planned("nominal", None)
        sets["mean"] = planned("mean", section)
        sets["worst"] = planned("worst", section | {"criterion": "worst"})
        least = _of_scenarios(planned.compare(sets, section, 240 if quick else DRAWS // 3))[0]
        scales = {"criterion": "worst", "scales": least.min(axis=1).tolist()}
        sets["loss"] = planned("loss", section | scales)
        run = planned.compare(sets, section, 240 if quick else DRAWS, seed=1)
        mse, errors = (table[[*sets]] for table in _of_scenarios(run))
        results = run.table("sets").set_index("name")
    means, rows = results["expected_mse"][[*sets]], []
    for each, planned_for in _PLANS.items():
        worst = int(mse[each].argmax())
        times = ", ".join(map(str, sets[each]))
        say(f"{name}, {planned_for}: {times}")
        rows.append(
            {
                "system": name,
                "planned_for": planned_for,
                "times": times,
                "mean_mse": means[each],
                "mean_error": results["standard_error"][each],
                "worst_mse": mse[each].iloc[worst],
                "worst_error": errors[each].iloc[worst],
                "worst_loss": (mse[each] / mse.min(axis=1)).max() - 1,
                "mean_loss": means[each] / results["expected_mse"][[*sets]].min() - 1,
            }
        )
    return pd.DataFrame(rows)


class _Planned:
    """Plans of one job with several sections of scenarios."""

    def __init__(self, job: Mapping[str, Any], folder: Path) -> None:
        self._job, self._folder = dict(job), folder

    def __call__(self, name: str, scenarios: Mapping[str, Any] | None) -> list[str | float]:
        """The times that are best for these scenarios; None stands for the nominal parameters."""
        run = pfdist.plan(
            self._written(name, scenarios), self._folder / name,
            changes=["comparison.draws=240"], bound_draws=0, report=False,
        )  # fmt: skip
        return list(run.best.measurement_times)

    def compare(
        self, sets: Mapping[str, list[str | float]], scenarios: Mapping[str, Any], draws: int,
        seed: int = 0,
    ) -> pfdist.Run:  # fmt: skip
        """The sets, compared on the same draws of all scenarios."""
        return pfdist.compare(
            self._written("compared", scenarios), times=sets, draws=draws, report=False,
            results=self._folder / f"compared-{seed}", changes=[f"seed={seed}"],
        )  # fmt: skip

    def _written(self, name: str, scenarios: Mapping[str, Any] | None) -> Path:
        path = self._folder / f"{name}.toml"
        section = {} if scenarios is None else {"scenarios": dict(scenarios)}
        path.write_text(tomli_w.dumps(self._job | section), encoding="utf-8")
        return path


def _of_scenarios(run: pfdist.Run) -> list[pd.DataFrame]:
    """The expected MSE of each set (columns) in each scenario (rows), and the standard errors."""
    table = run.table("scenarios")
    return [
        table.pivot_table(index="scenario", columns="name", values=column)
        for column in ("expected_mse", "standard_error")
    ]


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    rows = [
        [
            system,
            planned_for,
            with_error(mean, mean_error),
            with_error(worst, worst_error),
            f"{100 * worst_loss:.1f}",
            f"{100 * mean_loss:.1f}",
        ]
        for system, planned_for, _, mean, mean_error, worst, worst_error, worst_loss, mean_loss in (
            tables["robust"].itertuples(index=False)
        )
    ]
    head = (
        "system",
        "planned for",
        "mean error",
        "largest error",
        "largest loss, %",
        "loss of the mean, %",
    )
    table = markdown(head, rows)
    return (
        f"Four plans for {SCENARIOS} scenarios, on the same {DRAWS:,} draws. Loss: by how much an "
        f"error lies above that of the best set compared.\n\n{table}"
    )


def plot(tables: Tables) -> Figure:
    """Give the figure: the largest loss and the loss of the mean of each plan, for each system."""
    systems = tables["robust"].groupby("system", sort=False)
    canvas = Figure(figsize=(COLUMN_INCHES, 1.2 * len(systems) + 0.8), layout="constrained")
    axes = np.atleast_1d(canvas.subplots(len(systems), sharey=True))
    for ax, (system, plans) in zip(axes, systems, strict=True):
        for column, colour, label in (
            ("worst_loss", RED, "largest loss"),
            ("mean_loss", BLUE, "loss of the mean"),
        ):
            ax.plot(100 * plans[column], plans["planned_for"], "o", color=colour, label=label)
        ax.set_title(str(system))
    axes[0].invert_yaxis()
    axes[-1].set_xlabel("loss, %")
    canvas.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return canvas
