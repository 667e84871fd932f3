"""Judge a plan by real measurements: whether the gain that the model foresees is found in them."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from pfdist.common.arguments import path_argument
from pfdist.common.clock import Clock, Time
from pfdist.common.component_names import Component
from pfdist.common.measurement_times import Times
from pfdist.common.parts import Page
from pfdist.common.rounding import rounded
from pfdist.common.section import Number, Whole, checked
from pfdist.common.shown import Shown
from pfdist.common.streams import stream_of
from pfdist.errors import (
    ArgumentError,
    JobError,
    MeasurementsError,
    MeasurementTimesError,
    PfdistWarning,
    shown,
)
from pfdist.filters.replicates import Replicate, read_replicates
from pfdist.pools.base import Pool
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.at_work import at_work
from pfdist.questions.evaluate import OneSet, instants_of
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.planned_run import UserTable, planned_run, table_argument
from pfdist.questions.planner import first_planning
from pfdist.questions.report import write_page
from pfdist.results import Run, finite
from pfdist.results.promise import Errors, Promise, promise, real_over_foreseen
from pfdist.runner.backtesting import (
    PlanWork,
    ReplicateErrors,
    ReplicateWork,
    errors_of,
    evaluator_for,
    outcomes,
    plan_of,
)
from pfdist.runner.build import Built, build
from pfdist.runner.progress import Progress, Show, silent
from pfdist.runner.searches import planning_of
from pfdist.store import backtest_schema
from pfdist.store.folder import check_page_replaceable
from pfdist.store.user_tables import check_table_replaceable, is_parquet, write_user_table

Array = NDArray[np.float64]
DRAWS = 480
"""Simulated systems for each replicate."""
PLAN, FROM_START, CENTRED = "plan", "from_start", "centred"
SHOWN = 4
"""Replicates that a report shows in full."""
IMPROBABLE = 0.01
_GRIDS = 2


class ShownReplicate(NamedTuple):
    """A replicate that a report shows in full."""

    name: str
    times: Array  # (T+1,)
    measured: Array  # (T+1, q): what could be judged
    used: tuple[int, ...]  # the instants of the plan
    errors: ReplicateErrors


@dataclass(frozen=True, repr=False)
class Backtest(Shown):
    """Result of `backtest`.

    Parameters
    ----------
    data : Path
        The file with the measurements.
    plan : tuple of int, float or str
        The planned times on the clock of the job; empty with `plan_each`.
    sets : mapping of str to str
        The compared sets with their names in sentences; the first is the plan.
    promises : mapping of str to Promise
        For each set but the plan, whether the foreseen gain of the plan over it was found.
    ratios : mapping of str to (float, (float, float))
        For each set the real error over the foreseen error, with an interval; all intervals hold
        together with 95 % confidence.
    table : DataFrame
        A row for each judged replicate and set, with the columns of `pfdist.store.backtest_schema`.
        Errors are relative to the variance of what is judged.
    noise : float
        The part of all errors that the noise of the judged measurements causes, by the model.
    improbable : float
        Share of the plan's measurements whose p-value is below 1 %.
    left_out : mapping of str to str
        Replicates that are not judged, and why.
    is_checked : bool
        Whether a column says to which replicates the model was fitted.
    within : float
        Largest distance from a wanted time to the measurement that is used instead.
    impossible : int
        Number of filters for which a measurement is impossible.
    files : tuple of Path
        The table, the figure, and the report if it was wanted; none for a DataFrame without `out`.
    shown : tuple of ShownReplicate
    quantities : tuple of Component
        The components of what is judged.
    time_unit : str
    """

    data: Path
    plan: tuple[Time | str, ...]
    sets: Mapping[str, str]
    promises: Mapping[str, Promise]
    ratios: Mapping[str, tuple[float, tuple[float, float]]]
    table: pd.DataFrame
    noise: float
    improbable: float
    left_out: Mapping[str, str]
    is_checked: bool
    within: float
    impossible: int
    files: tuple[Path, ...]
    shown: tuple[ShownReplicate, ...]
    quantities: tuple[Component, ...]
    time_unit: str = ""

    @property
    def wrong(self) -> list[str]:
        """Names of the sets whose real error clearly differs from the foreseen error."""
        return [name for name, (_, (low, high)) in self.ratios.items() if low > 1.0 or high < 1.0]

    @property
    def means(self) -> pd.DataFrame:
        """Means over the replicates by set: real, foreseen, covered."""
        columns = ["real", "foreseen", "covered"]
        return self.table.groupby("set", sort=False)[columns].mean()

    @property
    def judged(self) -> int:
        """Number of judged values."""
        return int(self.table[self.table["set"] == PLAN]["judged"].sum())

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values, with the table as the path of its file."""
        files = dict(zip(("table", "figure", "report"), map(str, self.files), strict=False))
        means = self.means.to_dict("index")
        sets = {
            name: {**means[name], "ratio": ratio, "interval": interval,
                   "is_wrong": name in self.wrong}
            for name, (ratio, interval) in self.ratios.items()
        }  # fmt: skip
        return finite(
            {
                "data": str(self.data),
                "plan": self.plan,
                "replicates": len(self.table) // len(self.sets),
                "judged": self.judged,
                "promises": {
                    name: {"verdict": each.verdict, **vars(each), "deciding": each.deciding}
                    for name, each in self.promises.items()
                },
                "sets": sets,
                "noise": self.noise,
                "improbable": self.improbable,
                "left_out": dict(self.left_out),
                "is_checked": self.is_checked,
                **{name: files.get(name) for name in ("table", "figure", "report")},
            }
        )

    def _page(self) -> Page:
        # Not above: it is made of this result.
        from pfdist.questions.backtest_page import answer_of  # noqa: PLC0415

        return answer_of(self)


