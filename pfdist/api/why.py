"""Why a run's times are what they are: the error over time, and what each measurement is worth.

Computed anew, on draws of its own: neither those that chose the times nor those that compared them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.analysis import Moments, Run, finite, open_run, read_recorded
from pfdist.errors import JobError, RunMismatchError, StoreError, shown
from pfdist.evaluation.estimate import Purpose, ReportEvaluation
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Work, cut
from pfdist.job.job import load_job
from pfdist.plots import draw_why
from pfdist.runner.build import Built, build
from pfdist.runner.identity import changed_meanings
from pfdist.runner.named_by_a_run import NamedByRun
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.progress import Progress, Report
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

WHY = Purpose("why", ReportEvaluation)
DRAWS = 2000
MOST_DRAWS = 100_000_000  # as of a comparison
CHANGES = ("removed", "earlier", "later")
_COLUMNS = [f"{change}{part}" for change in CHANGES for part in ("", "_error")]


@dataclass(frozen=True)
class Why:
    """What `why` has found.

    Parameters
    ----------
    run : Path
    draws : int
        0 where everything is known without draws.
    sets : DataFrame
        A row a set: name, measurement_times, expected_mse, standard_error, degenerate_draws.
    profile : DataFrame
        A row a set and instant: name, t, measured, error (its expectation) and standard_error. The
        mean of a set's errors is its expected MSE.
    measurements : DataFrame
        A row a set and measurement: name, t, and by how much the expected MSE grows where it is
        removed, made one instant earlier or later: removed, earlier, later (NaN where another
        measurement is there, or no instant that the job allows), and removed_error and so on, their
        standard errors.
    figures : list of Path
        One for each search.
    """

    run: Path
    draws: int
    sets: pd.DataFrame
    profile: pd.DataFrame
    measurements: pd.DataFrame
    figures: list[Path]

    def as_json(self) -> dict[str, Any]:
        """All of it as JSON values; what is unknown is None."""
        sets = {}
        for row in self.sets.to_dict("records"):
            name = row.pop("name")
            its = {"profile": self.profile, "measurements": self.measurements}
            parts = {key: frame[frame["name"] == name] for key, frame in its.items()}
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
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Why:
    """Find how the error goes over time, and what each measurement of a finished run is worth.

    It runs the model, and draws the figures ``why-<search>`` into the run's. A model's file that
    the run's folder names is compared first, and not run unless it is the file that the run was
    made with and the user has run it on this machine before.

    Parameters
    ----------
    run : str or Path
        A finished run's folder.
    draws : int
        On which all is computed, in this process; memory does not grow with them.
    model, filter_model : str, optional
        ``path/file.py:object`` in the place of the file that the run names for the model, or for
        the filter's: what the user names is run, and must mean the same as the run's.
    report : callable, optional
        Is told of the progress.
    say : callable, optional
        Is told, in a line each, which files are run as the model, before they are.

    Returns
    -------
    Why

    Raises
    ------
    StoreError
        The folder holds no finished run, or one of another model than is there now; or it names a
        file that is not run unasked.
    JobError, ModelError
        There are too few draws, or the model cannot be loaded.
    """
    if not 2 <= draws <= MOST_DRAWS:
        least = "at least 2" if draws < 2 else f"at most {MOST_DRAWS:,}"
        raise JobError(f"draws must be {least}, got {shown(draws)}", argument="draws")
    opened = open_run(run)
    if opened.state != "finished":
        raise StoreError(f"{opened.path} is not finished ({opened.state}): run its job on first")
    if opened.has_budget:
        raise StoreError(
            f"{opened.path} has times of several numbers of measurements: why takes a run of one"
        )
    built = _build(opened, {"model": model, "filter_model": filter_model}, say)
    sets = opened.compared().set_index("name")["measurement_times"]
    examined = []
    for number, (name, times) in enumerate(sets.items()):
        tell = partial(_tell, report, draws, Progress(f"why {name}", number, len(sets)))
        examined.append(_examine(built, str(name), tuple(times.tolist()), draws, tell))
    summary, profile, measurements = (
        pd.DataFrame([row for part in parts for row in part])
        for parts in zip(*examined, strict=True)
    )
    drawn = 0 if built.problem.exact else draws
    figures = draw_why(opened, profile, measurements, drawn)
    return Why(opened.path, drawn, summary, profile, measurements, figures)


def _tell(report: Report, draws: int, before: Progress, share: float) -> None:
    report(replace(before, done=before.done + share, evaluations=round(draws * share)))


def _build(run: Run, instead: Mapping[str, str], say: Callable[[str], Any]) -> Built:
    """Make the run's problem of its own job, and see that its models are those it was run with."""
    about, _ = read_recorded(run.path)
    remedy = "to have a model run that you trust, name it: {part} = FILE.py:OBJECT"
    choose = NamedByRun(run.path, about, instead, say, remedy)
    built = build(load_job(run.path / "job.toml"), choose)
    differences = changed_meanings(about, built)
    if differences:
        message = f"{run.path} is of another model than is there now: the run's -> this one's"
        raise RunMismatchError(message, tuple(f"{k}: {v}" for k, v in differences.items()))
    return built


def _examine(
    built: Built, name: str, times: Times, draws: int, tell: Callable[[float], None]
) -> tuple[list[dict[str, Any]], ...]:
    """Rows of a set for the three frames of `Why`.

    The set up to every instant, and what becomes of it by every change, share draws and noise: so
    what they have in common is filtered once, and their differences are paired.
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
    (cost, *found), degenerate = _means(problem, work, tell)
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
    """Give every measurement, what may be done to it, and the set that it leads to.

    All may be removed, to see what they are worth; but moved only to where the job allows it.
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
    problem: Problem, work: Work, tell: Callable[[float], None]
) -> tuple[list[tuple[float, float]], int]:
    """Means and standard errors of what `_columns` gives, and how many draws are degenerate."""
    instants = problem.horizon + 1
    if problem.exact:
        known = problem.expected_mse(work.measurement_times, work.ends)
        tell(1.0)
        return [(float(mean), 0.0) for mean in _columns(known[None], instants)[0]], 0
    moments = [Moments() for _ in range(1 + len(work.ends))]
    block = max(1, int(MOST_SECONDS / problem.seconds_a_step / work.steps_a_draw))
    first, last = work.draws
    for piece in cut(range(first, last), block):
        mse = problem(replace(work, draws=piece)).mse
        for one, column in zip(moments, _columns(mse, instants).T, strict=True):
            one.add(column[~np.isnan(column)])
        tell((piece[1] - first) / (last - first))
    return [(one.mean, one.standard_error) for one in moments], last - first - moments[0].count


def _columns(mse: NDArray[np.float64], instants: int) -> NDArray[np.float64]:
    """From the sums of errors up to every instant, and the MSE of changed sets, (D, T+1+V).

    Returns
    -------
    array of float64, (D, 1+T+1+V)
        MSE, error at every instant, and what each change adds to the MSE; NaN where the set itself
        is degenerate.
    """
    whole = mse[:, instants - 1 : instants]
    with np.errstate(invalid="ignore"):  # infinite errors have no difference
        errors = np.diff(mse[:, :instants], axis=1, prepend=0.0) * instants
        rises = mse[:, instants:] - whole
    errors[np.isnan(whole[:, 0])] = np.nan  # before the instant at which it became so, too
    return np.concatenate([whole, errors, rises], axis=1)
