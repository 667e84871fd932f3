"""The time to measure next, from a run and the measurements so far."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from pfdist.analysis import finite
from pfdist.api.finished_run import built_again, finished_run
from pfdist.api.planned_set import planned_set
from pfdist.api.planner import Planner
from pfdist.errors import MeasurementsError
from pfdist.evaluation.estimate import ReportEvaluation
from pfdist.sequential.measurements import Measurements, read_measurements
from pfdist.sequential.user_prior import read_prior
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class NextTime:
    """Result of `next_time`.

    Parameters
    ----------
    run : Path
    name : str
        Name of the compared set whose times were planned before anything was measured.
    measured : tuple of int
        Times with a measurement.
    now : int
        The instant from which on errors are expected: the last that has passed.
    plan : tuple of int
        Times that are left to be measured, the next first; empty if the budget is spent.
    planned_before : tuple of int
        Times of the first plan that are left.
    expected, expected_before : ReportEvaluation
        Expected MSE from `now` to T with both plans, on the same fresh simulated systems.
    """

    run: Path
    name: str
    measured: Times
    now: int
    plan: Times
    planned_before: Times
    expected: ReportEvaluation
    expected_before: ReportEvaluation

    @property
    def next(self) -> int | None:
        """The time to measure next; None if the budget is spent."""
        return self.plan[0] if self.plan else None

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        answer = {
            "run": str(self.run),
            "times": self.name,
            "measured": self.measured,
            "now": self.now,
            "next": self.next,
            "plan": self.plan,
            "expected_mse": self.expected.expected_mse,
            "standard_error": self.expected.standard_error,
            "planned_before": self.planned_before,
            "expected_mse_before": self.expected_before.expected_mse,
            "standard_error_before": self.expected_before.standard_error,
            "draws": self.expected.draws,
        }
        found: dict[str, Any] = finite(answer)
        return found


def next_time(
    run: str | Path,
    measurements: str | Path,
    *,
    now: int | None = None,
    times: str = "",
    prior: str | Path = "",
    model: str = "",
    filter_model: str = "",
    say: Callable[[str], Any] = lambda line: None,
) -> NextTime:
    """Choose when to measure one system next, from the measurements so far.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run. Its job gives the models, the constraints and the seed.
    measurements : str or Path
        Table with the columns t, y0, y1, ..., in CSV or Parquet. It may have no rows. A row without
        any component is a time that was missed.
    now : int, optional
        The last instant that has passed, if nothing was measured at the end.
    times : str, optional
        Name of the compared set that was planned; by default the found set with the lowest expected
        MSE.
    prior : str or Path, optional
        Table of particles from which the filter starts; see `pfdist.filter_measurements`.
    model, filter_model : str, optional
        ``path/file.py:object``: replaces the file that the run names for the model or for the
        filter's model. It is run without question, and must mean the same as the run's model.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Returns
    -------
    NextTime

    Raises
    ------
    StoreError
        The folder holds no finished run, or the model has changed since, or the run names a model
        file that is not run without the user's word.
    JobError
        The run has no set of this name.
    MeasurementsError, PriorError
        A table does not fit, or a value in it is wrong.
    ModelError
        The model cannot be loaded, or a formula failed.
    """
    opened = finished_run(run)
    name, planned = planned_set(opened, times)
    built = built_again(opened, {"model": model, "filter_model": filter_model}, say)
    believed = built.problem.believed
    known = read_prior(Path(prior), believed) if prior else None
    planner = Planner.of_built(built, planned, known)
    feasible, start = planner.feasible, planner.estimate().t
    last = _tell(planner, read_measurements(Path(measurements), believed, feasible.horizon, start))
    if now is not None:
        _check_now(now, max(last, start), feasible.horizon)
        if now > last:
            planner.missed(now)
        last = now
    before = tuple(time for time in planned if time > last and time >= start)
    if feasible.counted:
        before = before[: max(0, feasible.total - len(planner.measured))]
    expected, expected_before = planner.expected(planner.plan(), before)
    return NextTime(
        opened.path,
        name,
        planner.measured,
        planner.estimate().t,
        planner.plan(),
        before,
        expected,
        expected_before,
    )


def _tell(planner: Planner, rows: Measurements) -> int:
    """Tell a planner all measurements in the order of time, and give the last instant."""
    told = sorted(chain(zip(rows.t, rows.y, strict=True), ((t, None) for t in rows.missed)), key=_t)
    for t, y in told:
        if y is None:
            planner.missed(t)
        else:
            planner.update(y, t)
    return told[-1][0] if told else -1


def _t(row: tuple[int, Any]) -> int:
    return row[0]


def _check_now(now: int, last: int, horizon: int) -> None:
    if not last <= now <= horizon:
        raise MeasurementsError(f"now must lie in {last}..{horizon}, got {now}", argument="now")