@with_options
@checked
def backtest(
    job: JobSource | Run,
    data: UserTable,
    *,
    replicate: str = "",
    times: Mapping[str, OneSet] | None = None,
    planned: str = "",
    plan_each: bool = False,
    within: Annotated[Number, Field(ge=0.0, allow_inf_nan=False)] | None = None,
    block: Annotated[Whole, Field(ge=1, le=10_000)] = 1,
    out: str | Path = "",
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Backtest:
    """Judge by real measurements whether a plan keeps its promise.

    The table has more measurements of each system, a replicate, than the plan needs. Each replicate
    is filtered with its measurements at the times of the plan, at two grids of evenly spaced times,
    and at sets of your own. The predictions are judged by the measurements that no set uses. The
    model foresees these errors by simulated systems that are measured and judged at the same times.

    A table, ``NAME.backtest.csv`` or ``.parquet`` as the data are, a figure, ``NAME.backtest.png``,
    and a report, ``NAME.backtest.html``, are written. They replace those of an earlier call, and no
    other file.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run.
    data : str, Path or DataFrame
        Table in CSV or Parquet with a row for each replicate and time: a column with the name of
        the replicate, t, y0, y1, ... (or ``y_NAME``), and sensor if the model has sensors. Further
        columns may be z0, z1, ... (known quantities of interest, which are judged instead), train
        (1 for a replicate to which the model was fitted; it is not judged), and parameters.
    replicate : str, optional
        Column with the name of the replicate; by default the first.
    times : mapping of str to iterable or str, optional
        Further sets to compare, as ``clinic=0,6,12,24``; give the option once for each set.
    planned : str, optional
        Name of the compared set whose times were planned; by default the found set with the lowest
        expected MSE.
    plan_each : bool
        Plan for each replicate among its own measurements; then no run is needed.
    within : float, optional
        Largest distance from a wanted time to the nearest measured time, which is used instead; by
        default half a step of the clock.
    block : int
        Number of consecutive replicates that may depend on each other, such as 7 days.
    out : str or Path, optional
        Folder of the table, the figure and the report; by default that of the data, and none for a
        DataFrame.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    options
        See `Options`.

    Returns
    -------
    Backtest

    Raises
    ------
    StoreError
        There is no finished run of the job, or a file cannot be written.
    MeasurementsError
        The table is wrong, or no replicate can be judged.
    JobError, ModelError
        The job or a parameter does not fit.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.pages import backtested  # noqa: PLC0415

    chosen, table = Chosen(**options), table_argument("data", data)
    files = _files(table, out)[: 3 if chosen.report is not False else 2]
    checks: Any = (lambda path: check_table_replaceable(path, backtest_schema()),
              backtested.check_figure_replaceable, check_page_replaceable)  # fmt: skip
    for file, check in zip(files, checks, strict=False):
        check(file)
    with following(chosen.progress, chosen.say) as (show, tell):
        if plan_each:
            built, plan = build(_as_job(job, changes)), None
        else:
            found = planned_run(job, results, changes, tell, planned, "")
            built, plan = found.built, found.times
        if built.evaluator.told:
            raise JobError(
                "scenarios.filter must be 'nominal' or 'learned', got 'told': the scenario of a "
                "real system is not known"
            )
        execution = built.job.with_changes(settings={"execution": chosen.execution}).execution
        model, clock = built.evaluator.model, built.job.problem.clock
        names = [*model.parameters, *built.evaluator.believed.parameters]
        replicates = read_replicates(table, replicate, model, clock, [*dict.fromkeys(names)])
        _check_columns(built, replicates)
        if within is None:
            within = (clock.times[-1] - clock.times[0]) / clock.horizon / 2
        own = {name: instants_of(built.job, name, each) for name, each in (times or {}).items()}
        for name in {*own} & {PLAN, FROM_START, CENTRED}:
            raise ArgumentError(f"times: {name!r} is the name of another set; choose another name")
        with at_work(execution, [built.evaluator.engine], tell) as pool:
            plans = _plans(built, replicates, pool, show) if plan is None else plan
            matched, left_out = _matched(built, replicates, plans, own, within)
            if not matched:
                why = next((f"{name}: {each}" for name, each in left_out.items()), "no rows")
                raise MeasurementsError(f"no replicate can be judged ({why})")
            errors = _errors(built, matched, pool, show)
    first = f"evenly spaced times from t = {clock.formatted(0)}"
    sets = {PLAN: "the plan", FROM_START: first, CENTRED: "centred evenly spaced times"}
    sets |= {name: f"the set {name}" for name in own}
    result = _result(sets, matched, errors, block)
    result = replace(
        result,
        data=Path("data") if isinstance(table, pd.DataFrame) else table,
        plan=() if plan is None else tuple(clock.written_of(plan)),
        left_out=left_out,
        is_checked=any(each.is_training for each in replicates),
        within=within,
        files=files,
        quantities=model.named("y") if matched[0].is_predicted else model.named("z"),
        time_unit=clock.unit,
    )
    if files:
        from pfdist.questions.backtest_page import report_of  # noqa: PLC0415  as in Backtest

        rows = pa.Table.from_pandas(result.table, schema=backtest_schema(), preserve_index=False)
        write_user_table(files[0], rows)
        backtested.draw_backtest(files[1], backtested.by_replicate(result.table, result.sets))
        for file in files[2:]:
            write_page(report_of(result), file)
    for line in result._page().warnings if chosen.say is silent else ():
        warnings.warn(line, PfdistWarning, stacklevel=3)
    return result


def _as_job(job: JobSource | Run, changes: Iterable[str]) -> Any:
    return as_job(job.path if isinstance(job, Run) else job, changes)


def _check_columns(built: Built, replicates: Iterable[Replicate]) -> None:
    """Raise `MeasurementsError` if a column has a parameter of which the job has scenarios."""
    given = () if built.job.scenarios is None else built.job.scenarios.parameters
    varied = {*given} if isinstance(given, Mapping) else {*chain(*given)}
    for each in replicates:
        for name in varied & {*each.parameters}:
            raise MeasurementsError(
                f"column {name}: a parameter with scenarios or a distribution in the job must have "
                "no column"
            )


def _files(data: Path | pd.DataFrame, out: str | Path) -> tuple[Path, ...]:
    """The files of the result. A table in memory has no folder: without `out` there are none."""
    folder = path_argument("out", out)
    if isinstance(data, pd.DataFrame):
        if not str(out):
            return ()
        data = folder / "data.csv"
    folder = folder if str(out) else data.parent
    suffix = "parquet" if is_parquet(data) else "csv"
    return tuple(folder / f"{data.stem}.backtest.{end}" for end in (suffix, "png", "html"))


# --- sets of each replicate -----------------------------------------------------------------------


class _Matched(NamedTuple):
    """A replicate that is judged."""

    replicate: Replicate
    sets: tuple[Times, ...]  # on the replicate's clock
    judged: Array  # (T+1, q): the values that no set uses; NaN elsewhere

    @property
    def is_predicted(self) -> bool:
        """Whether measurements are judged, and not known quantities of interest."""
        return self.replicate.z is None


_Plans = Times | Mapping[str, Times | None]


def _plans(
    built: Built, replicates: Sequence[Replicate], pool: Pool, show: Show
) -> dict[str, Times | None]:
    """The plan of each replicate on its own clock; None if it is not judged.

    It is not judged if the model was fitted to it, or if it has too few measurements.
    """
    feasible, job = built.feasible, built.job
    if feasible.measurement_budget is None:
        raise JobError("plan_each needs problem.measurement_budget, got a total price")
    if built.evaluator.scenarios:
        raise JobError("plan_each needs a job without scenarios, or scenarios.filter = 'learned'")
    planning = first_planning(planning_of(job, built.evaluator.cheapest_estimator))
    works = dict[str, PlanWork]()
    plans: dict[str, Times | None] = dict.fromkeys(each.name for each in replicates)
    for each in replicates:
        if each.is_training:
            continue
        measured = {*each.measured(built.evaluator.model)}
        on = each.clock if each.has_own_clock or feasible.clock else None
        possible = range(len(each.y) * feasible.sensors)
        lacking = tuple(number for number in possible if number not in measured)
        if each.has_own_clock:
            rest = replace(
                feasible, horizon=each.clock.horizon, clock=on, forbidden=(), required=()
            )
        else:
            rest = feasible
        with suppress(MeasurementTimesError):  # too few measurements
            rest = replace(rest, forbidden=tuple(sorted({*rest.forbidden, *lacking})))
            evaluator = evaluator_for(built, each, is_predicted=False)
            stream = stream_of("backtest", job.seed, "plan", each.name)
            works[each.name] = PlanWork(evaluator, rest, planning, stream)
    names = [*works]
    for done, (place, times) in enumerate(
        outcomes(pool, plan_of, [*works.values()], "the plans"), 1
    ):
        plans[names[place]] = times
        show(
            Progress("plan", done, len(names), doing=f"Planning: {done} of {len(names)} replicates")
        )
    return plans


def _matched(
    built: Built,
    replicates: Sequence[Replicate],
    plans: _Plans,
    own: Mapping[str, Times],
    within: float,
) -> tuple[list[_Matched], dict[str, str]]:
    """The replicates that are judged, and why the others are not, by name.

    `plans` is the plan on the clock of the job, or the plan of each replicate on its own clock.
    """
    clock, model = built.job.problem.clock, built.evaluator.model
    matched, left_out = list[_Matched](), dict[str, str]()
    for each in replicates:
        plan = plans.get(each.name) if isinstance(plans, Mapping) else plans
        on = each.clock if isinstance(plans, Mapping) else clock
        if each.is_training or plan is None:
            why = "the model was fitted to it", "it has too few measurements for a plan"
            left_out[each.name] = why[plan is None and not each.is_training]
            continue
        wanted = [_wanted(plan, on), *_grids(on, len(plan), built.feasible.cheapest)]
        wanted += [_wanted(times, clock) for times in own.values()]
        measured = each.measured(model)
        try:
            sets = tuple(each.nearest(times, measured, within) for times in wanted)
        except MeasurementsError as error:
            left_out[each.name] = str(error)
            continue
        judged = (each.y if each.z is None else each.z).copy()
        judged[sorted({number // len(model.parts) for number in chain(*sets)})] = np.nan
        if np.isnan(judged).all():
            left_out[each.name] = "no value is left to judge"
            continue
        matched.append(_Matched(each, sets, judged))
    return matched, left_out


def _wanted(times: Times, clock: Clock) -> list[tuple[float, int]]:
    """The time and the sensor of each possible measurement."""
    sensors = max(1, len(clock.sensors))
    return [(clock.times[number // sensors], number % sensors) for number in times]


def _grids(clock: Clock, number: int, sensor: int) -> Iterator[list[tuple[float, int]]]:
    """Yield the beginnings and the middles of equal parts of the horizon.

    On an even clock, the last instant is a step long, too.
    """
    first, last = clock.times[0], clock.times[-1]
    whole = (last - first) * (1 + clock.is_even / clock.horizon)
    for offset in (0.0, 0.5):
        yield [(first + whole * (part + offset) / number, sensor) for part in range(number)]


# --- errors and verdicts --------------------------------------------------------------------------


def _errors(
    built: Built, matched: Sequence[_Matched], pool: Pool, show: Show
) -> list[ReplicateErrors]:
    """The errors of each replicate, relative to the variance of what is judged."""
    evaluators, works = dict[Any, Any](), list[ReplicateWork]()
    is_predicted = matched[0].is_predicted
    for each in matched:
        if each.replicate.key not in evaluators:
            evaluator = evaluator_for(built, each.replicate, is_predicted=is_predicted)
            evaluators[each.replicate.key] = evaluator
    angles = next(iter(evaluators.values())).model.is_angle
    variances = _variances(np.concatenate([each.judged for each in matched]), angles)
    for each in matched:
        parts = "backtest", built.job.seed, each.replicate.name
        work = ReplicateWork(
            evaluators[each.replicate.key],
            each.replicate.y,
            each.judged,
            variances,
            each.sets,
            DRAWS,
            (stream_of(*parts), stream_of(*parts, "filter")),
            built.comparing,
            is_predicted,
        )
        works.append(work)
    errors = dict[int, ReplicateErrors]()
    for done, (place, result) in enumerate(outcomes(pool, errors_of, works, "the backtest"), 1):
        if not np.isfinite([*result.real, *np.nanmean(result.foreseen, axis=1)]).all():
            raise MeasurementsError(
                f"replicate {shown(matched[place].replicate.name)}: errors must be finite, got "
                f"{rounded(result.real[0], 3)} with the plan, foreseen "
                f"{rounded(float(np.mean(result.foreseen[0])), 3)}: see its values and parameters"
            )
        errors[place] = result
        doing = f"Backtest: {done} of {len(works)} replicates"
        show(Progress("backtest", done, len(works), doing=doing))
    return [errors[place] for place in range(len(works))]


def _variances(values: Array, is_angle: Sequence[bool]) -> Array:
    """The variance of each component, (q,); that of angles around their mean direction."""
    variances = np.ones(values.shape[1])
    for k, (column, angle) in enumerate(zip(values.T, is_angle, strict=True)):
        known = column[~np.isnan(column)]
        if not known.size:
            continue
        centre = np.angle(np.exp(1j * known).mean()) if angle else known.mean()
        apart = known - centre
        apart = np.angle(np.exp(1j * apart)) if angle else apart
        with np.errstate(over="ignore"):
            variances[k] = np.mean(apart**2)
        if not 0.0 < variances[k] < np.inf:
            rule = "must differ from each other, by less than 1e150"
            raise MeasurementsError(
                f"judged values of component {k} {rule}, got {known.min():.4g} to {known.max():.4g}"
            )
    return variances


def _result(
    sets: Mapping[str, str],
    matched: Sequence[_Matched],
    errors: Sequence[ReplicateErrors],
    block: int,
) -> Backtest:
    """The result, without what is known before it."""
    of_sets = {
        name: Errors(
            np.array([each.real[k] for each in errors]),
            np.stack([
                np.where(np.isfinite(each.foreseen[k]), each.foreseen[k], np.nan)
                for each in errors
            ]),
        )
        for k, name in enumerate(sets)
    }  # fmt: skip
    rows = [
        {
            "replicate": each.replicate.name,
            "set": name,
            "judged": int(np.sum(~np.isnan(each.judged))),
            "real": one_set.real[place],
            "foreseen": one_set.means[place],
            "covered": errors[place].covered[k],
        }
        for place, each in enumerate(matched)
        for k, (name, one_set) in enumerate(of_sets.items())
    ]
    plan, others = of_sets[PLAN], [*of_sets.items()][1:]
    order = np.argsort(of_sets[FROM_START].real - plan.real)
    places = [int(order[round(share * (len(order) - 1))]) for share in np.linspace(0.1, 0.9, SHOWN)]
    shown = [
        ShownReplicate(
            matched[place].replicate.name,
            np.array(matched[place].replicate.clock.times, np.float64),
            matched[place].replicate.y if matched[place].is_predicted else matched[place].judged,
            tuple(number // _sensors(matched[place]) for number in matched[place].sets[0]),
            errors[place],
        )
        for place in dict.fromkeys(places)
    ]
    surprises = np.concatenate([each.surprises for each in errors])
    return Backtest(
        data=Path(),
        plan=(),
        sets=sets,
        promises={name: promise(plan, each, block) for name, each in others},
        ratios={name: real_over_foreseen(each, len(sets), block) for name, each in of_sets.items()},
        table=pd.DataFrame(rows),
        noise=float(np.mean([each.noise for each in errors])),
        improbable=float(np.mean(surprises < IMPROBABLE)),
        left_out={},
        is_checked=False,
        within=0.0,
        impossible=sum(each.impossible for each in errors),
        files=(),
        shown=tuple(shown),
        quantities=(),
    )


def _sensors(matched: _Matched) -> int:
    return max(1, len(matched.replicate.clock.sensors))
