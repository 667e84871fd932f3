"""The time to measure next, from a run and the measurements so far."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

from pfdist.analysis import finite
from pfdist.api.filter_measurements import IMPROBABLE
from pfdist.api.planned_run import planned_run
from pfdist.api.planner import Planner
from pfdist.common.cards import Card, Shown
from pfdist.common.rounding import with_error
from pfdist.errors import MeasurementsError
from pfdist.evaluation.estimate import ReportEvaluation
from pfdist.sequential.measurements import Measurements, read_measurements
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


@dataclass(frozen=True, repr=False)
class NextTime(Shown):
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
    left : int or None
        Number of measurements that are left of the budget; None if they have costs.
    planned_before : tuple of int
        Times of the first plan that are left.
    expected, expected_before : ReportEvaluation
        Expected MSE from `now` to T with both plans, on the same fresh simulated systems. An exact
        engine needs none. `expected_before` is None if the first plan is no longer possible.
    surprise : float or None
        P-value of the most surprising among all measurements (Bonferroni), if there is one.
    """

    run: Path
    name: str
    measured: Times
    now: int
    plan: Times
    left: int | None
    planned_before: Times
    expected: ReportEvaluation
    expected_before: ReportEvaluation | None
    surprise: float | None

    @property
    def next(self) -> int | None:
        """The time to measure next; None if the budget is spent."""
        return self.plan[0] if self.plan else None

    @property
    def is_improbable(self) -> bool:
        """Whether a right model has such measurements in less than 1 % of systems."""
        return self.surprise is not None and self.surprise < IMPROBABLE

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        before = self.expected_before
        answer = {
            "run": str(self.run),
            "planned": self.name,
            "measured": self.measured,
            "now": self.now,
            "next": self.next,
            "plan": self.plan,
            "left": self.left,
            "expected_mse": self.expected.expected_mse,
            "standard_error": self.expected.standard_error,
            "planned_before": self.planned_before,
            "expected_mse_before": before and before.expected_mse,
            "standard_error_before": before and before.standard_error,
            "draws": self.expected.draws,
            "surprise_of_all": self.surprise,
            "is_improbable": self.is_improbable,
        }
        found: dict[str, Any] = finite(answer)
        return found

    def _card(self) -> Card:
        title = "nothing is left to be measured"
        if self.plan:
            title = f"measure next at t = {self.next}"
        mse = with_error(self.expected.expected_mse, self.expected.standard_error)
        rows = [
            ("measured at t", ", ".join(map(str, self.measured))),
            ("plan", ", ".join(map(str, self.plan))),
            ("expected MSE from now on", mse),
        ]
        return Card(title, (), rows)


def next_time(
    run: str | Path,
    measurements: str | Path,
    *,
    now: int | None = None,
    planned: str = "",
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
    planned : str, optional
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
    instead = {"model": model, "filter_model": filter_model}
    plan = planned_run(run, planned, prior, instead, say)
    believed = plan.built.problem.believed
    planner = Planner.of_built(plan.built, plan.times, plan.prior)
    feasible, start = planner.feasible, planner.estimate().t
    rows = read_measurements(Path(measurements), believed, feasible.horizon, start)
    last, surprise = _tell(planner, rows)
    if now is not None:
        _check_now(now, max(last, start), feasible.horizon)
        if now > last:
            planner.missed(now)
        last = now
    left = max(0, feasible.total - len(planner.measured)) if feasible.counted else None
    before = tuple(time for time in plan.times if time > last and time >= start)[:left]
    expected, *expected_before = planner.expected(
        planner.plan(), *([before] if _is_possible(feasible, planner.measured, before) else [])
    )
    return NextTime(
        plan.run.path,
        plan.name,
        planner.measured,
        planner.estimate().t,
        planner.plan(),
        left,
        before,
        expected,
        expected_before[0] if expected_before else None,
        surprise,
    )


def _is_possible(feasible: Feasible, measured: Times, left: Times) -> bool:
    """Whether times may still be measured: at a distance from each other, and not too dear."""
    times, spacing = (*measured[-1:], *left), feasible.minimum_spacing
    apart = all(later - time >= spacing for time, later in pairwise(times))
    money = feasible.total_cost
    return apart and (money is None or feasible.cost_of((*measured, *left)) <= money)


def _tell(planner: Planner, rows: Measurements) -> tuple[int, float | None]:
    """Tell a planner all measurements in the order of time.

    Returns
    -------
    int
        The last instant, or -1.
    float or None
        The p-value of the most surprising among all measurements.
    """
    surprises = list[float]()
    told = sorted(chain(zip(rows.t, rows.y, strict=True), ((t, None) for t in rows.missed)), key=_t)
    for t, y in told:
        if y is None:
            planner.missed(t)
        else:
            estimate = planner.update(y, t)
            surprises += [] if estimate.surprise is None else [estimate.surprise]
    surprise = min(1.0, len(surprises) * min(surprises)) if surprises else None
    return told[-1][0] if told else -1, surprise


def _t(row: tuple[int, Any]) -> int:
    return row[0]


def _check_now(now: int, last: int, horizon: int) -> None:
    if not last <= now <= horizon:
        raise MeasurementsError(f"now must lie in {last}..{horizon}, got {now}", argument="now")
