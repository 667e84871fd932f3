"""The points of a sweep, and how much work they are; nothing is computed."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from pfdist.analysis import open_run, read_recorded
from pfdist.api.sweep import asked_sweep, checked_folder
from pfdist.job.asked import Asked
from pfdist.job.job import Job
from pfdist.job.points import Values
from pfdist.runner.build import build
from pfdist.runner.comparison_phase import comparison_steps
from pfdist.runner.driver import foreseen_steps
from pfdist.store import holds_run

_NOTHING: Mapping[str, object] = {}


def foreseen(
    job: Asked,
    over: Values = _NOTHING,
    *,
    parallel: Sequence[Values] = (),
    points: Sequence[Values] = (),
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    judge: bool | None = None,
) -> pd.DataFrame:
    """The points of a sweep and about how much work each is; nothing is computed.

    Parameters
    ----------
    job, over, parallel, points, results, changes, judge
        As for `sweep`.

    Returns
    -------
    DataFrame
        A row for each point: its name, its values, the state of its run ("none" if it has not
        begun, "other run" if another run is in the way), and ``steps``, the particle-steps that
        the whole run takes. If the sweep judges, ``judging_steps`` are those that judge all found
        times there, if all differ.

    Raises
    ------
    PfdistError
        The sweep is wrong, or the model of a point.
    """
    asked = asked_sweep(job, over, parallel, points, changes)
    path, judges = checked_folder(asked, results, judge)
    rows, steps_a_set, found = [], [], 0
    for point in asked.points:
        folder, built = path / point.name, build(asked.jobs[point.name])
        state = _state(folder, asked.jobs[point.name])
        steps = foreseen_steps(built)
        rows.append({"point": point.name, **point.chosen, "state": state, "steps": steps})
        steps_a_set.append(comparison_steps(built) // len(built.names))
        found += len(built.names) - len(built.study.unsearched)
    points_of_sweep = pd.DataFrame(rows)
    if judges:
        points_of_sweep["judging_steps"] = [steps * (found + 1) for steps in steps_a_set]
    return points_of_sweep


def _state(folder: Path, job: Job) -> str:
    """How far the run of a point is."""
    if not holds_run(folder):
        return "none"
    recorded, wanted = read_recorded(folder)[1], job.identity()
    comparison = recorded.get("comparison")
    if isinstance(comparison, dict):  # a run may get more draws
        comparison["draws"] = wanted["comparison"]["draws"]
    return open_run(folder).state if recorded == wanted else "other run"
