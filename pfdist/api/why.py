"""The error over time of a run's sets, and the worth of each of their measurements.

Everything is computed on new draws, which neither chose the times nor compared them.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.analysis import Run, finite
from pfdist.api.finished_run import built_again, finished_run
from pfdist.api.following import Say, following, silent
from pfdist.api.own_store import own_store
from pfdist.api.report import renew_report
from pfdist.common.cards import Card, Shown
from pfdist.common.rounding import with_error
from pfdist.errors import JobError, shown
from pfdist.plots import draw_figures
from pfdist.runner.build import Built
from pfdist.runner.progress import Reporter, Show
from pfdist.runner.worth import worth_of
from pfdist.store import WHY_PHASE, schema
from pfdist.times.measurement_times import Times, validated

DRAWS = 2000
FIGURES = ("why", "filters")
MOST_DRAWS = 100_000_000  # as many as a comparison may have


@dataclass(frozen=True, repr=False)
class Why(Shown):
    """Result of `why`.

    Parameters
    ----------
    run : Path
    draws : int
        0 if the engine is exact and needs no draws.
    sets : DataFrame
        A row for each set: name, measurement_times, expected_mse, standard_error and
        degenerate_draws.
    profile : DataFrame
        A row for each set and instant: position and name of the set, t, measured, draws, error (the
        expected error at t), standard_error, degenerate_draws (up to t) and effective_sample_size
        (after the measurement at t, mean over the draws with trajectories; NaN if t is not
        measured, or if the engine is exact). The mean of a set's errors is the expected MSE of the
        set.
    worth : DataFrame
        A row for each set and measurement: position, name, t, draws, and the rise of the expected
        MSE if the measurement is removed, or made one instant earlier or later: removed, earlier,
        later. NaN if another measurement is made at that instant, or if the job does not allow the
        instant. The standard errors are removed_error, earlier_error and later_error.
    figures : list of Path
        A figure for each search.
    """

    run: Path
    draws: int
    sets: pd.DataFrame
    profile: pd.DataFrame
    worth: pd.DataFrame
    figures: list[Path]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        sets = {}
        frames = {"profile": self.profile, "worth": self.worth}
        for row in self.sets.to_dict("records"):
            name = row.pop("name")
            parts = {key: frame[frame["name"] == name] for key, frame in frames.items()}
            parts = {
                key: frame.drop(columns=["position", "name", "draws"])
                for key, frame in parts.items()
            }
            sets[str(name)] = row | {key: frame.to_dict("records") for key, frame in parts.items()}
        found = {"run": str(self.run), "draws": self.draws, "sets": sets}
        answer: dict[str, Any] = finite(found | {"figures": list(map(str, self.figures))})
        return answer

    def _card(self) -> Card:
        drawn = f"on {self.draws:,} fresh draws" if self.draws else "exact"
        head = ("times", "measured at t", "rise of the expected MSE without it")
        rows = [
            (str(row["name"]), str(row["t"]), with_error(row["removed"], row["removed_error"]))
            for row in self.worth.to_dict("records")
        ]
        return Card(f"what each measurement of {self.run} is worth, {drawn}", head, rows)


def why(
    run: str | Path,
    draws: int = DRAWS,
    *,
    model: str = "",
    filter_model: str = "",
    figures: bool = True,
    progress: Show | bool = False,
    say: Say = silent,
) -> Why:
    """Compute the error over time, and the worth of each measurement of a finished run.

    The function runs the model, writes the tables ``profile`` and ``worth`` of the run, and draws
    the figures ``why-<search>`` into its folder. It runs a model file that the run's folder names
    only if the file is unchanged since the run, and if the user has run the file on this machine
    before.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run.
    draws : int
        Number of draws, computed in this process; memory does not grow with them.
    model, filter_model : str, optional
        ``path/file.py:object``: replaces the file that the run names for the model or for the
        filter's model. It is run without question, and must mean the same as the run's model.
    figures : bool
        Whether to draw the figures ``why-<search>``.
    progress : callable or bool
        Whether to show progress and messages, or what receives each
        `pfdist.runner.progress.Progress`.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Returns
    -------
    Why

    Raises
    ------
    StoreError
        The folder holds no finished run, or the model has changed since, or the run names a model
        file that is not run without the user's word.
    JobError, ModelError
        There are too few draws, or the model cannot be loaded.
    """
    if not 2 <= draws <= MOST_DRAWS:
        least = "at least 2" if draws < 2 else f"at most {MOST_DRAWS:,}"
        raise JobError(f"draws must be {least}, got {shown(draws)}", argument="draws")
    opened = finished_run(run)
    sets = opened.sets_of_one_number()
    with following(progress, say) as (show, tell):
        built = built_again(opened, {"model": model, "filter_model": filter_model}, tell)
        found = _examine(opened, sets, built, draws, Reporter(show, len(sets)), tell)
        files = [file for name in FIGURES for file in draw_figures(opened, name)] if figures else []
        renew_report(opened.path, tell)
    return replace(found, figures=files)


def _examine(
    run: Run, sets: dict[str, Times], built: Built, draws: int, reporter: Reporter, say: Say
) -> Why:
    """Compute the worth of all measurements, and store the tables; no figure is drawn."""
    drawn = 0 if built.problem.exact else draws
    answers = list[dict[str, Any]]()
    rows: dict[str, list[dict[str, Any]]] = {"profile": [], "worth": []}
    with own_store(run, built, say, must_be=False) as store:
        for position, (name, times) in enumerate(sets.items()):
            reporter.note(phase=f"why {name}", done=position)
            checked = validated(times, built.problem.horizon, f"{run.path}: {name}")
            found = worth_of(built, name, checked, draws, _measured(run, checked), reporter)
            about = {"position": position, "name": name, "draws": drawn}
            rows["profile"] += [about | row for row in found.profile]
            rows["worth"] += [about | row for row in found.worth]
            answers.append({"name": name, "measurement_times": list(checked)} | found.summary)
        tables = {name: _table(name, rows[name]) for name in rows}
        for name, table in tables.items():
            store.publish(name, WHY_PHASE, [table])
    frames = {name: table.to_pandas() for name, table in tables.items()}
    return Why(run.path, drawn, pd.DataFrame(answers), **frames, figures=[])


def _measured(run: Run, times: Times) -> list[NDArray[np.float64]]:
    """For each draw with a trajectory, what would be measured at these times, (N, m)."""
    rows = run.trajectories()
    columns = [name for name in rows if str(name).startswith("y_")]
    return [
        draw.set_index("t").loc[list(times), columns].to_numpy() for _, draw in rows.groupby("draw")
    ]


def _table(name: str, rows: list[dict[str, Any]]) -> pa.Table:
    return pa.Table.from_pandas(pd.DataFrame(rows), schema=schema(name), preserve_index=False)
