"""The error over time of a run's sets, and the worth of each of their measurements.

Everything is computed on new draws, which neither chose the times nor compared them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.analysis import Moments, finite
from pfdist.api.finished_run import built_again, finished_run
from pfdist.errors import JobError, shown
from pfdist.evaluation.estimate import Purpose, ReportEvaluation
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Work
from pfdist.plots import draw_why
from pfdist.runner.build import Built
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.progress import Report, Reporter
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times, validated

WHY = Purpose("why", ReportEvaluation)
DRAWS = 2000
MOST_DRAWS = 100_000_000  # as many as a comparison may have
CHANGES = ("removed", "earlier", "later")
_COLUMNS = [f"{change}{part}" for change in CHANGES for part in ("", "_error")]


@dataclass(frozen=True)
class Why:
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
        A row for each set and instant: name, t, measured, error (the expected error at t) and
        standard_error. The mean of a set's errors is the expected MSE of the set.
    measurements : DataFrame
        A row for each set and measurement: name, t, and the rise of the expected MSE if the
        measurement is removed, or made one instant earlier or later: removed, earlier, later. NaN
        if another measurement is made at that instant, or if the job does not allow the instant.
        The standard errors are removed_error, earlier_error and later_error.
    figures : list of Path
        A figure for each search.
    """

    run: Path
    draws: int
    sets: pd.DataFrame
    profile: pd.DataFrame
    measurements: pd.DataFrame
    figures: list[Path]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        sets = {}
        frames = {"profile": self.profile, "measurements": self.measurements}
        for row in self.sets.to_dict("records"):
            name = row.pop("name")
            parts = {key: frame[frame["name"] == name] for key, frame in frames.items()}
            parts = {key: frame.drop(columns="name") for key, frame in parts.items()}
            sets[str(name)] = row | {key: frame.to_dict("records") for key, frame in parts.items()}
        found = {"run": str(self.run), "draws": self.draws, "sets": sets}
        answer: dict[str, Any] = finite(found | {"figures": list(map(str, self.figures))})
        return answer


def why(
    run: str | Path,
    draws: int = DRAWS,
    *,
    model: str = "",
    filter_model: str = "",
    figures: bool = True,
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Why:
    """Compute the error over time, and the worth of each measurement of a finished run.

    The function runs the model, and draws the figures ``why-<search>`` into the run's folder. It
    runs a model file that the run's folder names only if the file is unchanged since the run, and
    if the user has run the file on this machine before.

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
    report : callable, optional
        Receives the progress.
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
    built = built_again(opened, {"model": model, "filter_model": filter_model}, say)
    reporter, examined = Reporter(report, len(sets)), []
    for number, (name, times) in enumerate(sets.items()):
        reporter.note(phase=f"why {name}", done=number)
        checked = validated(times, built.problem.horizon, f"{opened.path}: {name}")
        examined.append(_examine(built, name, checked, draws, reporter))
    summary, profile, measurements = (
        pd.DataFrame([row for part in parts for row in part])
        for parts in zip(*examined, strict=True)
    )
    drawn = 0 if built.problem.exact else draws
    files = draw_why(opened, profile, measurements, drawn) if figures else []
    return Why(opened.path, drawn, summary, profile, measurements, files)


def _examine(
    built: Built, name: str, times: Times, draws: int, reporter: Reporter
) -> tuple[list[dict[str, Any]], ...]:
    """Rows of a set for the three frames of `Why`.

    The set up to every instant and all its changes share draws and noise. So common prefixes are
    filtered once, and differences are paired.
    """
    problem, seed, instants = built.problem, built.job.seed, built.problem.horizon + 1
    changed = list(_changes(times, built.job.problem.feasible))
    sets = [tuple(t for t in times if t <= end) for end in range(instants)]
    sets += [other for _, _, other in changed]
    work = Work(
        measurement_times=tuple(sets),
        ends=(*range(instants), *(problem.horizon,) * len(changed)),
        filter_streams=(WHY.stream(seed, "filter", name),) * len(sets),
        draws_stream=WHY.stream(seed, "draws"),
        draws=(0, draws),
        estimation=built.comparing,
    )
    (cost, *found), degenerate = _means(problem, work, reporter)
    summary = {"name": name, "measurement_times": list(times), "expected_mse": cost[0]}
    summary |= {"standard_error": cost[1], "degenerate_draws": degenerate}
    profile = [
        {"name": name, "t": t, "measured": t in times, "error": mean, "standard_error": error}
        for t, (mean, error) in enumerate(found[:instants])
    ]
    measurements = {t: {"name": name, "t": t} | dict.fromkeys(_COLUMNS, np.nan) for t in times}
    for (t, change, _), (mean, error) in zip(changed, found[instants:], strict=True):
        measurements[t] |= {change: mean, f"{change}_error": error}
    return [summary], profile, list(measurements.values())


def _changes(times: Times, feasible: Feasible) -> Iterator[tuple[int, str, Times]]:
    """Yield each measurement with each change of it, and the set that follows.

    Every measurement may be removed, but it moves only to instants that the job allows.
    """
    for t in times:
        others = set(times) - {t}
        yield t, "removed", tuple(sorted(others))
        for change, to in (("earlier", t - 1), ("later", t + 1)):
            moved = tuple(sorted(others | {to}))
            free = to in feasible.optional and to not in others and t not in feasible.required
            if free and feasible.allows(moved):
                yield t, change, moved


def _means(
    problem: Problem, work: Work, reporter: Reporter
) -> tuple[list[tuple[float, float]], int]:
    """Mean and standard error of each column of `_columns`, and the number of degenerate draws."""
    instants, (_, draws), start = problem.horizon + 1, work.draws, reporter.progress.done
    if problem.exact:
        known = problem.expected_mse(work.measurement_times, work.ends)
        reporter.reach(start + 1, evaluations=draws)
        return [(float(mean), 0.0) for mean in _columns(known[None], instants)[0]], 0
    columns = [Moments() for _ in range(1 + len(work.ends))]
    for piece in problem.pieces(work, MOST_SECONDS):
        mse = problem.filtered(piece).mse
        for moments, values in zip(columns, _columns(mse, instants).T, strict=True):
            moments.add(values[~np.isnan(values)])
        _, compared = piece.draws
        reporter.reach(start + compared / draws, evaluations=compared)
    means = [(moments.mean, moments.standard_error) for moments in columns]
    return means, draws - columns[0].count


def _columns(mse: NDArray[np.float64], instants: int) -> NDArray[np.float64]:
    """MSE, error at every instant, and rise of the MSE by each change, for each draw.

    Parameters
    ----------
    mse : array of float64, (D, T+1+V)
        Sum of the errors up to every instant over T+1, then the MSE of each of V changed sets.
    instants : int
        T+1.

    Returns
    -------
    array of float64, (D, 1+T+1+V)
        NaN where the unchanged set is degenerate.
    """
    whole = mse[:, instants - 1 : instants]
    with np.errstate(invalid="ignore"):  # infinite errors have no difference
        errors = np.diff(mse[:, :instants], axis=1, prepend=0.0) * instants
        rises = mse[:, instants:] - whole
    errors[np.isnan(whole[:, 0])] = np.nan  # also before the instant of the degeneracy
    return np.concatenate([whole, errors, rises], axis=1)
